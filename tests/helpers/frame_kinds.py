"""Frames like those of public sources of other sensors than the TacTips of ``lookalikes``, with their true markers.

The sizes, spacings, widths and levels follow measurements of real frames; there are no real frames here. A kind is a
function of a seed and of the strength of the contact, and the lights of a kind are always the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from helpers.lookalikes import LOOKS, Image, Points, Shot, draw

Floats = NDArray[np.float64]
NONE: Points = np.zeros((0, 2))
#: The 127 pins of a smaller TacTip: rings of 6 k pins.
RINGS_127 = ((1, 0.0), *((6 * k, 27.5 * k) for k in range(1, 7)))
SMALLER = replace(LOOKS["A"], rings=RINGS_127, pin_width=(14.0, 13.5, 13.0), leds=(0, 0.0, 0.0))
GLARING = replace(
    SMALLER, rings=tuple((count, 0.82 * radius) for count, radius in RINGS_127), pin=(150, 135, 105), skin=(56, 62, 62),
    pin_blur=(2.0, 2.0, 2.4), spots=(10, 5, 20, 230), diffuse=(6, 36, 60), noise=(3.0, 3.0), surround=(70, 40),
    tint=(1.0, 1.0, 1.0),
)  # fmt: skip


def cut(shot: Shot, middle: tuple[float, float], side: int, size: int) -> Shot:
    """Cut a square from a shot, and reduce it to ``size`` x ``size`` grey pixels."""
    left, top = round(middle[0] - side / 2), round(middle[1] - side / 2)
    grey = cv2.cvtColor(shot.image, cv2.COLOR_BGR2GRAY)
    framed = cv2.copyMakeBorder(grey, 120, 120, 120, 120, cv2.BORDER_REPLICATE)
    square = framed[top + 120 : top + 120 + side, left + 120 : left + 120 + side]

    def moved(places: Points) -> Points:
        return (places - (left, top) + 0.5) * size / side - 0.5

    image = cv2.resize(square, (size, size), interpolation=cv2.INTER_AREA)
    return Shot(np.asarray(image), moved(shot.markers), shot.visible, moved(shot.rest))


def tactip(seed: int, contact: float) -> Shot:
    """A TacTip with 331 pins in colour, 640 x 480."""
    return draw(LOOKS["A"], seed, 12.0 * contact)


def tactip_binary(seed: int, contact: float) -> Shot:
    """The same, thresholded and reduced to 128 x 128, only 0 and 255: pins of sigma 1.07 px."""
    shot = tactip(seed, contact)
    y, x = np.mgrid[:480, :640]
    dome = np.hypot(x - LOOKS["A"].centre[0], y - LOOKS["A"].centre[1]) < 0.97 * LOOKS["A"].radius
    pins = (cv2.cvtColor(shot.image, cv2.COLOR_BGR2GRAY) > 85) & dome
    grey = cut(
        replace(shot, image=np.repeat(pins[..., None].astype(np.uint8) * 255, 3, axis=2)), LOOKS["A"].centre, 480, 128
    )
    return replace(grey, image=np.where(grey.image > 127, np.uint8(255), np.uint8(0)))


def tactip_127(seed: int, contact: float) -> Shot:
    """A TacTip with 127 pins in grey, 256 x 256."""
    return cut(draw(SMALLER, seed, 20.0 * contact), SMALLER.centre, 460, 256)


def tactip_glare(seed: int, contact: float) -> Shot:
    """A TacTip with 127 weak pins below reflections, 300 x 300."""
    return cut(draw(GLARING, seed, 25.0 * contact), GLARING.centre, 300, 300)


def _gradient(axis: Floats, low: float, high: float, reach: float) -> Floats:
    """Return the brightness of a lamp that falls from one side of the frame."""
    return low + (high - low) * np.exp(-axis / reach)


def _lit(height_px: Floats, sides: tuple[tuple[float, float, float], ...], levels: Floats) -> Floats:
    """Shade a soft gel of some height by a coloured lamp from each side; shape (height, width, 3), BGR."""
    slope_y, slope_x = np.gradient(height_px)
    colours = [
        level * (1.0 + gain * (x * slope_x + y * slope_y)) for level, (x, y, gain) in zip(levels, sides, strict=True)
    ]
    return np.stack(colours, axis=-1)


def _finished(bgr: Floats, rng: np.random.Generator, noise: float, blur: float, jpeg: int) -> Image:
    soft = cv2.GaussianBlur(bgr, (0, 0), blur)
    image = np.clip(np.rint(soft + noise * rng.standard_normal(bgr.shape)), 0, 255).astype(np.uint8)
    if jpeg:
        image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1], cv2.IMREAD_COLOR)
    return np.asarray(image)


def _imprint(y: Floats, x: Floats, rng: np.random.Generator) -> Floats:
    """Return the relief of a material, in px: a weave, a cord, grains or a smooth bump, at a random place and angle."""
    angle, pitch = rng.uniform(0, np.pi), rng.uniform(9.0, 22.0)
    u, v = (x * np.cos(angle) + y * np.sin(angle)) / pitch, (y * np.cos(angle) - x * np.sin(angle)) / pitch
    u, v = u + rng.uniform(), v + rng.uniform()
    grains = cv2.GaussianBlur(rng.standard_normal(x.shape), (0, 0), rng.uniform(2.0, 6.0))
    relief = (
        np.cos(2 * np.pi * u) * np.cos(2 * np.pi * v),
        np.cos(2 * np.pi * u),
        grains / grains.std(),
        np.zeros_like(x),
    )[int(rng.integers(4))]
    height, width = x.shape
    cx, cy = rng.uniform(0.35, 0.65, 2) * (width, height)
    size = rng.uniform(0.18, 0.32) * height
    near = expit((size - np.hypot((x - cx) / rng.uniform(0.8, 1.3), y - cy)) / 6.0)
    return np.asarray(near * (4.0 + 0.9 * rng.uniform(0.4, 1.2) * relief))


def digit(seed: int, contact: float) -> Shot:
    """A DIGIT: a soft image of 240 x 320 lit in three colours from its sides, without markers, as a JPEG."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:320, :240].astype(np.float64)
    light = np.stack([
        _gradient(240.0 - x, 60.0, 150.0, 90.0) + 12.0 * _patch(x, y, 150, 200, 70.0),
        50.0 + 120.0 * _patch(x, y, 115, 70, 60.0),
        _gradient(x, 70.0, 160.0, 80.0) + 15.0 * _patch(x, y, 60, 250, 60.0),
    ])  # fmt: skip
    height = contact * _imprint(y, x, rng)
    sides = ((-1.0, 0.0, 0.5), (0.0, 1.0, 0.5), (1.0, 0.0, 0.5))
    return Shot(_finished(_lit(height, sides, light), rng, 1.6, 1.6, 85), NONE, np.zeros(0, bool), NONE)


