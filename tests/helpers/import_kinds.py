"""Valid files of each kind that ``tacbench import-frames``, ``roi`` and ``publish`` read, and their readers."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from helpers.mutations import HARMLESS_IN_TOML, Kind, indented, marked, windows, writer

AUTHORS_FILE = "PLAminus_z0_P30_Bambu.npy"
#: The label of each frame.
LABELS = ("cork", "felt", "cork", "felt", "cork", "felt")
NAMES = '[printers]\nmine = "ender-3"\n[filaments]\npetg = "pla-plus"\n[labels]\ncork = "bark"\n'
PUBLICATION = """
title = "Presses on one block"
year = 2026
publisher = "Zenodo"
licence = "CC-BY-4.0"
keywords = ["tactile sensing"]
doi = "10.5281/zenodo.1234567"
related = ["10.1000/182"]
[[authors]]
family_name = "Carberry"
given_names = "Josiah"
affiliation = "Brown University"
orcid = "0000-0002-1825-0097"
"""


def frames() -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, (len(LABELS), 16, 24, 3), dtype=np.uint8)


def write_table(folder: Path, *columns: tuple[str, *tuple[object, ...]]) -> None:
    lines = (",".join(map(str, row)) for row in zip(*columns, strict=True))
    (folder / "table.csv").write_text("".join(f"{line}\n" for line in lines))


def make_images(folder: Path, suffix: str = ".png") -> None:
    import cv2

    for number, frame in enumerate(frames()):
        assert cv2.imwrite(str(folder / f"{number}{suffix}"), frame)
    write_table(
        folder,
        ("image", *(f"{number}{suffix}" for number in range(len(LABELS)))),
        ("label", *LABELS),
        ("printer", *["Mine"] * 6),
        ("filament", *["petg"] * 6),
        ("print", 1, 1, 2, 2, "third", "third"),
        ("position", 1, 1, 2, 2, "a", "b"),
        ("force", 0.5, 0.5, 1, 1, 2, 2),
        ("x_mm", *[1.5] * 6),
    )
    (folder / "names.toml").write_text(NAMES)


def make_arrays(folder: Path, save: Callable[[Path], None]) -> None:
    save(folder)
    write_table(folder, ("index", *range(6)), ("label", *LABELS), ("repeat", 1, 1, 2, 2, 3, 3))


def save_npy(folder: Path, name: str = "X.npy") -> None:
    np.save(folder / name, frames())


def save_npz(folder: Path) -> None:
    np.savez_compressed(folder / "X.npz", X=frames(), label=np.array(LABELS), gain=np.ones(3))


def save_hdf5(folder: Path) -> None:
    import h5py

    with h5py.File(folder / "X.h5", "w") as file:
        file.create_dataset("X", data=frames(), chunks=(1, 16, 24, 3), compression="gzip")
        file["label"] = list(LABELS)


def save_video(folder: Path) -> None:
    import cv2

    video = cv2.VideoWriter(str(folder / "press.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (24, 16))
    for frame in frames():
        video.write(frame)
    video.release()
    write_table(folder, ("video", *["press.avi"] * 6), ("time_s", 0, 0.1, 0.4, 0.2, 0.3, 0.5), ("label", *LABELS))


def save_authors_array(folder: Path) -> None:
    np.save(folder / AUTHORS_FILE, np.resize(frames(), (25, 16, 24, 3)))


def save_hugging_face(folder: Path) -> None:
    import datasets

    datasets.disable_progress_bars()
    columns = {"image": frames().tolist(), "label": list(LABELS)}
    datasets.Dataset.from_dict(columns).save_to_disk(folder / "set")


def imported(folder: Path, paths: Sequence[str], names: str | None = None) -> object:
    """Import samples; check that every run can be read and that every omitted sample has a reason."""
    from tacbench_cad.lab.runs.importing.importer import import_samples
    from tacbench_cad.lab.runs.importing.sources import ImportOptions
    from tacbench_cad.lab.runs.reading import Run

    out = folder.with_name("out")
    shutil.rmtree(out, ignore_errors=True)
    options = ImportOptions(names=folder / names if names else None)
    report = import_samples([folder / path for path in paths], out, options)
    for sample in report.left_out:
        assert sample.where and sample.reason and sample.count > 0, sample
    for run in report.runs:
        frames = [opened.frame(row, verify=True) for opened in (Run.open(run.folder),) for row in opened.rows]
        assert len(frames) == run.imported > 0
    assert sum(path.is_dir() for path in out.glob("*")) == len(report.runs)
    return [(run.folder.name, run.imported) for run in report.runs], len(report.left_out)


def make_region(folder: Path) -> None:
    from tacbench_cad.lab.runs.region import parse_region, store_region

    store_region(folder, parse_region("circle:30.5,20,15", 48, 64))


def make_mask(folder: Path) -> None:
    import cv2

    from tacbench_cad.lab.runs.region import parse_region, store_region

    cv2.imwrite(str(folder / "mask.png"), np.kron(np.eye(2), np.full((24, 32), 255.0)).astype(np.uint8))
    store_region(folder, parse_region(str(folder / "mask.png"), 48, 64))


def read_region(folder: Path) -> object:
    from tacbench_cad.lab.runs.region import stored_region

    region = stored_region(folder)
    return region and (region.digest, region.sureness)


def read_publication_file(folder: Path) -> object:
    from tacbench_cad.extensions.exchange.publishing.publication import read_publication

    return str(read_publication(folder / "publication.toml"))


def of_table(save: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return a function that writes frames and a table with a row for each."""
    return partial(make_arrays, save=save)


