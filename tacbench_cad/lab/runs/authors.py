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
from tacbench_cad.lab.runs.npyfile import mapped
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.schema import RUN_FILE
from tacbench_cad.lab.runs.writing import RunWriter
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N, PER_SIDE, PressGrid, Spacing
from tacbench_cad.util.errors import InputError, located
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

    def index(self, position: int) -> tuple[int, int]:
        """Where the authors' array has the position that has this number here."""
        row, column = divmod(position - 1, PER_SIDE)
        return (row, column) if self.first_axis == "y" else (column, row)


@dataclass(frozen=True, kw_only=True)
class AuthorsFile:
    """One of the authors' files, by its name and header; its images are not read yet.

    Args:
        path: The file.
        printer: Our name of its printer.
        filament: Our name of its filament.
        texture: Number of its texture, 1 to 6.
        copy: Its copy.
        level: Its force level, from 1.
        repeats: Images at each position.
        image_shape: (height, width, 3).
    """

    path: Path
    printer: str
    filament: str
    texture: int
    copy: int
    level: int
    repeats: int
    image_shape: tuple[int, ...]

    @property
    def block(self) -> tuple[str, str, int, int]:
        """The block that it shows: printer, filament, texture, copy."""
        return (self.printer, self.filament, self.texture, self.copy)

    @classmethod
    def of(cls, path: Path, options: ImportOptions) -> AuthorsFile:
        """Read a file's name and header.

        Raises:
            InputError: The name, a spelling in it, or the array's type or shape is not one of the authors'.
        """

        def refusal(reason: str) -> InputError:
            return InputError("file", str(path), reason)

        if path.is_dir():
            raise refusal(f"is a folder; name its files, as {path}/*.npy")
        name = _NAME.fullmatch(path.name)
        if name is None:
            raise refusal(_NAME_TEXT)
        texture = int(name["texture"]) + 1
        if texture > 6:
            raise refusal(f"z{name['texture']} is no texture; z0 to z5 are textures 1 to 6")
        level = options.force_levels.get(name["level"].upper())
        if level is None:
            known = ", ".join(f"{word}={number}" for word, number in options.force_levels.items())
            raise refusal(f"{name['level']} is no known force level; --force-levels has {known}")
        copy = int(name["copy"]) if name["copy"] else options.unnumbered_copy
        if not 1 <= copy <= 999:
            raise refusal(f"copy {copy} must be from 1 to 999")
        with located(f"{path}: "):
            printer, filament = names.printer(name["printer"]), names.filament(name["filament"])
        array = mapped(path)
        if array.dtype != np.uint8:
            raise refusal(f"holds {array.dtype}; the authors' images are uint8")
        shape = array.shape
        repeats = 0
        if len(shape) == 7 and shape[0] == 1 and shape[2:4] == (PER_SIDE, PER_SIDE):
            repeats = shape[1]
        elif len(shape) == 4 and shape[0] % POSITIONS == 0:
            repeats = shape[0] // POSITIONS
        if repeats < 1 or not array.flags.c_contiguous or shape[-1] != 3 or min(shape[-3:-1]) < 8:
            raise refusal(
                f"has shape {shape}; (1, 2, 5, 5, 480, 640, 3) and (50, 480, 640, 3) are the authors'",
            )
        return cls(
            path=path,
            printer=printer,
            filament=filament,
            texture=texture,
            copy=copy,
            level=level,
            repeats=repeats,
            image_shape=shape[-3:],
        )

    def frames(self) -> NDArray[Any]:
        """The images, mapped into memory: uint8, (repeats, 5, 5, height, width, 3)."""
        return mapped(self.path).reshape(self.repeats, PER_SIDE, PER_SIDE, *self.image_shape)


