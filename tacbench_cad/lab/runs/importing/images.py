"""Folders of images: with a table beside them, with one folder for each class, or as TacTip toolchains write them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path, PurePosixPath

from tacbench_cad.lab.runs.importing.samples import LeftOut, Loaded, Rows, Sample, Source
from tacbench_cad.util import door
from tacbench_cad.util.errors import InputError

#: Endings of images that can be read.
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
#: Folders of a split, which are no classes.
SPLITS = ("train", "training", "val", "valid", "validation", "dev", "test")
#: The tables and folders of TacTip toolchains, in the order in which they are looked for.
TACTIP_TABLES = ("targets_images.csv", "targets.csv")
TACTIP_FOLDERS = ("processed_images", "sensor_images")


def is_image_file(path: Path) -> bool:
    """Whether a file's ending is that of an image."""
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".")


def with_table(table: Path, folder: Path, columns: Mapping[str, str], kind: str = "images with a table") -> Source:
    """Images that a table names by their paths from a folder.

    Raises:
        InputError: The table cannot be read or names no images.
    """
    rows = Rows.read(table, columns)
    if "image" not in rows.columns:
        what = f"has no column of images; say which it is: --columns image=COLUMN (of {', '.join(rows.unused)})"
        raise InputError("table", str(table), what)
    samples: list[Sample] = []
    left_out: list[LeftOut] = []
    seen: dict[str, str] = {}
    for where, fields in rows.rows:
        name = _inside(fields.pop("image", ""), folder)
        reason = name_fault(name, "image")
        if not reason and seen.setdefault(name, where) != where:
            reason = f"names the image of {seen[name]} again"
        if reason:
            left_out.append(LeftOut(where=f"{where} ({name})", reason=reason))
        else:
            samples.append(_sample(name, fields, folder / name, folder, where))
    return Source(
        kind=kind,
        path=table,
        samples=samples,
        left_out=tuple(left_out),
        facts={"columns": dict(rows.columns)},
        notes=(rows.note,),
        threads=True,
    )


def of_toolchain(folder: Path, columns: Mapping[str, str]) -> Source:
    """A folder of a TacTip toolchain: a table of targets beside a folder of images.

    Raises:
        InputError: The table cannot be read.
    """
    table = next(folder / name for name in TACTIP_TABLES if (folder / name).is_file())
    images = next(folder / name for name in TACTIP_FOLDERS if (folder / name).is_dir())
    return with_table(table, images, columns, "a TacTip toolchain's folder")


def of_classes(folder: Path) -> Source:
    """One folder of images for each class, whose name is the label; images beside them have no label.

    Where the folders are those of a split (``train``, ``test`` and so on), the classes are the folders within them.

    Raises:
        InputError: The folder cannot be listed.
    """
    samples: list[Sample] = []
    left_out: list[LeftOut] = []
    files = sorted(files_below(folder))
    folders = {path.relative_to(folder).parts[0] for path in files if path.parent != folder}
    depth = 1 if folders and all(name.lower() in SPLITS for name in folders) else 0
    note = f"{folder.name}: {', '.join(sorted(folders))} are taken as parts of a split; the classes lie in them"
    for path in files:
        name = path.relative_to(folder)
        if is_image_file(path):
            fields = {"label": name.parts[depth]} if len(name.parts) > depth + 1 else {}
            samples.append(_sample(str(name), fields, path, folder))
        elif not path.name.startswith("."):
            left_out.append(LeftOut(where=str(name), reason=f"is no image ({', '.join(SUFFIXES)})"))
    kind = "one folder of images for each class" if any(sample.fields for sample in samples) else "a folder of images"
    notes = (note,) if depth else ()
    return Source(kind=kind, path=folder, samples=samples, left_out=tuple(left_out), notes=notes, threads=True)


def files_below(folder: Path) -> Iterator[Path]:
    """The files in a folder and in folders within it; links to folders are not followed.

    Raises:
        InputError: It cannot be listed.
    """
    try:
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                yield from files_below(path)
            else:
                yield path
    except OSError as error:
        raise InputError("folder", str(folder), f"cannot be listed: {error.strerror or error}") from None


def name_fault(name: str, what: str) -> str:
    """Why a table's name of a file is refused; empty if it is not."""
    if not name:
        return f"names no {what}"
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or Path(name).is_absolute() or "\0" in name:
        return "is a path that leads out of the folder"
    return ""


def _inside(name: str, folder: Path) -> str:
    """A file's name from a folder, of an absolute path in that folder; every other name as it is."""
    path = Path(name)
    return str(path.relative_to(folder.absolute())) if path.is_relative_to(folder.absolute()) else name


def _sample(name: str, fields: Mapping[str, str], path: Path, within: Path, row: str = "") -> Sample:
    load: Callable[[], Loaded] = partial(door.read_bytes, path, "image", "image", within=within)
    return Sample(name=name, row=row, fields=fields, load=load)