read_images = partial(imported, paths=(".",))

#: Every kind of imported or published file.
IMPORT_KINDS: dict[str, Kind] = {
    "table of images": Kind("table.csv", make_images, read_images, (windows, marked)),
    "names": Kind("names.toml", make_images, partial(imported, paths=(".",), names="names.toml"), HARMLESS_IN_TOML),
    **{
        f"{suffix} image": Kind(
            f"2.{suffix}", partial(make_images, suffix=f".{suffix}"), partial(imported, paths=(".",))
        )
        for suffix in ("png", "jpg", "bmp", "tif")
    },
    "npy array": Kind("X.npy", of_table(save_npy), partial(imported, paths=("X.npy", "table.csv"))),
    "npz array": Kind("X.npz", of_table(save_npz), partial(imported, paths=("X.npz", "table.csv"))),
    "npz alone": Kind("X.npz", save_npz, partial(imported, paths=("X.npz",))),
    "hdf5 array": Kind("X.h5", of_table(save_hdf5), partial(imported, paths=("X.h5", "table.csv"))),
    "hdf5 alone": Kind("X.h5", save_hdf5, partial(imported, paths=("X.h5",))),
    "table of an array": Kind("table.csv", of_table(save_npy), partial(imported, paths=("X.npy", "table.csv"))),
    "authors' array": Kind(AUTHORS_FILE, save_authors_array, partial(imported, paths=(AUTHORS_FILE,))),
    "video": Kind("press.avi", save_video, partial(imported, paths=("table.csv",))),
    "table of times": Kind("table.csv", save_video, partial(imported, paths=("table.csv",))),
    "arrow": Kind("set/data-00000-of-00001.arrow", save_hugging_face, partial(imported, paths=("set",))),
    "data set's info": Kind("set/dataset_info.json", save_hugging_face, partial(imported, paths=("set",))),
    "data set's state": Kind("set/state.json", save_hugging_face, partial(imported, paths=("set",))),
    "region": Kind("roi.json", make_region, read_region, (windows, indented)),
    "region's picture": Kind("roi.png", make_mask, read_region),
    "publication": Kind(
        "publication.toml", writer("publication.toml", PUBLICATION), read_publication_file, HARMLESS_IN_TOML
    ),
}
