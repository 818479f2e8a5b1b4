"""The kinds of sources that can be imported, and how each is recognised."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from tacbench_cad.lab.rig.colours import CHANNELS, OUTSIDE, Channels
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.importing import arrays, authors, companions, huggingface, images, videos
from tacbench_cad.lab.runs.importing.samples import LeftOut, Rows, Source
from tacbench_cad.util.errors import CheckFailedError, InputError, TacbenchError, one_of


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Options for reading sources.

    Args:
        kind: A key of :data:`KINDS`; None to recognise the kind.
        columns: The columns of tables, by field: ``{"label": "material"}``. See
            :data:`~tacbench_cad.lab.runs.importing.samples.FIELDS` for the fields.
        names: A TOML file that gives the names of the printers, filaments and labels for the words in the data.
        channels: The order of the colours in arrays, except in those of the paper's authors, which is known.
        authors: The options for files of the paper's authors.
    """

    kind: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    names: Path | None = None
    channels: Channels = OUTSIDE
    authors: authors.AuthorsOptions = field(default_factory=authors.AuthorsOptions)

    def __post_init__(self) -> None:
        if self.kind is not None:
            one_of("kind", self.kind, KINDS)
        one_of("channels", self.channels, CHANNELS)


@dataclass(frozen=True, kw_only=True)
class Paths:
    """The tables, the videos and the ``.npy`` files among the paths that the user gave."""

    tables: tuple[Path, ...]
    videos: tuple[Path, ...]
    arrays: tuple[Path, ...]
    _pairs: dict[Path, dict[Path, list[Path]]] = field(default_factory=dict)

    def table(self, path: Path) -> Path | None:
        """Return the table that belongs to a path.

        This is the table that the user gave, else the only table in the path if it is a folder, else the table with the
        name of the file. The result is None if there is no such table.
        """
        if self.tables:
            return self.tables[0]
        if path.is_dir():
            return _only_table(path)
        beside = path.with_suffix(".csv")
        return beside if beside.is_file() else None

    def describing(self, path: Path) -> list[Path]:
        """Return the ``.npy`` files that describe the frames in a file: other paths of the user, or files beside it."""
        if path.parent not in self._pairs:
            files = dict.fromkeys([*self.arrays, *sorted(path.parent.glob("[!.]*.npy"))])
            self._pairs[path.parent] = companions.pairs(list(files))
        return self._pairs[path.parent].get(path, [])


def _with_table(path: Path, paths: Paths, options: ImportOptions) -> Source:
    table = path if path.suffix.lower() == ".csv" else paths.table(path)
    if table is None:
        raise InputError("images", str(path), "has no table (CSV) of the images; add one, or use --kind folders")
    return images.with_table(table, path if path.is_dir() else table.parent, options.columns)


def _of_videos(path: Path, paths: Paths, options: ImportOptions) -> Source:
    table = path if path.suffix.lower() == ".csv" else paths.table(path)
    named = paths.videos if path.suffix.lower() in (".csv", *videos.SUFFIXES) else ()
    if path.is_dir():
        named = tuple(sorted(each for each in path.iterdir() if each.suffix.lower() in videos.SUFFIXES))
    return videos.of_videos(named, table, options.columns)


def _of_arrays(path: Path, paths: Paths, options: ImportOptions) -> Source:
    alone, beside = options.kind == "arrays", paths.describing(path)
    return arrays.of_array(path, paths.table(path), options.columns, beside, options.channels, alone)


#: The functions that read a source, by the values of ``--kind``.
KINDS: Mapping[str, Callable[[Path, Paths, ImportOptions], Source]] = {
    "images": _with_table,
    "folders": lambda path, paths, options: images.of_classes(path),
    "tactip": lambda path, paths, options: images.of_toolchain(path, options.columns),
    "arrays": _of_arrays,
    "videos": _of_videos,
    "huggingface": lambda path, paths, options: huggingface.of_dataset(path, options.columns, options.channels),
    "authors": lambda path, paths, options: authors.of_authors(path, options.authors),
}


