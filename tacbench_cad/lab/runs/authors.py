"""Import of the authors' published data: one NumPy file for each block, printer, filament and force level.

``PLAminus_z0_P30_Bambu.npy`` is ``<filament>_z<texture - 1>[.<copy>]_P<level>_<printer>.npy``; an array of uint8,
(1, repeats, 5, 5, height, width, 3) or (repeats * 25, height, width, 3), BGR. Which axis of the 5 x 5 positions is x
is written nowhere. It is read as ours are: the first index counts the rows (y), the second the columns (x), both
rising; the scripts that the authors publish for their sliding tests loop so too (y outside, x inside, there with x
falling). The other order is an option. The contact forces are the paper's nominal ones; nobody measured them for each
press.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.npyfile import mapped, read_header
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.schema import RUN_FILE
from tacbench_cad.lab.runs.writing import RunWriter
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N, PER_SIDE, PressGrid, Spacing
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import sha256
from tacbench_cad.util.packages import require

FirstAxis = Literal["x", "y"]
#: The force levels of the authors' file names.
LEVELS: Mapping[str, int] = {"P30": 1, "P40": 2, "P50": 3}
#: Press positions of a block.
POSITIONS = PER_SIDE * PER_SIDE
_NAME = re.compile(
    r"(?P<filament>[^_]+)_z(?P<texture>\d+)(?:\.(?P<copy>\d+))?_(?P<level>[Pp]\d+)_(?P<printer>[^_]+)\.npy"
)
_NAME_TEXT = "must be named <filament>_z<texture - 1>[.<copy>]_P<level>_<printer>.npy, as PLAminus_z0_P30_Bambu.npy"


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """How the authors' files are read where they leave it open.

    Args:
        force_levels: What the file names call each force level, and its number from 1.
        first_axis: Which axis of the block the first index of the 5 x 5 positions runs along.
        unnumbered_copy: The copy that a name without a number is.
        preset: The blocks' geometry; the authors printed what they ``released``.
        spacing: Which reading of the press grid is taken along y.
    """

    force_levels: Mapping[str, int] = field(default_factory=lambda: dict(LEVELS))
    first_axis: FirstAxis = "y"
    unnumbered_copy: int = 1
    preset: str = "released"
    spacing: Spacing = "even"

    def __post_init__(self) -> None:
        if self.first_axis not in ("x", "y"):
            raise InputError("first-axis", self.first_axis, "allowed: x, y")
        numbers = list(self.force_levels.values())
        if not numbers or len(set(numbers)) < len(numbers):
            raise InputError("force-levels", dict(self.force_levels), "must name each level's number once")
        for word, number in self.force_levels.items():
            if not re.fullmatch(r"P\d+", word):
                raise InputError("force-levels", word, "must be as P30")
            if not 1 <= number <= len(FORCES_N):
                raise InputError("force-levels", number, f"must be from 1 to {len(FORCES_N)}, the paper's forces")

    def position(self, i: int, j: int) -> int:
        """Our number of the position that the authors' array has at ``[i, j]``."""
        row, column = (i, j) if self.first_axis == "y" else (j, i)
        return row * PER_SIDE + column + 1


