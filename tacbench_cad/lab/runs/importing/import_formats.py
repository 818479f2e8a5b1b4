"""The formats of frames that can be imported, and how each is recognised.

Images and arrays are here. Other formats come from extensions and other packages, by the entry-point group
``tacbench.formats``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.importing import array_files, companions, image_folders
from tacbench_cad.lab.runs.importing.companions import Paths
from tacbench_cad.lab.runs.importing.sources import ImportOptions, LeftOutFile, Source
from tacbench_cad.util.entries import entries, load
from tacbench_cad.util.errors import CheckFailedError, InputError, MissingToolError, TacbenchError, one_of

#: The entry-point group of the formats that extensions and other packages add.
GROUP = "tacbench.formats"


@dataclass(frozen=True, kw_only=True)
class ImportFormat:
    """A format of frames. Its name is that of its entry point.

    Args:
        recognises: A function that returns whether a path that exists has this format.
        read: A function that reads the source at a path. It raises an InputError or a CheckFailedError if it cannot.
        suffixes: The suffixes of its files, in lower case.
        together: Whether all files of the user with these suffixes are one source, which one table describes. Otherwise
            each file is a source, and the command imports all of them that are in a folder.
        folders: A function that returns the folders of this format below a folder, and what is left out there.
        check_options: A function that raises an InputError if ``ImportOptions.of_format`` has a wrong option; None
            if the format has no options.
    """

    recognises: Callable[[Path, Paths, ImportOptions], bool]
    read: Callable[[Path, Paths, ImportOptions], Source]
    suffixes: tuple[str, ...] = ()
    together: bool = False
    folders: Callable[[Path], tuple[list[Path], list[LeftOutFile]]] | None = None
    check_options: Callable[[Mapping[str, str]], object] | None = None


#: The formats that are always there, by name, in the order in which they are tried.
CORE: Mapping[str, ImportFormat] = {
    "images": ImportFormat(
        recognises=lambda path, paths, _: (
            (path.is_dir() or path.suffix.lower() == ".csv") and paths.table(path) is not None
        ),
        read=image_folders.of_images,
        suffixes=(".csv",),
        together=True,
    ),
    "folders": ImportFormat(
        recognises=lambda path, *_: path.is_dir() and image_folders.has_images(path),
        read=lambda path, *_: image_folders.of_classes(path),
    ),
    "arrays": ImportFormat(
        recognises=lambda path, *_: path.suffix.lower() in array_files.SUFFIXES,
        read=array_files.of_arrays,
        suffixes=array_files.SUFFIXES,
    ),
}


def format_names() -> list[str]:
    """Return the names of all formats, also of those whose extension is not installed."""
    return [*CORE, *(name for name in entries(GROUP) if name not in CORE)]


class _Formats:
    """The formats to try for the user's paths, in order: those of extensions and other packages come first."""

    def __init__(self, kind: str | None) -> None:
        if kind is not None:
            one_of("kind", kind, format_names())
        self.by_name: dict[str, ImportFormat] = {}
        self.missing: list[str] = []
        for name, entry in entries(GROUP).items():
            if name not in CORE and kind in (None, name):
                try:
                    self.by_name[name] = load(entry)
                except MissingToolError:
                    if kind is not None:
                        raise
                    self.missing.append(name)
        self.by_name |= {name: each for name, each in CORE.items() if kind in (None, name)}

    def suffixes(self, together: bool) -> tuple[str, ...]:
        """Return the suffixes of files that are, or are not, one source with one table."""
        return tuple(suffix for each in self.by_name.values() if each.together == together for suffix in each.suffixes)

    def recognised(self, path: Path, paths: Paths, options: ImportOptions) -> ImportFormat:
        """Return the format of a path.

        Raises:
            InputError: The path has no known format.
        """
        if options.kind is not None:
            return self.by_name[options.kind]
        if not path.exists():
            raise InputError("path", str(path), "does not exist")
        if (path / schema.RUN_FILE).is_file():
            raise InputError("path", str(path), "is already a run folder")
        for each in self.by_name.values():
            if each.recognises(path, paths, options):
                return each
        if path.is_dir():
            raise InputError("path", str(path), "contains nothing to import: no images and no table")
        suffixes = ", ".join(sorted({*self.suffixes(together=True), *self.suffixes(together=False)}))
        raise InputError(
            "path", str(path), f"cannot be imported; give a folder or a file with one of the suffixes {suffixes}"
        )

    def left_out(self, path: Path, error: TacbenchError) -> LeftOutFile:
        """Return why a path is left out, without repeating its name, and which formats are not installed."""
        repeated = isinstance(error, InputError) and error.value == str(path)
        reason = error.allowed if repeated and isinstance(error, InputError) else str(error)
        if self.missing:
            packages = sorted({".".join(entries(GROUP)[name].module.split(".")[:3]) for name in self.missing})
            reason += f"; the formats {', '.join(self.missing)} need {', '.join(packages)}, which is not installed"
        return LeftOutFile(where=str(path), reason=reason)


