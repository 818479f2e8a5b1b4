"""Import of folders that a TacTip toolchain wrote: a table of targets, and images."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.lab.runs import (
    RUN_FILE,
    ImportFormat,
    ImportOptions,
    LeftOutFile,
    Paths,
    Source,
    files_below,
    is_image_file,
    natural_path,
    table_source,
)
from tacbench_cad.util.errors import InputError

#: The tables, of which the first that exists is used.
TABLES = ("targets_images.csv", "targets.csv")


def _table(folder: Path) -> Path | None:
    """Return the table of targets in a folder; None if there is none."""
    return next((folder / name for name in TABLES if (folder / name).is_file()), None)


def _folders(folder: Path) -> tuple[list[Path], list[LeftOutFile]]:
    """Find the folders of toolchains below a folder that is none itself, at any depth.

    Returns:
        The folders, and the images in no such folder.

    Raises:
        InputError: A folder cannot be listed.
    """
    if _table(folder) is not None:
        return [], []
    files = sorted(files_below(folder), key=natural_path)
    folders = list(dict.fromkeys(path.parent for path in files if path.name in TABLES))
    images = filter(is_image_file, files if folders else ())
    others = [path for path in images if not any(path.is_relative_to(each) for each in folders)]
    left_out = [
        LeftOutFile(
            where=f"{each} and others" if len(others) > 1 else str(each),
            reason="is not in a folder with a table of targets; import it separately",
            count=len(others),
        )
        for each in others[:1]
    ]
    return [each for each in folders if not (each / RUN_FILE).is_file()], left_out


def _read(path: Path, paths: Paths, options: ImportOptions) -> Source:
    table = _table(path) if path.is_dir() else path
    if table is None:
        raise InputError("folder", str(path), f"has no {' or '.join(TABLES)}")
    return table_source(table, table.parent, options.columns, "a TacTip toolchain's folder")


FORMAT = ImportFormat(
    recognises=lambda path, paths, _: path.is_dir() and not paths.tables and _table(path) is not None,
    read=_read,
    folders=_folders,
)
