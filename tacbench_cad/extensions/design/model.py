"""The state of the design page, the picture of a state, and the facts about it.

A picture must appear soon after a change. It therefore uses the heights on a grid and no proved extremes. The
facts use the proved extremes and the mesh, which can take longer. The page asks for them when its user pauses.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval

from tacbench_cad.geometry import as_part
from tacbench_cad.making import Request
from tacbench_cad.spec import (
    SIZE_RANGE_MM,
    VALUES,
    Block,
    BlockTable,
    Outline,
    Surface,
    Texture,
    Tolerance,
    WaveSum,
    outline_of,
    printable_heights,
    spectrum,
    table_in_mm,
    texture_of_document,
    with_table,
)
from tacbench_cad.util.convert import NOT_STORED, Checked
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import at_most, mm
from tacbench_cad.util.types import Floats

#: The length of one period of a wave of frequency 1, in units of u and v.
PERIOD = 2.0 * math.pi
#: The number of lines of the grid along the longer side, and the number of points of a cut.
MAX_LINES, CUT_POINTS = 256, 801
_PAPER = VALUES["paper"]
#: The word for a block without another outline.
RECTANGLE = "rectangle"

Side = Annotated[float, Interval(ge=SIZE_RANGE_MM[0], le=SIZE_RANGE_MM[1])]
Period = Annotated[float, Interval(ge=1e-3, le=1e4)]
Shift = Annotated[float, Interval(ge=-1e4, le=1e4)]


@dataclass(frozen=True, kw_only=True)
class Design(Checked):
    """The state of the page.

    Args:
        name: The name of the texture.
        texture: The table ``[texture]`` of a texture file, without its name.
        wave: The tables ``[[wave]]``.
        size_mm: The sides x, y.
        height_mm: The height of the highest point.
        period_mm: The lengths of 2 pi units of u and v, which is the wavelength of a wave of frequency 1.
        unit_mm: The height of one unit.
        shift: The point (u, v) at the corner of the block, in radians.
        tolerance_mm: The largest distance of the mesh from the formula.
        nozzle_mm: The diameter of the nozzle.
        cut: The direction of the cut: along x or along y.
        cut_at: The position of the cut, as a fraction of the side across it.
        outline: The word of the outline, such as disc or hexagon, which is the largest one in the sides; or rectangle.
        upload: The name that the server gave to an uploaded height map; empty for a state without one.
        folder: The folder of the files that the tables name. The server knows it, and the page does not.
    """

    name: str = "my-texture"
    texture: Mapping[str, Any]
    wave: tuple[Mapping[str, Any], ...] = ()
    size_mm: tuple[Side, Side] = _PAPER.size_mm
    height_mm: Side = _PAPER.height_mm
    period_mm: tuple[Period, Period] = (PERIOD * _PAPER.mm_per_unit[0], PERIOD * _PAPER.mm_per_unit[1])
    unit_mm: Annotated[float, Interval(ge=1e-3, le=1e3)] = _PAPER.mm_per_unit[2]
    shift: tuple[Shift, Shift] = (0.0, 0.0)
    tolerance_mm: Annotated[float, Interval(ge=1e-4, le=1.0)] = 0.01
    nozzle_mm: Annotated[float, Interval(ge=0.05, le=10.0)] = 0.4
    cut: Literal["x", "y"] = "x"
    cut_at: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.5
    outline: str = RECTANGLE
    upload: str = ""
    folder: Path = field(default=Path(), metadata=NOT_STORED)

    @property
    def mm_per_unit(self) -> tuple[float, float, float]:
        """The millimetres per unit of u, v and height; exactly those of the preset where they differ by rounding."""
        values = (self.period_mm[0] / PERIOD, self.period_mm[1] / PERIOD, self.unit_mm)
        x, y, z = (
            own if math.isclose(value, own, rel_tol=1e-12) else value
            for value, own in zip(values, _PAPER.mm_per_unit, strict=True)
        )
        return (x, y, z)

    @property
    def shape(self) -> Outline | None:
        """The outline; None for a rectangle.

        Raises:
            InputError: There is no such outline.
        """
        return None if self.outline == RECTANGLE else outline_of(self.outline, self.size_mm)

    @property
    def sides_mm(self) -> tuple[float, float]:
        """The sides of the block, or of the box of its outline."""
        return self.size_mm if self.shape is None else self.shape.size_mm

    @property
    def block_table(self) -> BlockTable:
        """The settings of the block."""
        domain = None
        if self.shift != (0.0, 0.0):
            ends = [
                start + side / unit
                for start, side, unit in zip(self.shift, self.size_mm, self.mm_per_unit, strict=False)
            ]
            domain = ((self.shift[0], ends[0]), (self.shift[1], ends[1]))
        return BlockTable(
            size_mm=self.size_mm,
            height_mm=self.height_mm,
            mm_per_unit=self.mm_per_unit,
            domain=domain,
            outline=None if self.outline == RECTANGLE else self.outline,
        )

    @property
    def formula(self) -> Texture:
        """The texture.

        Raises:
            InputError: The tables are not those of a texture, or they name a file outside of the folder.
        """
        tables: dict[str, Any] = {"texture": {"name": self.name, **self.texture}}
        if self.wave:
            tables["wave"] = list(self.wave)
        if self.wave or self.texture.get("family") == "sum":
            tables["block"] = {"mm_per_unit": list(self.mm_per_unit)}
        self.require_files()
        texture, table = _texture(json.dumps(tables), self.folder), self.block_table
        if texture.surface.unit == "mm":
            table = table_in_mm(table, self.mm_per_unit)
        return replace(texture, block=table)

    @property
    def files(self) -> list[str]:
        """The names of the files that the table ``[texture]`` names: a height map, or other texture files."""
        words = self.texture.get("of")
        names = [self.texture.get("file"), *(words if isinstance(words, list | tuple) else ())]
        return [name for name in names if isinstance(name, str) and (name.endswith(".toml") or name == names[0])]

    def require_files(self) -> None:
        """Check that the files are in the folder.

        Raises:
            InputError: A file is outside of the folder.
        """
        for name in self.files:
            if "\0" in name or not (self.folder / name).resolve().is_relative_to(self.folder.resolve()):
                raise InputError("[texture] file", name, "must be in the folder of the texture file")

    @property
    def surface(self) -> Surface:
        """The formula in mm over (x, y).

        It is not cut to the block, and its extremes are not searched, because both can take longer than a picture may.
        """
        formula = self.formula
        _, (x, y, z), origin, _ = with_table(_PAPER, formula.block, formula.surface)
        return formula.surface.mapped((x, y), z, origin, "mm")

    @property
    def block(self) -> Block:
        """The block.

        Raises:
            InputError: The block is not possible, for example because its base is too thin.
        """
        return Block.of(self.formula, sampling=Tolerance(mm=self.tolerance_mm))

    def request(self, **options: Any) -> Request:
        """Return the request that makes the files of the block."""
        return Request(textures=(self.formula,), parts=("blocks",), sampling=Tolerance(mm=self.tolerance_mm), **options)


@lru_cache(maxsize=16)
def _texture(tables: str, folder: Path) -> Texture:
    """Return the texture of a document as JSON. A height map takes long to read, so the last textures are kept."""
    return texture_of_document(json.loads(tables), folder=folder)


def picture(design: Design) -> bytes:
    """Return the heights of the block as the formula gives them and as the nozzle can print them.

    Returns:
        The length of a JSON text as 32-bit integer, the text filled with spaces to a multiple of 4 bytes, and 32-bit
        floats: the heights of both surfaces with x running fastest, then the heights of both along the cut.
    """
    surface, (width, depth) = design.surface, design.sides_mm
    lines = [max(2, round(MAX_LINES * side / max(width, depth))) for side in (width, depth)]
    x, y = np.linspace(0.0, width, lines[0]), np.linspace(0.0, depth, lines[1])
    formula = surface.grid(x, y)
    printed = printable_heights(surface, x, y, design.nozzle_mm)
    inside = np.ones(formula.shape, dtype=bool)
    if design.shape is not None:
        inside = design.shape.distance(x[:, None], y[None, :]) <= 0.0
    datum = design.height_mm - float(formula[inside].max())
    # Outside of the outline, the height is 0.
    tops = [np.where(inside, heights + datum, 0.0).T for heights in (formula, printed)]
    arrays = [*tops, *_cut(design, surface, printed, datum)]
    header = {
        "lines": lines,
        "points": CUT_POINTS,
        "size": [width, depth],
        "range": [float(formula[inside].min()) + datum, design.height_mm],
        "equation": design.formula.equation,
    }
    text = json.dumps(header, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + b"".join(heights.astype("<f4").tobytes() for heights in arrays)


def _cut(design: Design, surface: Surface, printed: Floats, datum: float) -> list[Floats]:
    """Return the heights of both surfaces along the cut."""
    along = 0 if design.cut == "x" else 1
    points = np.linspace(0.0, design.sides_mm[along], CUT_POINTS)
    across = np.array([design.cut_at * design.sides_mm[1 - along]])
    x, y = (points, across) if along == 0 else (across, points)
    if isinstance(surface, WaveSum):
        smoothed = printable_heights(surface, x, y, design.nozzle_mm).ravel()
    else:
        rows = printed.T if along == 0 else printed
        nearest = rows[round(design.cut_at * (len(rows) - 1))]
        smoothed = np.interp(points, np.linspace(0.0, points[-1], len(nearest)), nearest)
    inside = design.shape is None or design.shape.distance(x, y) <= 0.0
    return [np.where(inside, heights + datum, 0.0) for heights in (surface.grid(x, y).ravel(), smoothed)]


def facts(design: Design) -> list[tuple[str, str]]:
    """Return facts about the block, each with its name: relief, base, printable waves, triangles.

    Raises:
        InputError: The block is not possible.
    """
    block = design.block
    waves = spectrum(block)
    fraction = f"{100.0 * waves.printable(design.nozzle_mm):.3g} % of the variance of the height"
    if waves.waves is not None:
        fraction = f"{waves.printable_waves(design.nozzle_mm)} of {waves.waves} waves, {fraction}"
    mesh, expected = as_part(block).mesh
    assert expected.certificate is not None
    distance = f"{at_most(1000.0 * expected.certificate.distance_mm, 3)} µm"
    return [
        ("size", mm(*block.size_mm, block.height_mm)),
        ("relief", mm(block.relief_mm)),
        ("base below the lowest valley", mm(block.base_mm)),
        ("finest ridge", mm(waves.finest_ridge_mm)),
        (f"printable by a nozzle of {design.nozzle_mm:g} mm", fraction),
        ("triangles", f"{len(mesh.faces):,}"),
        ("largest distance from the formula", f"{distance}, {expected.certificate.evidence}"),
    ]
