"""Import of folders of images: with a table, or with a folder for each class."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePosixPath
from types import MappingProxyType

from tacbench_cad.lab.runs.importing.companions import Paths
from tacbench_cad.lab.runs.importing.sources import ImportOptions, LeftOutFile, Loaded, Rows, Sample, Source
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted, natural

#: The suffixes of images that can be read.
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
#: The number of kinds of other files that a note names.
MAX_KINDS = 8
#: The names of folders that are parts of a split, not classes.
SPLITS = ("train", "training", "val", "valid", "validation", "dev", "test")
#: The usual names of folders of images beside a table.
IMAGE_FOLDERS = ("processed_images", "sensor_images", "images", "frames_bw")
#: The number of names of images by which the folder of the images is found.
MAX_PROBES = 100


def is_image_file(path: Path) -> bool:
    """Return whether a file has the suffix of an image."""
    return path.suffix.lower() in SUFFIXES and not is_hidden(path)


def has_images(folder: Path) -> bool:
    """Return whether a folder, or a folder within it, has an image."""
    return any(map(is_image_file, files_below(folder)))


def is_hidden(path: Path) -> bool:
    """Return whether the name of a file says that people should not see it: ``.DS_Store``."""
    return path.name.startswith(".")


def natural_path(path: Path) -> tuple[object, ...]:
    """Return the key that sorts paths as people do."""
    return tuple(natural(part) for part in path.parts)


def of_images(path: Path, paths: Paths, options: ImportOptions) -> Source:
    """Read the images of a folder or of a table.

    Raises:
        InputError: There is no table, or same as for :func:`table_source`.
    """
    table = paths.table(path)
    if table is None:
        raise InputError("images", str(path), "has no table (CSV) of the images; add one, or use --kind folders")
    return table_source(table, path if path.is_dir() else table.parent, options.columns)


def table_source(table: Path, folder: Path, columns: Mapping[str, str], kind: str = "images with a table") -> Source:
    """Read images that a table lists by their paths, relative to a folder or to one of the folders in it.

    Raises:
        InputError: The table cannot be read, or has no column of images.
    """
    rows = Rows.read(table, columns)
    if "image" not in rows.columns:
        what = f"has no column of images; choose one with --columns image=COLUMN ({', '.join(rows.unused)})"
        raise InputError("table", str(table), f"{what}, or leave the table aside with --kind folders")
    names = [_inside(fields.get("image", ""), folder) for _, fields, _ in rows.rows]
    folder, notes = _folder_of(names, folder)
    samples: list[Sample] = []
    left_out: list[LeftOutFile] = []
    seen: dict[str, str] = {}
    for name, (where, fields, texts) in zip(names, rows.rows, strict=True):
        fields.pop("image", "")
        reason = name_fault(name, "image")
        if not reason and seen.setdefault(name, where) != where:
            reason = f"has the same image as {seen[name]}"
        if reason:
            left_out.append(LeftOutFile(where=f"{where} ({name})", reason=reason))
        else:
            samples.append(_sample(name, fields, folder / name, folder, where, texts))
    return Source(
        kind=kind,
        path=table,
        samples=samples,
        left_out=tuple(left_out),
        facts={"columns": dict(rows.columns)},
        notes=(rows.note, *notes),
        threads=True,
    )


def _folder_of(names: Sequence[str], folder: Path) -> tuple[Path, tuple[str, ...]]:
    """Return the folder that the names of images are relative to, and a note if it could be another.

    It is the folder itself if it has one of the images, else the folder in it that has the most of them. Of several, it
    is the first of :data:`IMAGE_FOLDERS`, or else the first by name.
    """
    good = [name for name in dict.fromkeys(names) if not name_fault(name, "image")]
    probes = good[:: max(1, len(good) // MAX_PROBES)]
    if any(_is_file(folder / name) for name in probes):
        return folder, ()
    order = {name: number for number, name in enumerate(IMAGE_FOLDERS)}
    below = [path for path in _listed(folder) if path.is_dir()]
    below.sort(key=lambda path: (order.get(path.name, len(order)), natural(path.name)))
    counts = {path: sum(_is_file(path / name) for name in probes) for path in below}
    most = max(counts.values(), default=0)
    best, *others = [path for path in below if counts[path] == most > 0] or [folder]
    rest = ", ".join(path.name for path in others)
    note = f"{folder.name}: the images in {best.name} are used; images of the same names are in {rest}"
    return best, (note,) if others else ()


def _is_file(path: Path) -> bool:
    with suppress(OSError):  # a name can be too long
        return path.is_file()
    return False


def of_classes(folder: Path) -> Source:
    """Read a folder that contains a folder of images for each class, whose name is the label.

    Images directly in the folder have no label. If the inner folders are parts of a split (``train``, ``test`` and so
    on), the folders within them are the classes.

    Raises:
        InputError: The folder cannot be listed.
    """
    samples: list[Sample] = []
    files = sorted(files_below(folder), key=natural_path)
    images = [path for path in files if is_image_file(path)]
    others = Counter(path.suffix.lower() or path.name for path in files if not (is_image_file(path) or is_hidden(path)))
    folders = {path.relative_to(folder).parts[0] for path in images if path.parent != folder}
    depth = 1 if folders and all(name.lower() in SPLITS for name in folders) else 0
    note = f"{folder.name}: {', '.join(sorted(folders))} are parts of a split; the folders within them are the classes"
    for path in images:
        name = path.relative_to(folder)
        fields = {"label": name.parts[depth]} if len(name.parts) > depth + 1 else {}
        samples.append(_sample(str(name), fields, path, folder))
    kind = "one folder of images for each class" if any(sample.fields for sample in samples) else "a folder of images"
    notes = [note] if depth else []
    if others:
        kinds = ", ".join(f"{count:,} {suffix}" for suffix, count in others.most_common(MAX_KINDS))
        notes.append(f"{folder.name}: {counted(others.total(), 'other file')} not imported: {kinds}")
    return Source(kind=kind, path=folder, samples=samples, notes=tuple(notes), threads=True)


def files_below(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and in all folders within it. Links to folders are not followed.

    Raises:
        InputError: A folder cannot be listed.
    """
    for path in _listed(folder):
        if path.is_dir() and not path.is_symlink():
            yield from files_below(path)
        else:
            yield path


def _listed(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
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


def _sample(
    name: str,
    fields: Mapping[str, str],
    path: Path,
    within: Path,
    row: str = "",
    columns: Mapping[str, str] = MappingProxyType({}),
) -> Sample:
    load: Callable[[], Loaded] = partial(untrusted.read_bytes, path, "image", "image", within=within)
    return Sample(name=name, row=row, fields=fields, load=load, file=path, columns=columns)
