"""What a comparison with the published figures cannot support, and why: few prints, noise, another way of pressing."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, Cell
from tacbench_cad.lab.analysis.variance.notes import FRAMES, REPEATS
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, PressGrid
from tacbench_cad.util.text import counted

#: Where floors come from: frames without motion in contact; repeats on one print, at least for some cells, which is an
#: upper bound because each has its own approach; or nowhere.
FloorSource = Literal["stationary", "repeats", "none"]

#: The unit of the published figures' readings, and the size of the camera's images (rows, columns).
UNITS = "counts"
#: Rows and columns of the camera's images.
IMAGE_SHAPE = (480, 640)
#: A floor above this share of a figure is said.
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
    def of(
        cls, info: RunInfo, *, floor_from: Iterable[str], simulated: tuple[str, ...], left_out: tuple[str, ...]
    ) -> Context:
        """The context of a variance table.

        Args:
            info: What its runs have in common.
            floor_from: Where each cell's floor comes from, in the table's words.
            simulated: What was simulated.
            left_out: Readings that could not be used.
        """
        sources = set(floor_from)
        protocol, block = info.protocol, info.printed.block
        grids = [PressGrid.paper(block.scale, spacing).positions_mm for spacing in ("even", "1mm")]
        own = protocol.grid.positions_mm
        return cls(
            units=str(info.sensor.get("units", UNITS)),
            shape=info.frame_shape,
            contact=protocol.contact,
            forces_n=protocol.forces_n if protocol.contact == "force" else (),
            repeats=protocol.repeats,
            same_grid=any(own.shape == one.shape and bool(np.allclose(own, one, atol=1e-6)) for one in grids),
            preset=block.preset,
            scale=block.scale,
            floor_source="repeats" if REPEATS in sources else "stationary" if FRAMES in sources else "none",
            simulated=simulated,
            left_out=left_out,
        )

    @property
    def comparable(self) -> bool:
        """Whether the figures have the published figures' unit at all."""
        return self.units == UNITS


def texture_number(texture: str) -> int | None:
    """The number of one of the paper's textures, None for another."""
    found = re.fullmatch(r"texture-([1-6])", texture)
    return int(found[1]) if found else None


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


def limits(cells: Sequence[Cell], context: Context, force_level: int | str) -> tuple[str, ...]:
    """Sentences about what the cells of one printer cannot support.

    Args:
        cells: Its cells at the level that is compared.
        context: How they were taken.
        force_level: That level.
    """
    said: list[str] = []
    if context.simulated:
        said.append(f"Simulated ({'; '.join(context.simulated)}): this says nothing about a real printer.")
    if context.left_out:
        readings = counted(len(context.left_out), "reading")
        said.append(f"{readings} could not be used and had to be left out: {context.left_out[0]}.")
    said += _limits_of_prints(cells)
    said += _limits_of_floor(cells, context)
    said += _limits_of_pressing(context, force_level)
    if context.comparable:
        said.append(
            "The published figures come from six prints each and have no interval; the text gives neither their "
            "force nor whether they are grey, so a small difference from them may be one of method."
        )
    return tuple(said)


def _limits_of_prints(cells: Sequence[Cell]) -> list[str]:
    said = []
    single = [cell for cell in cells if cell.prints == 1]
    if single:
        said.append(
            f"One print of {_names(single)}: the figure holds repeats only, nothing about how prints differ; "
            f"print {published.PRINTS}."
        )
    few = sorted({cell.prints for cell in cells if 1 < cell.prints < published.PRINTS})
    if few:
        counts = " and ".join(str(one) for one in few)
        said.append(
            f"{counts} prints where the paper has {published.PRINTS}: the interval is wide, and the figure itself is "
            f"expected up to {100.0 * (1.0 - 1.0 / factors(few[0], published.REPEATS)[1]):.0f} % too low (ddof 0), "
            "which the comparison allows for."
        )
    without = [cell for cell in cells if cell.prints > 1 and cell.low is None]
    if without:
        said.append(f"No interval for {_names(without)}.")
    missing = sorted(set(range(1, 7)) - {texture_number(cell.texture) for cell in cells})
    if missing:
        word = "Texture" if len(missing) == 1 else "Textures"
        said.append(f"{word} {', '.join(map(str, missing))} not pressed: nothing is said about them.")
    other = [cell.texture for cell in cells if texture_number(cell.texture) is None]
    if other:
        said.append(f"Not in the paper, so not compared: {', '.join(dict.fromkeys(other))}.")
    return said