@dataclass(frozen=True, kw_only=True)
class AuthorsBlock:
    """The authors' files of one printed block.

    Args:
        files: One for each force level, rising.
        options: How they are read.
    """

    files: tuple[AuthorsFile, ...]
    options: ImportOptions

    def __post_init__(self) -> None:
        first = self.files[0]
        for file in self.files[1:]:
            if (file.repeats, file.image_shape) != (first.repeats, first.image_shape):
                raise InputError(
                    "file",
                    str(file.path),
                    f"has {file.repeats} x 25 images of {file.image_shape}, {first.path.name} of the same block has "
                    f"{first.repeats} x 25 of {first.image_shape}",
                )

    @property
    def info(self) -> RunInfo:
        """The run that the files become; their checksums are computed here."""
        first, options = self.files[0], self.options
        return RunInfo(
            printed=PrintedBlock(
                block=Block.of(first.texture, options.preset),
                printer=first.printer,
                filament=first.filament,
                copy=first.copy,
            ),
            levels=tuple(file.level for file in self.files),
            protocol=Protocol(
                repeats=first.repeats, grid=PressGrid.paper(spacing=options.spacing), stationary_frames=0
            ),
            grid_spacing=options.spacing,
            holder=HolderRim(gap_mm=0.2),  # nobody measured it; runs imported earlier say so, too
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
            source={
                "kind": "the authors' NumPy files",
                "first_axis": options.first_axis,
                "forces": "nominal, not measured",
                "files": [
                    {"name": file.path.name, "sha256": sha256(file.path), "force_level": file.level}
                    for file in self.files
                ],
            },
        )


def gather_authors_files(paths: Sequence[Path], options: ImportOptions) -> list[AuthorsBlock]:
    """Group files by printed block; the name and the header of every file are checked.

    Args:
        paths: The files.
        options: How they are read.

    Returns:
        The blocks, by printer, filament, texture and copy.

    Raises:
        InputError: A file is not one of the authors', or two are of the same block and force level.
    """
    blocks: dict[tuple[str, str, int, int], dict[int, AuthorsFile]] = {}
    for path in paths:
        file = AuthorsFile.of(path, options)
        same = blocks.setdefault(file.block, {}).setdefault(file.level, file)
        if same is not file:
            raise InputError(
                "file",
                str(path),
                f"is of the same block, copy and force level as {same.path}; where a name without a copy number is "
                "another copy, say which with --unnumbered-copy",
            )
    return [
        AuthorsBlock(files=tuple(levels[level] for level in sorted(levels)), options=options)
        for _, levels in sorted(blocks.items())
    ]


def import_block(
    block: AuthorsBlock, out: Path, progress: Callable[[int, int], None] = lambda images, planned: None
) -> Path:
    """Write one block's files as a run folder, or resume an interrupted import.

    One force level is mapped at a time and one image copied at a time, so the memory taken does not grow.

    Args:
        block: The block.
        out: The folder for the run folders.
        progress: Called with the number of images that exist and the number of all.

    Returns:
        The run folder.

    Raises:
        InputError: The run folder holds another import, or cannot be written; or a file was imported already as another
            block or copy, which would count one print twice.
        MissingToolError: OpenCV is not installed.
    """
    require("the import of images", "cv2")
    info = block.info
    folder = out / info.printed.name
    _refuse_a_second_copy(block, info, folder)
    with RunWriter.open(folder, info, durable=False) as writer:
        missing = writer.missing(info.presses)
        for file in block.files:
            frames = file.frames()
            for press in (press for press in missing if press.force_level == file.level):
                image = np.array(frames[press.repeat - 1, *block.options.index(press.position)])
                writer.press(press, (press.x_mm, press.y_mm, math.nan), image)
                progress(len(writer.done), len(info.presses))
        progress(len(writer.done), len(info.presses))
    return folder


def _refuse_a_second_copy(block: AuthorsBlock, info: RunInfo, folder: Path) -> None:
    """Refuse a file whose content was imported to another run folder beside this one.

    Raises:
        InputError: One was.
    """
    paths = {entry["sha256"]: file.path for entry, file in zip(info.source["files"], block.files, strict=True)}
    for path in sorted(folder.parent.glob(f"*/{RUN_FILE}")):
        if path.parent.name == folder.name:
            continue
        try:
            source = Run.open(path.parent).info.source
        except InputError:  # `tacbench runs check` says what is wrong with it
            continue
        files = source.get("files")
        for entry in files if isinstance(files, list) else ():
            digest = entry.get("sha256") if isinstance(entry, dict) else None
            if digest in paths:
                raise InputError("file", str(paths[digest]), f"is there already, as {path.parent}")
