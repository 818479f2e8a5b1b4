"""What a comparison with the published figures cannot support, and why: few prints, noise, another way of pressing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.published import PRINTS, texture_number
from tacbench_cad.lab.analysis.variance.cells import Cell, Level
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, PressGrid
from tacbench_cad.util.text import counted

#: Rows and columns of the camera's images.
IMAGE_SHAPE = (480, 640)
#: Noise above this fraction of a figure is a reason.
LARGE_NOISE = 0.5


def to_two_repeats(repeats: int) -> float:
    """What takes an expected variance of so many repeats (ddof 0) to that of the paper's two."""
    return (1.0 - 1.0 / published.REPEATS) / (1.0 - 1.0 / repeats)


def limits(cells: Sequence[Cell], collection: Collection, left_out: Sequence[str]) -> tuple[str, ...]:
    """What the cells of one printer cannot support: those of the reasons that hold, a sentence each.

    Args:
        cells: Its cells.
        collection: The study.
        left_out: Readings that could not be used.
    """
    return (
        *_of_data(cells, collection, left_out),
        *_of_noise(cells, collection),
        *_of_pressing(collection, cells[0].force_level),
    )


def _of_data(cells: Sequence[Cell], collection: Collection, left_out: Sequence[str]) -> Iterator[str]:
    """Simulated data, too few prints, textures that are missing or not the paper's."""
    if collection.simulated:
        yield f"The data are simulated ({'; '.join(collection.simulated)})."
    if left_out:
        yield f"{counted(len(left_out), 'reading')} could not be used, the first: {left_out[0]}."
    single = [cell for cell in cells if cell.prints == 1]
    if single:
        yield f"One print of {_names(single)}: others may repeat otherwise, so there is no interval; print {PRINTS}."
    few = sorted({cell.prints for cell in cells if 1 < cell.prints < PRINTS})
    if few:
        yield f"{' and '.join(map(str, few))} prints where the paper has {PRINTS}: the interval is wide."
    yield (
        'The figures are the variance over the repeats on one print. How prints differ is in "tacbench variance", '
        "and the paper has no figure for it."
    )
    without = [cell for cell in cells if cell.prints > 1 and cell.low is None]
    if without:
        yield f"No interval for {_names(without)}."
    missing = sorted(set(range(1, 7)) - {texture_number(cell.texture) for cell in cells})
    if missing:
        yield f"Not pressed: {_textures(missing)}."
    other = [cell.texture for cell in cells if texture_number(cell.texture) is None]
    if other:
        yield f"Not in the paper, so not compared: {', '.join(dict.fromkeys(other))}."


def _of_noise(cells: Sequence[Cell], collection: Collection) -> Iterator[str]:
    """No noise floor, or a large one; the paper's own, whose unit is unknown."""
    noise = {cell: cell.noise_alone for cell in cells if cell.noise_alone is not None}
    if not noise:
        yield "No noise floor: how much of the figures is the sensor's own noise is unknown."
    large = [cell for cell, value in noise.items() if value > LARGE_NOISE * cell.variance]
    if large:
        most = max(min(1.0, noise[cell] / cell.variance) if cell.variance else 1.0 for cell in large)
        yield f"Up to {100.0 * most:.0f} % of the figure is noise ({_names(large)})."
    if collection.in_counts:
        readings = " or ".join(f"{value:.2g} counts^2 if a {kind}" for kind, value in published.PAPER_FLOORS.items())
        yield f"The paper's own noise floor, {published.FLOOR}, has no unit ({readings})."


def _of_pressing(collection: Collection, force_level: Level) -> Iterator[str]:
    """Another way of pressing, another camera, other blocks than the paper's; how little the paper says of its own."""
    pressing, block = collection.pressing, collection.info.printed.block
    forces_n = [force or 0.0 for force in pressing.levels.values()]
    if pressing.contact is None:
        yield "The contact force is unknown: variance grows with force."
    elif pressing.contact != "force":
        yield "Pressed to a depth, not to a force as in the paper: a higher print is pressed harder."
    elif pressing.protocol and not _same_forces(forces_n):
        own, paper = (", ".join(f"{force:g}" for force in forces) for forces in (forces_n, FORCES_N))
        yield f"Other forces ({own} N) than the paper's ({paper} N): variance grows with force."
    elif force_level != 1:
        yield f"Force level {force_level}; the published figures are of level 1: variance grows with force."
    shape = collection.info.frame_shape or ()
    if shape[:2] not in ((), IMAGE_SHAPE) and collection.in_counts:
        yield f"Images of {' x '.join(map(str, shape))}, not 480 x 640 pixels: another camera or sensor."
    grids = [PressGrid.paper(block.scale if block else 1.0, spacing).positions_mm for spacing in ("even", "1mm")]
    positions = pressing.positions_mm
    if not any(positions.shape == grid.shape and np.allclose(positions, grid, atol=1e-6) for grid in grids):
        yield "Other positions than the paper's grid."
    if block is None:
        yield "The geometry of what was pressed is unknown."
    elif (block.preset, block.scale) != ("released", 1.0):
        yield f"Blocks of preset {block.preset} at scale {block.scale:g}, not preset released at scale 1."
    if pressing.repeats != published.REPEATS:
        yield f"{pressing.repeats} repeats at each place where the paper has {published.REPEATS}."
    if collection.in_counts:
        yield (
            "The published figures have no interval, and frames of other textures are among theirs (row numbers were "
            "kept in 8 bits), so a small difference from them may be one of method. That all three rows were made as "
            "that of Bambu PLA- is assumed: its output alone was saved."
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