def sources_of(paths: Sequence[Path], options: ImportOptions) -> Iterator[Source | LeftOutFile]:
    """Yield the source at each path, or the reason why it cannot be imported.

    If the paths contain a table (CSV) together with images, arrays or videos, the table describes these.

    Args:
        paths: Files and folders.
        options: The options for reading.

    Raises:
        InputError: There is no path, there are several tables together with other data, or an option is wrong.
        MissingToolError: A package that a format needs is not installed.
    """
    formats = _Formats(options.kind)
    if options.of_format:
        check = formats.by_name[options.kind].check_options if options.kind else None
        if check is None:
            kind = "is missing" if options.kind is None else f"{options.kind} has no such options"
            raise InputError("format options", dict(options.of_format), f"they belong to a kind of data; --kind {kind}")
        check(options.of_format)
    if not paths:
        raise InputError("paths", None, "there are none; give the folders or files to import")
    named = Paths(given=tuple(paths))
    for unit in _units(named, formats):
        try:
            paths_of_unit, left_out = _unfolded(unit, named, options, formats)
            yield from left_out
            for path in paths_of_unit:
                try:
                    source = formats.recognised(path, named, options).read(path, named, options)
                    yield replace(source, base=unit.absolute().parent)
                except (InputError, CheckFailedError) as error:
                    yield formats.left_out(path, error)
        except (InputError, CheckFailedError) as error:
            yield formats.left_out(unit, error)


def _units(paths: Paths, formats: _Formats) -> list[Path]:
    """Return the paths that are sources, without the tables and arrays that describe them.

    Raises:
        InputError: There are several tables together with other data.
    """
    of_arrays = paths.with_suffix(".npy")
    described = set() if paths.tables else set(of_arrays) - set(companions.pairs(of_arrays))
    together = [suffix for suffix in formats.suffixes(together=True) if suffix != ".csv"]
    each = [path for path in paths.given if path.suffix.lower() not in (".csv", *together) and path not in described]
    units = [*each, *paths.with_suffix(*together)[:1]]
    if len(paths.tables) > 1 and units:
        what = "is a second table; import each table with its images separately"
        raise InputError("paths", str(paths.tables[1]), what)
    return units or list(paths.tables)


def _unfolded(
    path: Path, paths: Paths, options: ImportOptions, formats: _Formats
) -> tuple[list[Path], list[LeftOutFile]]:
    """Return the files of a folder of arrays, or the folders of a format in a folder, or else the path itself.

    Returns:
        The paths, and images in the folder that belong to none of them.
    """
    if not path.is_dir() or (path / schema.RUN_FILE).is_file():
        return [path], []
    for each in formats.by_name.values():
        if each.folders is not None and not paths.tables:
            folders, left_out = each.folders(path)
            if folders:
                return folders, left_out
    files = sorted(
        (each for each in path.iterdir() if not image_folders.is_hidden(each)), key=image_folders.natural_path
    )
    suffixes = formats.suffixes(together=False)
    found = [each for each in files if each.suffix.lower() in suffixes]
    # Beside arrays, the folder may have tables and notes. If it has images or folders, the user must say the kind.
    if found and (options.kind or not any(each.is_dir() or image_folders.is_image_file(each) for each in files)):
        return list(companions.pairs(found)), []
    return [path], []
