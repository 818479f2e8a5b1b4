"""What a comparison with the published figures cannot support, and why: few prints, noise, another way of pressing."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, FRAMES, REPEATS, Cell, Level
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, PressGrid
from tacbench_cad.util.text import counted

#: Where floors come from: frames without motion in contact; repeats on one print, at least for some cells, which is an
#: upper bound because each has its own approach; or nowhere.
FloorSource = Literal["stationary", "repeats", "none"]

#: The unit of the published figures' readings, and the size of the camera's images (rows, columns).
UNITS = "counts"
#: Rows and columns of the camera's images.
IMAGE_SHAPE = (480, 640)
#: A noise floor above this fraction of a figure is a reason.
LARGE_FLOOR = 0.5


@dataclass(frozen=True, kw_only=True)
class Context:
    """How the cells were taken; the defaults are the paper's.

    Args:
        units: Unit of the readings.
        shape: Shape of a reading, None where unknown.
        contact: ``force`` or ``depth``.
        forces_n: Target forces by level; empty in depth mode.
        repeats: Readings at each place.
        same_grid: Whether the positions are the paper's (either reading of them).
        preset: The block's preset.
        scale: Its scale.
        floor_source: Where floors come from.
        simulated: What was simulated.
        left_out: Readings that could not be used, with the reason.
    """

    units: str = UNITS
    shape: tuple[int, ...] | None = (*IMAGE_SHAPE, 3)
    contact: str = "force"
    forces_n: tuple[float, ...] = FORCES_N
    repeats: int = published.REPEATS
    same_grid: bool = True
    preset: str = "released"
    scale: float = 1.0
    floor_source: FloorSource = "stationary"
    simulated: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @classmethod
    def of(cls, collection: Collection, cells: Iterable[Cell], left_out: tuple[str, ...] = ()) -> Context:
        """The context of a variance table.

        Args:
            collection: The study.
            cells: The cells of the table.
            left_out: Readings that could not be used.
        """
        sources, info = {cell.floor_from for cell in cells}, collection.info
        protocol, block = info.protocol, info.printed.block
        grids = [PressGrid.paper(block.scale, spacing).positions_mm for spacing in ("even", "1mm")]
        own = protocol.grid.positions_mm
        return cls(
            units=str(info.sensor.get("units", UNITS)),
            shape=info.frame_shape,
            contact=protocol.contact,
            forces_n=protocol.forces_n if protocol.contact == "force" else (),
            repeats=protocol.repeats,
            same_grid=any(own.shape == grid.shape and bool(np.allclose(own, grid, atol=1e-6)) for grid in grids),
            preset=block.preset,
            scale=block.scale,
            floor_source="repeats" if REPEATS in sources else "stationary" if FRAMES in sources else "none",
            simulated=collection.simulated,
            left_out=left_out,
        )

    @property
    def comparable(self) -> bool:
        """Whether the figures have the published figures' unit at all."""
        return self.units == UNITS


def texture_number(texture: str) -> int | None:
    """The number of one of the paper's textures, None for another."""
    match = re.fullmatch(r"texture-([1-6])", texture)
    return int(match[1]) if match else None


def factors(prints: int, repeats: int) -> tuple[float, float]:
    """What takes an expected figure (ddof 0) to the paper's six prints of two repeats: the least and the most.

    Args:
        prints: Prints of the cell, at least 2.
        repeats: Readings at each place.
    """
    paper = published.PRINTS * published.REPEATS
    own = prints * repeats
    of_prints = (1.0 - 1.0 / published.PRINTS) / (1.0 - 1.0 / prints)
    of_repeats = (1.0 - 1.0 / paper) / (1.0 - 1.0 / own)
    return min(of_prints, of_repeats), max(of_prints, of_repeats)


def limits(cells: Sequence[Cell], context: Context, force_level: Level) -> tuple[str, ...]:
    """What the cells of one printer cannot support: those of the reasons that hold, a sentence each.

    Args:
        cells: Its cells at the level that is compared.
        context: How they were taken.
        force_level: That level.
    """
    reasons: list[_Reason] = [
        *_of_data(cells, context),
        *_of_noise(cells, context),
        *_of_pressing(context, force_level),
        context.comparable
        and "The published figures come from six prints each and have no interval; the text gives neither their force "
        "nor whether they are grey, so a small difference from them may be one of method.",
    ]
    return tuple(reason for reason in reasons if isinstance(reason, str))


#: A reason, or False (or an empty text) where it does not hold.
_Reason = str | bool


