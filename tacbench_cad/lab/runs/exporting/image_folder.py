"""``imagefolder``: one folder of images for each label, and ``metadata.csv``."""

from __future__ import annotations

import csv
import hashlib
import re
from pathlib import Path

from tacbench_cad.lab.runs.exporting.columns import COLUMNS
from tacbench_cad.lab.runs.exporting.samples import Samples
from tacbench_cad.lab.runs.schema import cell

#: The table and its first column; ``datasets`` requires these names.
FILE, FILE_COLUMN = "metadata.csv", "file_name"
#: The folder for images with an unknown label.
UNLABELLED = "_unlabelled"
LOADING = (
    'from datasets import load_dataset\n\ndataset = load_dataset("imagefolder", data_dir=".")["train"]\n'
    'dataset[0]["image"], dataset[0]["label"]'
)


def write(samples: Samples, folder: Path) -> None:
    """Write the unchanged images and the table."""
    samples.require_images("imagefolder")
    with (folder / FILE).open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow([FILE_COLUMN, *(column.name for column in COLUMNS)])
        for sample in samples:
            path = folder / folder_name(sample.values["label"]) / f"{sample.key}{sample.suffix}"
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(sample.data)
            name = path.relative_to(folder).as_posix()
            table.writerow([name, *(cell(sample.values[column.name]) for column in COLUMNS)])


def folder_name(label: str | None) -> str:
    """Return the folder name of a label. A hash is added if the label has characters that a folder name cannot have."""
    if label is None:
        return UNLABELLED
    plain = re.sub(r"[^A-Za-z0-9.+_-]+", "-", label).strip(".-")[:60]
    return plain if plain == label else f"{plain}-{hashlib.sha256(label.encode()).hexdigest()[:6]}"
