"""The kinds of sources that can be imported, and how each is recognised."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.importing import arrays, authors, huggingface, images, videos
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
        authors: The options for files of the paper's authors.
    """

    kind: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    names: Path | None = None
    authors: authors.AuthorsOptions = field(default_factory=authors.AuthorsOptions)

    def __post_init__(self) -> None:
        if self.kind is not None:
            one_of("kind", self.kind, KINDS)


@dataclass(frozen=True, kw_only=True)
class Paths:
    """The tables and the videos among the paths that the user gave."""

    tables: tuple[Path, ...]
    videos: tuple[Path, ...]

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


#: The functions that read a source, by the values of ``--kind``.
KINDS: Mapping[str, Callable[[Path, Paths, ImportOptions], Source]] = {
    "images": _with_table,
    "folders": lambda path, paths, options: images.of_classes(path),
    "tactip": lambda path, paths, options: images.of_toolchain(path, options.columns),
    "arrays": lambda path, paths, options: arrays.of_array(path, paths.table(path), options.columns),
    "videos": _of_videos,
    "huggingface": lambda path, paths, options: huggingface.of_dataset(path, options.columns),
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
    named = Paths(tables=tables, videos=of_videos)
    if not paths:
        raise InputError("paths", None, "there are none; give the folders or files to import")
    if len(tables) > 1 and (rest or of_videos):
        raise InputError("paths", str(tables[1]), "is a second table; import each table with its images separately")
    units = [*rest, *of_videos[:1]] or list(tables)
    for unit in units:
        try:
            for path in _unfolded(unit, options):
                try:
                    kind = options.kind or _recognised(path, named, options)
                    yield KINDS[kind](path, named, options)
                except (InputError, CheckFailedError) as error:
                    yield _left_out(path, error)
        except (InputError, CheckFailedError) as error:
            yield _left_out(unit, error)


def _left_out(path: Path, error: TacbenchError) -> LeftOut:
    """Return why a path is left out, without repeating its name."""
    repeated = isinstance(error, InputError) and error.value == str(path)
    return LeftOut(where=str(path), reason=error.allowed if repeated and isinstance(error, InputError) else str(error))


def _unfolded(path: Path, options: ImportOptions) -> list[Path]:
    """Return the files of a folder of arrays, or else the path itself."""
    if not path.is_dir() or options.kind not in (None, "arrays", "authors"):
        return [path]
    files = [each for each in sorted(path.iterdir()) if not each.name.startswith(".")]
    of_arrays = [each for each in files if each.suffix.lower() in arrays.SUFFIXES]
    # The folder may also contain tables. If it contains anything else, it is not a folder of arrays.
    return of_arrays if of_arrays and all(each in of_arrays or each.suffix == ".csv" for each in files) else [path]


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
    tables = any((folder / name).is_file() for name in images.TACTIP_TABLES)
    if tables and any((folder / name).is_dir() for name in images.TACTIP_FOLDERS):
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
