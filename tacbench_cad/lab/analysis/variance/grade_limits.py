"""The limits of a comparison with the published figures: few prints, noise, another way of pressing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.published import PRINTS, texture_number
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, PressGrid
from tacbench_cad.util.text import counted

#: The numbers of rows and columns of the images of the paper's camera.
IMAGE_SHAPE = (480, 640)
#: Noise above this fraction of a figure is reported as a limit.
LARGE_NOISE = 0.5


def to_two_repeats(repeats: int) -> float:
    """Return the factor from the expected variance of this many repeats (ddof 0) to that of the paper's two repeats."""
    return (1.0 - 1.0 / published.REPEATS) / (1.0 - 1.0 / repeats)


def limits(cells: pd.DataFrame, design: Design, left_out: Sequence[str]) -> tuple[str, ...]:
    """Return the limits that apply to one printer, one sentence each.

    Args:
        cells: The rows of the printer in the variance table.
        design: The design of the study.
        left_out: The frames that could not be used.
    """
    level = int(cells["force_level"].iloc[0])
    return (*_of_data(cells, design, left_out), *_of_noise(cells, design.in_counts), *_of_pressing(design, level))


def _of_data(cells: pd.DataFrame, design: Design, left_out: Sequence[str]) -> Iterator[str]:
    """Yield the limits of the data: simulated, too few prints, missing textures or textures not in the paper."""
    if design.simulated:
        yield f"The data are simulated ({'; '.join(design.simulated)})."
    if left_out:
        yield f"{counted(len(left_out), 'frame')} could not be used; the first is {left_out[0]}."
    prints, numbers = cells["prints"], cells["texture"].map(texture_number)
    if (prints == 1).any():
        yield (
            f"There is only one print of {_names(cells[prints == 1])}. Other prints may repeat differently, so there "
            f"is no interval; print {PRINTS}."
        )
    few = sorted(prints[(prints > 1) & (prints < PRINTS)].unique())
    if few:
        yield f"There are {' and '.join(map(str, few))} prints, and {PRINTS} in the paper: the interval is wide."
    yield (
        "The figures are the variance over the repeats on one print. They do not show differences between prints: for "
        'these use "tacbench variance". The paper has no figure for them.'
    )
    without = cells[(prints > 1) & cells["low"].isna()]
    if len(without):
        yield f"There is no interval for {_names(without)}."
    missing = sorted(set(range(1, 7)) - set(numbers))
    if missing:
        yield f"Not pressed: {_textures(missing)}."
    if numbers.isna().any():
        yield f"Not compared, because not in the paper: {', '.join(cells.loc[numbers.isna(), 'texture'].unique())}."


def _of_noise(cells: pd.DataFrame, in_counts: bool) -> Iterator[str]:
    """Yield the limits from noise: no noise floor, a large noise floor, and the unknown unit of the paper's."""
    if cells["noise_alone"].isna().all():
        yield "There is no noise floor: it is unknown how much of the figures is sensor noise."
    large = cells[cells["noise_alone"] > LARGE_NOISE * cells["variance"]]
    if len(large):
        largest = (large["noise_alone"] / large["variance"]).clip(upper=1.0).max()
        yield f"Up to {100.0 * largest:.0f} % of the figure is noise ({_names(large)})."
    if in_counts:
        meanings = " or ".join(
            f"{value:.2g} counts^2 if it is a {kind}" for kind, value in published.PAPER_FLOORS.items()
        )
        yield f"The paper's own noise floor, {published.FLOOR}, has no unit ({meanings})."


def _of_pressing(design: Design, force_level: int) -> Iterator[str]:
    """Yield the limits from other ways of pressing, cameras and blocks, and from open points in the paper."""
    block, positions = design.block, design.positions_mm
    forces_n = [force or 0.0 for force in design.level_values.values()]
    if design.contact is None:
        yield "The contact force is unknown: variance grows with force."
    elif design.contact != "force":
        yield "The blocks were pressed to a depth, not to a force as in the paper: a higher print is pressed harder."
    elif design.planned and not _same_forces(forces_n):
        own, paper = (", ".join(f"{force:g}" for force in forces) for forces in (forces_n, FORCES_N))
        yield f"The forces ({own} N) are not the paper's ({paper} N): variance grows with force."
    elif force_level != 1:
        yield (
            f"The force level is {force_level}, and the published figures are for level 1: variance grows with force."
        )
    if design.frame_shape[:2] not in ((), IMAGE_SHAPE) and design.in_counts:
        shape = " x ".join(map(str, design.frame_shape))
        yield f"The images have {shape}, not 480 x 640 pixels: another camera or sensor."
    grids = [PressGrid.paper(block.scale if block else 1.0, spacing).positions_mm for spacing in ("even", "1mm")]
    if not any(positions.shape == grid.shape and np.allclose(positions, grid, atol=1e-6) for grid in grids):
        yield "The positions are not those of the paper's grid."
    if block is None:
        yield "The geometry of the blocks is unknown."
    elif (block.preset, block.scale) != ("released", 1.0):
        yield f"The blocks have preset {block.preset} at scale {block.scale:g}, not preset released at scale 1."
    if design.repeats != published.REPEATS:
        yield f"There are {design.repeats} repeats at each position, and {published.REPEATS} in the paper."
    if design.in_counts:
        yield (
            "The published figures have no interval, and include frames of other textures (row numbers were stored in "
            "8 bits), so a small difference may come from the method. The method is known only for Bambu PLA-, because "
            "only that output was saved; the program assumes that the other two rows were computed in the same way."
        )


def _same_forces(forces_n: Sequence[float]) -> bool:
    """Whether the forces are the paper's, within the bands that the paper reached."""
    return len(forces_n) == len(FORCES_N) and all(
        abs(own - paper) <= band for own, paper, band in zip(forces_n, FORCES_N, FORCE_SPREADS_N, strict=True)
    )


def _names(cells: pd.DataFrame) -> str:
    return _textures(texture_number(texture) or texture for texture in cells["texture"].unique())


def _textures(names: Iterable[object]) -> str:
    """Return the names in words: ``texture 4``, ``textures 1, 4, hex``."""
    words = list(map(str, names))
    return f"texture{'s' if len(words) > 1 else ''} {', '.join(words)}"
