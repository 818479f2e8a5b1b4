"""Import of folders of images: with a table, with a folder for each class, or written by a TacTip toolchain."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path, PurePosixPath

from tacbench_cad.lab.runs.importing.samples import LeftOut, Loaded, Rows, Sample, Source
from tacbench_cad.util import door
from tacbench_cad.util.errors import InputError

#: The suffixes of images that can be read.
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
#: The names of folders that are parts of a split, not classes.
SPLITS = ("train", "training", "val", "valid", "validation", "dev", "test")
#: The tables and folders of TacTip toolchains. The first that exists is used.
TACTIP_TABLES = ("targets_images.csv", "targets.csv")
TACTIP_FOLDERS = ("processed_images", "sensor_images")


def is_image_file(path: Path) -> bool:
    """Return whether a file has the suffix of an image."""
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".")


def with_table(table: Path, folder: Path, columns: Mapping[str, str], kind: str = "images with a table") -> Source:
    """Read images that a table lists by their paths, relative to a folder.

    Raises:
        InputError: The table cannot be read, or has no column of images.
    """
    rows = Rows.read(table, columns)
    if "image" not in rows.columns:
        what = f"has no column of images; choose one with --columns image=COLUMN ({', '.join(rows.unused)})"
        raise InputError("table", str(table), what)
    samples: list[Sample] = []
    left_out: list[LeftOut] = []
    seen: dict[str, str] = {}
    for where, fields in rows.rows:
        name = _inside(fields.pop("image", ""), folder)
        reason = name_fault(name, "image")
        if not reason and seen.setdefault(name, where) != where:
            reason = f"has the same image as {seen[name]}"
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
    """Read a folder of a TacTip toolchain, which contains a table of targets and a folder of images.

    Raises:
        InputError: The table cannot be read.
    """
    table = next(folder / name for name in TACTIP_TABLES if (folder / name).is_file())
    images = next(folder / name for name in TACTIP_FOLDERS if (folder / name).is_dir())
    return with_table(table, images, columns, "a TacTip toolchain's folder")


def of_classes(folder: Path) -> Source:
    """Read a folder that contains a folder of images for each class, whose name is the label.

    Images directly in the folder have no label. If the inner folders are parts of a split (``train``, ``test`` and so
    on), the folders within them are the classes.

    Raises:
        InputError: The folder cannot be listed.
    """
    samples: list[Sample] = []
    left_out: list[LeftOut] = []
    files = sorted(files_below(folder))
    folders = {path.relative_to(folder).parts[0] for path in files if path.parent != folder}
    depth = 1 if folders and all(name.lower() in SPLITS for name in folders) else 0
    note = f"{folder.name}: {', '.join(sorted(folders))} are parts of a split; the folders within them are the classes"
    for path in files:
        name = path.relative_to(folder)
        if is_image_file(path):
            fields = {"label": name.parts[depth]} if len(name.parts) > depth + 1 else {}
            samples.append(_sample(str(name), fields, path, folder))
        elif not path.name.startswith("."):
            left_out.append(LeftOut(where=str(name), reason=f"is not an image ({', '.join(SUFFIXES)})"))
    kind = "one folder of images for each class" if any(sample.fields for sample in samples) else "a folder of images"
    notes = (note,) if depth else ()
    return Source(kind=kind, path=folder, samples=samples, left_out=tuple(left_out), notes=notes, threads=True)


def files_below(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and in all folders within it. Links to folders are not followed.

    Raises:
        InputError: A folder cannot be listed.
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
    """Return why a file name in a table is refused; an empty text if it is allowed."""
    if not name:
        return f"has no {what}"
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or Path(name).is_absolute() or "\0" in name:
        return "is a path outside the folder"
    return ""


def _inside(name: str, folder: Path) -> str:
    """Make an absolute path in a folder relative to the folder. Other names are returned unchanged."""
    path = Path(name)
    return str(path.relative_to(folder.absolute())) if path.is_relative_to(folder.absolute()) else name


def _sample(name: str, fields: Mapping[str, str], path: Path, within: Path, row: str = "") -> Sample:
    load: Callable[[], Loaded] = partial(door.read_bytes, path, "image", "image", within=within)
    return Sample(name=name, row=row, fields=fields, load=load)
