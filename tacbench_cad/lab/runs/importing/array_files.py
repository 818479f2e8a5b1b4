"""Import of arrays of frames, such as ``.npy`` and ``.npz`` files, with a row of a table for each frame."""

from __future__ import annotations

import shutil
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.runs.importing import companions
from tacbench_cad.lab.runs.importing.companions import Paths
from tacbench_cad.lab.runs.importing.sources import (
    ImportOptions,
    LeftOutFile,
    Loaded,
    Rows,
    Sample,
    Source,
    columns_of_fields,
)
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.npyfile import mapped

#: The suffixes of files with arrays.
SUFFIXES = (".npy", ".npz")
#: The largest allowed size of a frame, in MB; the same as for the file of an image.
MAX_FRAME_MB = untrusted.MAX_MB["image"]
#: What the reading of a damaged zip file raises.
_ZIP_ERRORS = (OSError, EOFError, ValueError, RuntimeError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True, kw_only=True)
class Frames:
    """An array of frames that is read one frame at a time.

    Args:
        shape: The shape of the whole array. The first axis counts the frames.
        frame: A function that returns the frame with an index.
        columns: The columns in the file itself, with a value for each frame.
    """

    shape: tuple[int, ...]
    frame: Callable[[int], NDArray[Any]]
    columns: Mapping[str, Sequence[str]]


def of_arrays(path: Path, paths: Paths, options: ImportOptions) -> Source:
    """Read the frames of a ``.npy`` or ``.npz`` file.

    Raises:
        InputError: The file cannot be read, or same as for :func:`array_source`.
    """
    return array_source(path, opened(path, options.columns.get("array", "")), paths, options)


def array_source(path: Path, frames: Frames, paths: Paths, options: ImportOptions, kind: str = "arrays") -> Source:
    """Return the source with the frames of a file of arrays.

    The table of the file has a row for each frame, or a column ``index`` with the frame's number from 0. Without a
    table, columns in the file and other ``.npy`` files describe the frames.

    Args:
        path: The file.
        frames: The frames in the file.
        paths: The paths that the user gave.
        options: The options. Frames without any description are imported only if they name a kind.
        kind: The name of the format, for messages.

    Raises:
        InputError: The frames do not match the table, or nothing describes them.
    """
    table, columns, beside, channels = paths.table(path), options.columns, paths.describing(path), options.channels
    described = dict(frames.columns)
    for other in beside:
        described |= companions.columns_of_array(other.stem, np.array(mapped(other, texts=True)))
    count = frames.shape[0]
    size = np.prod(frames.shape[1:], dtype=float) * 8 / 1e6
    untrusted.require_within("frame", size, MAX_FRAME_MB, "MB", str(path))
    if table is not None:
        rows = Rows.read(table, columns)
    elif described or options.kind:
        texts = list(zip(*described.values(), strict=True)) if described else [()] * count
        rows = Rows.of(path.name, list(described), texts, _with_label(path.name, columns, described), line=0)
    else:
        raise InputError(
            "array",
            str(path),
            f"has {count:,} frames without labels; also give a table (CSV) with a row for each frame or an array of "
            f"labels (.npy), or import them without labels with --kind {kind}",
        )
    if "index" not in rows.columns and len(rows.rows) != count:
        raise InputError("table", rows.name, f"has {len(rows.rows):,} rows, but {path.name} has {count:,} frames")
    samples: list[Sample] = []
    left_out: list[LeftOutFile] = []
    for number, (where, fields, of_row) in enumerate(rows.rows):
        word = fields.pop("index", str(number) if "index" not in rows.columns else "")
        if not word.isdecimal() or len(word) > 12 or int(word) >= count:
            left_out.append(
                LeftOutFile(
                    where=f"{where} ({word})", reason=f"is not a frame of {path.name}, which has 0 to {count - 1:,}"
                )
            )
            continue
        load: Callable[[], Loaded] = partial(frames.frame, int(word))
        samples.append(
            Sample(
                name=f"{path.name} frame {word}",
                row=where,
                fields=fields,
                load=load,
                file=path,
                index=int(word),
                columns=of_row,
                channels=channels,
            )
        )
    colours = len(frames.shape) == 4 and frames.shape[3] == 3
    unused = f"{', '.join(other.name for other in beside)}: not used, because {rows.name} describes {path.name}"
    order = f"{path.name}: the order of the colours is {channels.upper()} (--channels)"
    return Source(
        kind=f"a file of arrays ({path.suffix.lower()})",
        path=path,
        samples=samples,
        left_out=tuple(left_out),
        files=(path,),
        facts={"columns": dict(rows.columns)} | ({"channels": channels} if colours else {}),
        notes=(rows.note, *([order] if colours else []), *([unused] if table is not None and beside else [])),
    )