@dataclass(frozen=True, kw_only=True)
class AuthorsFile:
    """One of the authors' files, by its name and header; nothing else was read yet.

    Args:
        path: The file.
        texture: Number of its texture, 1 to 6.
        printer: Our name of its printer.
        filament: Our name of its filament.
        copy: Its copy.
        level: Its force level, from 1.
        repeats: Readings at each position.
        image_shape: (height, width, 3).
    """

    path: Path
    texture: int
    printer: str
    filament: str
    copy: int
    level: int
    repeats: int
    image_shape: tuple[int, int, int]

    @property
    def block(self) -> tuple[str, str, int, int]:
        """What it is of: printer, filament, texture, copy."""
        return (self.printer, self.filament, self.texture, self.copy)

    @classmethod
    def of(cls, path: Path, how: ImportOptions) -> AuthorsFile:
        """Read a file's name and header.

        Raises:
            InputError: The name, a spelling in it, or the array's type or shape is not one of the authors'.
        """
        if path.is_dir():
            raise InputError("file", str(path), f"is a folder; name its files, as {path}/*.npy")
        named = _NAME.fullmatch(path.name)
        if named is None:
            raise InputError("file", str(path), _NAME_TEXT)
        texture = int(named["texture"]) + 1
        if texture > 6:
            raise InputError("file", str(path), f"z{named['texture']} is no texture; z0 to z5 are textures 1 to 6")
        level = how.force_levels.get(named["level"].upper())
        if level is None:
            known = ", ".join(f"{word}={number}" for word, number in how.force_levels.items())
            raise InputError("file", str(path), f"{named['level']} is no known force level; --force-levels has {known}")
        copy = int(named["copy"]) if named["copy"] else how.unnumbered_copy
        if not 1 <= copy <= 999:
            raise InputError("file", str(path), f"copy {copy} must be from 1 to 999")
        try:
            printer, filament = names.printer(named["printer"]), names.filament(named["filament"])
        except InputError as error:
            raise InputError(f"{path}: {error.field}", error.value, error.allowed) from None
        repeats, shape = _layout(path)
        return cls(
            path=path,
            texture=texture,
            printer=printer,
            filament=filament,
            copy=copy,
            level=level,
            repeats=repeats,
            image_shape=shape,
        )

    def frames(self) -> NDArray[Any]:
        """The images, mapped into memory: uint8, (repeats, 5, 5, height, width, 3)."""
        try:
            return mapped(self.path).reshape(self.repeats, PER_SIDE, PER_SIDE, *self.image_shape)
        except CheckFailedError as error:
            raise InputError("file", str(self.path), str(error)) from None


def _layout(path: Path) -> tuple[int, tuple[int, int, int]]:
    """Repeats and image shape of an array in one of the two layouts."""
    try:
        header = read_header(path)
    except CheckFailedError as error:
        raise InputError("file", str(path), str(error)) from None
    if header.dtype != np.uint8:
        raise InputError("file", str(path), f"holds {header.dtype}; the authors' images are uint8")
    shape = header.shape
    if len(shape) == 7 and shape[0] == 1 and shape[2:4] == (PER_SIDE, PER_SIDE):
        repeats = shape[1]
    elif len(shape) == 4 and shape[0] % POSITIONS == 0:
        repeats = shape[0] // POSITIONS
    else:
        repeats = 0
    if repeats < 1 or header.fortran or shape[-1] != 3 or min(shape[-3:-1]) < 8:
        raise InputError(
            "file", str(path), f"has shape {shape}; (1, 2, 5, 5, 480, 640, 3) and (50, 480, 640, 3) are the authors'"
        )
    return repeats, (shape[-3], shape[-2], 3)


@dataclass(frozen=True, kw_only=True)
class AuthorsBlock:
    """The authors' files of one printed block.

    Args:
        files: One for each force level, rising.
        how: How they are read.
    """

    files: tuple[AuthorsFile, ...]
    how: ImportOptions

    def __post_init__(self) -> None:
        first = self.files[0]
        for one in self.files[1:]:
            if (one.repeats, one.image_shape) != (first.repeats, first.image_shape):
                raise InputError(
                    "file",
                    str(one.path),
                    f"has {one.repeats} x 25 images of {one.image_shape}, {first.path.name} of the same block has "
                    f"{first.repeats} x 25 of {first.image_shape}",
                )

    @property
    def printed(self) -> PrintedBlock:
        """The block."""
        first = self.files[0]
        block = Block.of(first.texture, self.how.preset)
        return PrintedBlock(block=block, printer=first.printer, filament=first.filament, copy=first.copy)

    @property
    def info(self) -> RunInfo:
        """The run that the files become; their checksums are computed here."""
        first = self.files[0]
        protocol = Protocol(repeats=first.repeats, grid=PressGrid.paper(spacing=self.how.spacing), stationary_frames=0)
        source = {
            "kind": "the authors' NumPy files",
            "first_axis": self.how.first_axis,
            "forces": "nominal, not measured",
            "files": [
                {"name": one.path.name, "sha256": sha256(one.path), "force_level": one.level} for one in self.files
            ],
        }
        return RunInfo(
            printed=self.printed,
            levels=tuple(one.level for one in self.files),
            protocol=protocol,
            grid_spacing=self.how.spacing,
            holder=HolderRim(),
            frame=WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
            slot=0,
            stage={"identity": "the authors' rig", "simulated": "", "settings": {"driver": "arduino"}},
            gauge={"identity": "none recorded", "simulated": ""},
            sensor={
                "name": "the authors' TacTip",
                "simulated": "",
                "units": "counts",
                "shape": list(first.image_shape),
                "settings": {"requested": {}, "actual": {}},
            },
            source=source,
        )