def _patch(x: Floats, y: Floats, column: float, row: float, width: float) -> Floats:
    return np.asarray(np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2.0 * width**2)))


def gelsight_mini(seed: int, contact: float) -> Shot:
    """A GelSight Mini without dots, 240 x 320, and the print of a ball for its calibration."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:240, :320].astype(np.float64)
    light = np.stack([_gradient(320.0 - x, 70, 130, 150.0), 80.0 + 70.0 * _patch(x, y, 170, 60, 90.0),
                      _gradient(240.0 - y, 60, 140, 110.0)])  # fmt: skip
    column, row, ball = rng.uniform(90, 230), rng.uniform(70, 170), 60.0
    square = ball**2 - (x - column) ** 2 - (y - row) ** 2
    depth = contact * 8.0
    height = np.maximum(np.sqrt(np.maximum(square, 0.0)) - (ball - depth), 0.0)
    sides = ((-1.0, 0.0, 0.6), (0.0, 1.0, 0.6), (1.0, -1.0, 0.5))
    return Shot(_finished(_lit(height, sides, light), rng, 1.5, 1.2, 0), NONE, np.zeros(0, bool), NONE)


def gelsight_dots(seed: int, contact: float) -> Shot:
    """A GelSight with 8 x 6 dark dots under uneven light, 640 x 480, and the relief of a material."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:480, :640].astype(np.float64)
    columns, rows = np.meshgrid(np.linspace(75, 565, 8), np.linspace(65, 415, 6))
    rest = np.column_stack([columns.ravel(), rows.ravel()])
    middle = rng.uniform((200, 150), (440, 330))
    away = (rest - middle) / 120.0
    places = rest + 16.0 * contact * away * np.exp(0.5 - 0.5 * np.sum(away**2, axis=1, keepdims=True))
    light = np.stack([_gradient(640.0 - x, 60, 170, 260.0), 70.0 + 90.0 * _patch(x, y, 330, 100, 190.0),
                      _gradient(x, 60, 170, 240.0)])  # fmt: skip
    bgr = _lit(contact * _imprint(y, x, rng), ((-1.0, 0.0, 0.5), (0.0, 1.0, 0.5), (1.0, 0.0, 0.5)), light)
    dark = np.ones_like(x)
    for column, row in places:
        dark *= 1.0 - 0.65 * expit((8.0 - np.hypot(x - column, y - row)) / 1.2)
    return Shot(_finished(bgr * dark[..., None], rng, 2.0, 0.8, 0), places, np.ones(48, bool), rest)


#: The kinds with markers and without, and the usual number of markers.
KINDS: dict[str, Callable[[int, float], Shot]] = {
    each.__name__: cache(each)
    for each in (tactip, tactip_binary, tactip_127, tactip_glare, gelsight_dots, digit, gelsight_mini)
}
WITH_MARKERS = {"tactip": 331, "tactip_binary": 331, "tactip_127": 127, "tactip_glare": 127, "gelsight_dots": 48}
WITHOUT = tuple(kind for kind in KINDS if kind not in WITH_MARKERS)


def frames_of(kind: str, count: int, seed: int = 0) -> list[Shot]:
    """Return shots of a kind in contact with random strengths."""
    rng = np.random.default_rng(seed)
    return [KINDS[kind](1000 * seed + i, float(rng.uniform(0.3, 1.0))) for i in range(count)]