def _limits_of_floor(cells: Sequence[Cell], context: Context) -> list[str]:
    said = []
    unit = f"{context.units}^2" if context.comparable else f"({context.units})^2"
    floors = [cell.floor for cell in cells if cell.floor is not None]
    if not floors or context.floor_source == "none":
        said.append(
            "No noise floor: there are neither frames without motion in contact nor repeats, so how much of the "
            "figures is the sensor's own noise is not known."
        )
    else:
        if context.floor_source == "repeats":
            said.append(
                "The floor is an upper bound: it comes from repeats on one print, so that approaching anew is in it; "
                "record frames without motion in contact."
            )
        high = [cell for cell in cells if cell.floor is not None and cell.floor > LARGE_FLOOR * cell.variance]
        if high:
            share = max(min(1.0, (cell.floor or 0.0) / cell.variance) if cell.variance else 1.0 for cell in high)
            said.append(
                f"Up to {100.0 * share:.0f} % of the figure is noise ({_names(high)}): "
                "a low figure there may show a quiet sensor as well as a good printer."
            )
    if context.comparable:
        readings = " or ".join(f"{value:.2g} {unit} if a {kind}" for kind, value in published.FLOOR_READINGS.items())
        said.append(
            f"The paper's own floor, {published.FLOOR}, has no unit ({readings}), so how much of its "
            "figures is noise is not known."
        )
    return said


def _limits_of_pressing(context: Context, force_level: int | str) -> list[str]:
    said = []
    if context.contact != "force":
        said.append("Pressed to a depth, not to a force as in the paper: a higher print is pressed harder.")
    elif not _same_forces(context.forces_n):
        forces = ", ".join(f"{one:g}" for one in context.forces_n)
        paper = ", ".join(f"{one:g}" for one in FORCES_N)
        said.append(f"Other forces ({forces} N) than the paper's ({paper} N): variance grows with force.")
    elif force_level != ALL_LEVELS:
        said.append(f"Force level {force_level} alone; the paper does not say at which force its figures were taken.")
    if context.shape is not None and context.comparable and context.shape[:2] != IMAGE_SHAPE:
        size = " x ".join(str(one) for one in context.shape)
        said.append(
            f"Readings of {size}, not 480 x 640 pixels: another camera or sensor, whose counts mean other things."
        )
    if not context.same_grid:
        said.append("Other positions than the paper's grid.")
    if context.preset != "released" or context.scale != 1.0:
        said.append(
            f"Blocks of preset {context.preset} at scale {context.scale:g}; the authors printed those of preset "
            "released at scale 1, whose size and relief differ."
        )
    if context.repeats != published.REPEATS:
        said.append(f"{context.repeats} repeats at each place where the paper has {published.REPEATS}.")
    return said


def _same_forces(forces_n: Sequence[float]) -> bool:
    """Whether the forces are the paper's, within the bands that it reached."""
    return len(forces_n) == len(FORCES_N) and all(
        abs(own - paper) <= band for own, paper, band in zip(forces_n, FORCES_N, FORCE_SPREADS_N, strict=True)
    )


def _names(cells: Sequence[Cell]) -> str:
    """``texture 4``, ``textures 1, 4, hex``."""
    names = list(dict.fromkeys(str(texture_number(cell.texture) or cell.texture) for cell in cells))
    return f"texture{'s' if len(names) > 1 else ''} {', '.join(names)}"