def sources_of(paths: Sequence[Path], options: ImportOptions) -> Iterator[Source | LeftOut]:
    """Yield the source at each path, or the reason why it cannot be imported.

    If the paths contain a table (CSV) together with images, arrays or videos, the table describes these.

    Args:
        paths: Files and folders.
        options: The options for reading.

    Raises:
        InputError: There is no path, or there are several tables together with other data.
        MissingToolError: A package that a kind needs is not installed.
    """
    tables = tuple(path for path in paths if path.suffix.lower() == ".csv")
    of_videos = tuple(path for path in paths if path.suffix.lower() in videos.SUFFIXES)
    rest = [path for path in paths if path not in tables and path not in of_videos]
    of_arrays = [path for path in rest if path.suffix.lower() == ".npy"]
    named = Paths(tables=tables, videos=of_videos, arrays=tuple(of_arrays))
    described = [] if tables else set(of_arrays) - set(companions.pairs(of_arrays))
    rest = [path for path in rest if path not in described]
    if not paths:
        raise InputError("paths", None, "there are none; give the folders or files to import")
    if len(tables) > 1 and (rest or of_videos):
        raise InputError("paths", str(tables[1]), "is a second table; import each table with its images separately")
    units = [*rest, *of_videos[:1]] or list(tables)
    for unit in units:
        try:
            paths_of_unit, left_out = _unfolded(unit, named, options)
            yield from left_out
            for path in paths_of_unit:
                try:
                    kind = options.kind or _recognised(path, named, options)
                    yield replace(KINDS[kind](path, named, options), base=unit.absolute().parent)
                except (InputError, CheckFailedError) as error:
                    yield _left_out(path, error)
        except (InputError, CheckFailedError) as error:
            yield _left_out(unit, error)


def _left_out(path: Path, error: TacbenchError) -> LeftOut:
    """Return why a path is left out, without repeating its name."""
    repeated = isinstance(error, InputError) and error.value == str(path)
    return LeftOut(where=str(path), reason=error.allowed if repeated and isinstance(error, InputError) else str(error))


def _unfolded(path: Path, paths: Paths, options: ImportOptions) -> tuple[list[Path], list[LeftOut]]:
    """Return the files of a folder of arrays, or the folders of toolchains in a folder, or else the path itself.

    Returns:
        The paths, and images in the folder that belong to none of them.
    """
    if not path.is_dir() or (path / schema.RUN_FILE).is_file():
        return [path], []
    if options.kind in (None, "tactip") and not paths.tables and images.toolchain_table(path) is None:
        folders, others = images.toolchain_folders(path)
        folders = [folder for folder in folders if not (folder / schema.RUN_FILE).is_file()]
        reason = "is not in a folder with a table of targets; import it separately"
        if folders:
            return folders, [
                LeftOut(where=f"{each} and others" if len(others) > 1 else str(each), reason=reason, count=len(others))
                for each in others[:1]
            ]
    if options.kind in (None, "arrays", "authors"):
        files = sorted((each for each in path.iterdir() if not images.is_hidden(each)), key=images.natural_path)
        of_arrays = [each for each in files if each.suffix.lower() in arrays.SUFFIXES]
        # Beside arrays, the folder may have tables and notes. If it has images or folders, the user must say the kind.
        if of_arrays and (options.kind or not any(each.is_dir() or images.is_image_file(each) for each in files)):
            return (of_arrays if options.kind == "authors" else list(companions.pairs(of_arrays))), []
    return [path], []


def _only_table(folder: Path) -> Path | None:
    """Return the only table in a folder; None if there is none.

    Raises:
        InputError: There are several tables.
    """
    tables = sorted(path for path in folder.glob("[!.]*.csv") if path.is_file())
    if len(tables) > 1:
        names = ", ".join(table.name for table in tables[:6])
        raise InputError("folder", str(folder), f"has several tables ({names}); also give the path of the one to use")
    return tables[0] if tables else None


def _recognised(path: Path, paths: Paths, options: ImportOptions) -> str:
    """Recognise the kind of source at a path.

    Raises:
        InputError: The kind is unknown.
    """
    suffix = path.suffix.lower()
    if path.is_dir():
        return _recognised_folder(path, paths, options)
    if not path.exists():
        raise InputError("path", str(path), "does not exist")
    if suffix == ".csv":
        return "videos" if _names_videos(path, options) else "images"
    if suffix in arrays.SUFFIXES:
        return "authors" if authors.is_authors_file(path) else "arrays"
    if suffix in videos.SUFFIXES:
        return "videos"
    raise InputError(
        "path",
        str(path),
        "cannot be imported; it must be a folder, a table (.csv), arrays "
        f"({', '.join(arrays.SUFFIXES)}) or videos ({', '.join(videos.SUFFIXES)})",
    )


def _recognised_folder(folder: Path, paths: Paths, options: ImportOptions) -> str:
    if (folder / schema.RUN_FILE).is_file():
        raise InputError("path", str(folder), "is already a run folder")
    if any((folder / name).is_file() for name in (huggingface.SPLIT_FILE, huggingface.SPLITS_FILE)):
        return "huggingface"
    if images.toolchain_table(folder) is not None and not paths.tables:
        return "tactip"
    table = paths.table(folder)
    if table is not None:
        return "videos" if _names_videos(table, options) else "images"
    if not any(map(images.is_image_file, images.files_below(folder))):
        raise InputError("path", str(folder), "contains nothing to import: no images and no table")
    return "folders"


def _names_videos(table: Path, options: ImportOptions) -> bool:
    columns = Rows.read(table, options.columns).columns
    return "time" in columns and "image" not in columns
