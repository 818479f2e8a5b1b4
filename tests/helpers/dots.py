"""Small frames of a sensor with 49 bright dots, each of which moves as it is told: markers with a known truth."""

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
COLUMNS, ROWS = (each.ravel() for each in np.meshgrid(24.0 + 24.0 * np.arange(7), 18.0 + 24.0 * np.arange(7)))
REST = np.column_stack([COLUMNS, ROWS])


def dots_frame(moved: NDArray[np.float64], rng: np.random.Generator) -> Frame:
    """A frame of dots that moved, with noise; shape (180, 200)."""
    image = np.full(SHAPE, 40.0)
    for column, row in REST + moved:
        left, top = max(0, int(column) - REACH_PX), max(0, int(row) - REACH_PX)
        window = image[top : int(row) + REACH_PX, left : int(column) + REACH_PX]
        y, x = np.ogrid[top : top + window.shape[0], left : left + window.shape[1]]
        window += 120.0 * expit((4.5 - np.hypot(x - column, y - row)) / 0.5)
    return np.clip(np.rint(image + rng.standard_normal(SHAPE)), 0, 255).astype(np.uint8)


def dots_moved(printed: PrintedBlock, press: Press) -> NDArray[np.float64]:
    """How far the dots move in a press: away from the middle, by texture, place, repeat and print; shape (49, 2)."""
    own = np.random.default_rng([*printed.name.encode(), press.position, press.repeat])
    away = (REST - REST.mean(axis=0)) / 60.0
    push = away * np.exp(0.5 - 0.5 * np.sum(away**2, axis=1, keepdims=True))
    return push * (4.0 + int(printed.object_label) + 0.5 * press.force_level) + own.normal(0.0, 0.4, 2)


def dots_image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    """The reading of a press."""
    return dots_frame(dots_moved(printed, press), rng)


def dots_at_rest(rng: np.random.Generator) -> Frame:
    """A frame without contact."""
    return dots_frame(np.zeros_like(REST), rng)