def _of_data(cells: Sequence[Cell], context: Context) -> Iterator[_Reason]:
    """Simulated data, too few prints, textures that are missing or not the paper's."""
    paper = published.PRINTS
    yield context.simulated != () and f"The data are simulated ({'; '.join(context.simulated)})."
    left_out = context.left_out
    yield left_out != () and f"{counted(len(left_out), 'reading')} could not be used, the first: {left_out[0]}."
    single = [cell for cell in cells if cell.prints == 1]
    yield (
        single != []
        and f"One print of {_names(single)}: the figure shows repeats, not how prints differ; print {paper}."
    )
    few = sorted({cell.prints for cell in cells if 1 < cell.prints < paper})
    if few:
        low = 100.0 * (1.0 - 1.0 / factors(few[0], published.REPEATS)[1])
        yield (
            f"{' and '.join(map(str, few))} prints where the paper has {paper}: the interval is wide, the figure "
            f"is expected up to {low:.0f} % too low (ddof 0), which the comparison allows for."
        )
    without = [cell for cell in cells if cell.prints > 1 and cell.low is None]
    yield without != [] and f"No interval for {_names(without)}."
    missing = sorted(set(range(1, 7)) - {texture_number(cell.texture) for cell in cells})
    yield missing != [] and f"Not pressed: {_textures(missing)}."
    other = [cell.texture for cell in cells if texture_number(cell.texture) is None]
    yield other != [] and f"Not in the paper, so not compared: {', '.join(dict.fromkeys(other))}."


def _of_noise(cells: Sequence[Cell], context: Context) -> Iterator[_Reason]:
    """No noise floor, an upper bound only, or a large one; the paper's own, whose unit is unknown."""
    if context.floor_source == "none" or all(cell.floor is None for cell in cells):
        yield "No noise floor: how much of the figures is the sensor's own noise is unknown."
    else:
        yield context.floor_source == "repeats" and (
            "The noise floor is an upper bound: it comes from repeats on one print, which contain re-approach."
        )
        large = [cell for cell in cells if cell.floor is not None and cell.floor > LARGE_FLOOR * cell.variance]
        if large:
            noise = max(min(1.0, (cell.floor or 0.0) / cell.variance) if cell.variance else 1.0 for cell in large)
            yield f"Up to {100.0 * noise:.0f} % of the figure is noise ({_names(large)})."
    if context.comparable:
        readings = " or ".join(f"{value:.2g} {UNITS}^2 if a {kind}" for kind, value in published.PAPER_FLOORS.items())
        yield f"The paper's own noise floor, {published.FLOOR}, has no unit ({readings})."


def _of_pressing(context: Context, force_level: Level) -> Iterator[_Reason]:
    """Another way of pressing, another camera, other blocks than the paper's."""
    if context.contact != "force":
        yield "Pressed to a depth, not to a force as in the paper: a higher print is pressed harder."
    elif not _same_forces(context.forces_n):
        own, paper = (", ".join(f"{force:g}" for force in forces) for forces in (context.forces_n, FORCES_N))
        yield f"Other forces ({own} N) than the paper's ({paper} N): variance grows with force."
    elif force_level != ALL_LEVELS:
        yield f"Force level {force_level} alone; the paper does not say at which force its figures were taken."
    shape = context.shape or ()
    yield (
        shape[:2] not in ((), IMAGE_SHAPE)
        and context.comparable
        and (f"Images of {' x '.join(map(str, shape))}, not 480 x 640 pixels: another camera or sensor.")
    )
    yield not context.same_grid and "Other positions than the paper's grid."
    yield (context.preset, context.scale) != ("released", 1.0) and (
        f"Blocks of preset {context.preset} at scale {context.scale:g}, not preset released at scale 1."
    )
    yield context.repeats != published.REPEATS and (
        f"{context.repeats} repeats at each place where the paper has {published.REPEATS}."
    )


def _same_forces(forces_n: Sequence[float]) -> bool:
    """Whether the forces are the paper's, within the bands that it reached."""
    return len(forces_n) == len(FORCES_N) and all(
        abs(own - paper) <= band for own, paper, band in zip(forces_n, FORCES_N, FORCE_SPREADS_N, strict=True)
    )


def _names(cells: Sequence[Cell]) -> str:
    return _textures(list(dict.fromkeys(texture_number(cell.texture) or cell.texture for cell in cells)))


def _textures(names: Sequence[object]) -> str:
    """``texture 4``, ``textures 1, 4, hex``."""
    return f"texture{'s' if len(names) > 1 else ''} {', '.join(map(str, names))}"