def gather_authors_files(paths: Sequence[Path], how: ImportOptions) -> list[AuthorsBlock]:
    """Sort files by printed block; names and headers are read, and every one of them is checked.

    Args:
        paths: The files.
        how: How they are read.

    Returns:
        The blocks, by printer, filament, texture and copy.

    Raises:
        InputError: A file is not one of the authors', or two are of the same block and force level.
    """
    sorted_: dict[tuple[str, str, int, int], dict[int, AuthorsFile]] = {}
    for path in paths:
        one = AuthorsFile.of(path, how)
        levels = sorted_.setdefault(one.block, {})
        if one.level in levels:
            raise InputError(
                "file",
                str(path),
                f"is of the same block, copy and force level as {levels[one.level].path}; where a name without a copy "
                "number is another copy, say which with --unnumbered-copy",
            )
        levels[one.level] = one
    return [
        AuthorsBlock(files=tuple(one for _, one in sorted(levels.items())), how=how)
        for _, levels in sorted(sorted_.items())
    ]


def import_block(block: AuthorsBlock, out: Path, progress: Callable[[int, int], None] | None = None) -> Path:
    """Write one block's files as a run folder, or go on where an earlier import was interrupted.

    One force level is mapped at a time and one image copied at a time, so the memory taken does not grow.

    Args:
        block: The block.
        out: The folder for the run folders.
        progress: Told the images that are there and their number.

    Returns:
        The run folder.

    Raises:
        InputError: The run folder holds another import, or cannot be written; or a file is there already as another
            block or copy, which would count one print twice.
        MissingToolError: OpenCV is not installed.
    """
    require("the import of images", "cv2")
    info = block.info
    folder = out / info.printed.name
    _refuse_a_second_copy(block, info, out, folder)
    plan = info.presses
    with RunWriter.open(folder, info, durable=False) as writer:
        for one in block.files:
            presses = [press for press in writer.missing(plan) if press.force_level == one.level]
            if presses:
                _import_level(writer, one, presses, block.how, lambda: _tell(progress, writer, len(plan)))
        _tell(progress, writer, len(plan))
    return folder


def _refuse_a_second_copy(block: AuthorsBlock, info: RunInfo, out: Path, folder: Path) -> None:
    """Refuse a file whose content another run folder was imported from.

    Raises:
        InputError: One is there already.
    """
    paths = {one["sha256"]: file.path for one, file in zip(info.source["files"], block.files, strict=True)}
    for path in sorted(out.glob(f"*/{RUN_FILE}")):
        if path.parent.name == folder.name:
            continue
        try:
            source = Run.open(path.parent).info.source
        except InputError:  # `tacbench runs check` says what is wrong with it
            continue
        for one in source.get("files", ()):
            if one["sha256"] in paths:
                raise InputError("file", str(paths[one["sha256"]]), f"is there already, as {path.parent}")


def _tell(progress: Callable[[int, int], None] | None, writer: RunWriter, planned: int) -> None:
    if progress is not None:
        progress(len(writer.done), planned)


def _import_level(
    writer: RunWriter, file: AuthorsFile, presses: Sequence[Press], how: ImportOptions, tell: Callable[[], None]
) -> None:
    frames = file.frames()
    index = {how.position(i, j): (i, j) for i in range(PER_SIDE) for j in range(PER_SIDE)}
    for press in presses:
        i, j = index[press.position]
        writer.press(press, (press.x_mm, press.y_mm, math.nan), np.array(frames[press.repeat - 1, i, j]))
        tell()