def _with_label(name: str, columns: Mapping[str, str], described: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the chosen columns, with the column of labels if a name such as ``y`` gives it away."""
    label = companions.label_column(described)
    if label is None or "label" in columns_of_fields(name, list(described), columns) or label in columns.values():
        return dict(columns)
    return {**columns, "label": label}


def opened(path: Path, name: str = "") -> Frames:
    """Open the array of frames in a file.

    Args:
        path: The file.
        name: The name of the array in a ``.npz`` file; empty for the only array that can have frames.

    Raises:
        InputError: The file cannot be read, or has no array of frames, or several.
    """
    if path.suffix.lower() == ".npz":
        return _of_zip(path, name)
    array = mapped(path)
    require_frames(path, array.shape)
    return Frames(shape=array.shape, frame=lambda index: np.array(array[index]), columns={})


def require_frames(path: Path, shape: tuple[int, ...]) -> None:
    """Check that the first axis of an array counts frames.

    Raises:
        InputError: It does not.
    """
    if len(shape) < 2 or 0 in shape:
        raise InputError("array", str(path), f"has shape {shape}; the first axis must count frames")


def array_name(path: Path, shapes: Mapping[str, tuple[int, ...]], name: str) -> str:
    """Return the name of the array of frames in a file: the given name, or else the only array with the most axes.

    Raises:
        InputError: There is no array with this name, or no single array of frames.
    """
    if name:
        return one_of("columns array", name, shapes)
    most = max((len(shape) for shape in shapes.values()), default=0)
    fitting = [word for word, shape in shapes.items() if len(shape) == most > 1]
    if len(fitting) != 1:
        words = ", ".join(f"{word} {shape}" for word, shape in list(shapes.items())[:8]) or "none"
        raise InputError(
            "array", str(path), f"has no single array of frames; choose one with --columns array=NAME ({words})"
        )
    return fitting[0]


def _of_zip(path: Path, name: str) -> Frames:
    """Open the array of frames in a ``.npz`` file, whose arrays are unpacked into files that last as long as it."""
    untrusted.open_input(path, kind="array").close()
    folder = TemporaryDirectory(prefix="tacbench-")
    arrays: dict[str, NDArray[Any]] = {}
    faults: dict[str, InputError] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for number, entry in enumerate(archive.infolist()):
                word = entry.filename.removesuffix(".npy")
                untrusted.require_within(word, entry.file_size / 1e6, untrusted.MAX_MB["array"], "MB", str(path))
                unpacked = Path(folder.name) / f"{number}.npy"
                with archive.open(entry) as source, unpacked.open("wb") as stream:
                    shutil.copyfileobj(source, stream)
                try:
                    arrays[word] = mapped(unpacked, texts=True)
                except InputError as error:
                    faults[word] = InputError("array", str(path), f"{entry.filename} {error.allowed}")
    except _ZIP_ERRORS as error:
        raise InputError("file", str(path), f"is not a complete .npz file: {error}") from None
    numbers = {word: array.shape for word, array in arrays.items() if array.dtype.kind in "biuf"}
    if faults and (name in faults or not any(len(shape) > 1 for shape in numbers.values())):
        raise next(iter(faults.values()))
    chosen = arrays[array_name(path, numbers, name)]
    require_frames(path, chosen.shape)
    columns: dict[str, list[str]] = {}
    for word, array in arrays.items():
        if companions.describes_frames(word, array.shape, chosen.shape):
            untrusted.require_within(word, array.nbytes / 1e6, untrusted.MAX_MB["table"], "MB", str(path))
            columns |= companions.columns_of_array(word, np.array(array))

    def frame(index: int, _files: TemporaryDirectory[str] = folder) -> NDArray[Any]:
        return np.array(chosen[index])

    return Frames(shape=chosen.shape, frame=frame, columns=columns)
