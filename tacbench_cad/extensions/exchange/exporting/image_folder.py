"""``imagefolder``: one folder of images for each label, and ``metadata.csv``."""

from __future__ import annotations

import csv
import hashlib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tacbench_cad.extensions.exchange.exporting.columns import COLUMNS
from tacbench_cad.extensions.exchange.exporting.export_formats import ExportFormat
from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples
from tacbench_cad.lab.runs import cell
from tacbench_cad.util.text import file_name

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
    names = folder_names(samples.labels)
    with (folder / FILE).open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow([FILE_COLUMN, *(column.name for column in COLUMNS)])
        for sample in samples:
            path = folder / names[sample.values["label"]] / f"{sample.key}{sample.suffix}"
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(sample.data)
            name = path.relative_to(folder).as_posix()
            table.writerow([name, *(cell(sample.values[column.name]) for column in COLUMNS)])


def folder_names(labels: Iterable[str | None]) -> dict[str | None, str]:
    """Return the folder name of each label. Names get a hash only if they would be the same for several labels."""
    names = {label: (file_name(label, 100) or "label") if label is not None else UNLABELLED for label in labels}
    alike = Counter(name.lower() for name in names.values())  # some file systems ignore case
    return {
        label: f"{name}-{hashlib.sha256(label.encode()).hexdigest()[:6]}" if label and alike[name.lower()] > 1 else name
        for label, name in names.items()
    }


FORMAT = ExportFormat(write=write, loading=LOADING)
