"""Small frames of a sensor with 49 bright dots that move by given distances: markers with a known truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock

SHAPE = (180, 200)
#: Beyond this distance a dot adds less than a millionth of a count.
REACH_PX = 15
COLUMNS, ROWS = (axis.ravel() for axis in np.meshgrid(24.0 + 24.0 * np.arange(7), 18.0 + 24.0 * np.arange(7)))
REST = np.column_stack([COLUMNS, ROWS])


def dots_frame(displacement: NDArray[np.float64], rng: np.random.Generator) -> Frame:
    """Return a noisy frame of displaced dots, shape (180, 200)."""
    image = np.full(SHAPE, 40.0)
    for column, row in REST + displacement:
        left, top = max(0, int(column) - REACH_PX), max(0, int(row) - REACH_PX)
        window = image[top : int(row) + REACH_PX, left : int(column) + REACH_PX]
        y, x = np.ogrid[top : top + window.shape[0], left : left + window.shape[1]]
        window += 120.0 * expit((4.5 - np.hypot(x - column, y - row)) / 0.5)
    return np.clip(np.rint(image + rng.standard_normal(SHAPE)), 0, 255).astype(np.uint8)


def dots_displacement(printed: PrintedBlock, press: Press) -> NDArray[np.float64]:
    """Return the displacement of the dots in a press, in pixels, shape (49, 2).

    The dots move away from the middle. The distance depends on texture, position, repeat and print.
    """
    own = np.random.default_rng([*printed.name.encode(), press.position, press.repeat])
    away = (REST - REST.mean(axis=0)) / 60.0
    push = away * np.exp(0.5 - 0.5 * np.sum(away**2, axis=1, keepdims=True))
    return push * (4.0 + int(printed.object_label) + 0.5 * press.force_level) + own.normal(0.0, 0.4, 2)


def dots_image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    """Return the frame of a press."""
    return dots_frame(dots_displacement(printed, press), rng)


def dots_at_rest(rng: np.random.Generator) -> Frame:
    """Return a frame without contact."""
    return dots_frame(np.zeros_like(REST), rng)
