"""Frames that look like five public recordings of optical tactile sensors, with the true positions of their markers.

The numbers are measurements of real frames: geometry, grey levels, blur, noise, reflections and compression. This
module contains no real frames. It does not use the simulated sensor either, so that tests with these frames are
independent of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import expit

cv2 = pytest.importorskip("cv2")

Points = NDArray[np.float64]
Image = NDArray[np.uint8]
WIDTH, HEIGHT = 640, 480


@dataclass(frozen=True, kw_only=True)
class Look:
    """The look of a recording: lengths in pixels, brightness in counts, triples from the centre to the rim."""

    centre: tuple[float, float]
    radius: float
    rings: Sequence[tuple[int, float]]  # pins, radius
    pin_width: tuple[float, float, float]
    pin: tuple[float, float, float]
    skin: tuple[float, float, float]
    beyond: float
    pin_blur: tuple[float, float, float]
    edge_blur: float
    surround: tuple[float, float]
    ring: tuple[float, float] = (0.0, 0.0)  # width, counts
    spots: tuple[int, float, float, float] = (
        0,
        0.0,
        0.0,
        0.0,
    )  # reflections: count, smallest, largest diameter, counts
    diffuse: tuple[int, float, float] = (0, 0.0, 0.0)  # soft reflections: count, width at half maximum, counts
    leds: tuple[int, float, float] = (0, 0.0, 0.0)  # lamps outside the dome: count, diameter, radius / R
    green: float = 0.0  # radius of a thin bright circle outside the dome
    noise: tuple[float, float] = (1.3, 0.8)  # in the dark, in the light
    jpeg: int = 0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)


_BRISTOL = (20.5, 39, 57, 74, 91.5, 108, 124.5, 140, 156, 170)
_SUSSEX = (28, 41, 58, 75, 92, 108, 124)
_SPOKES = (12, 12, 12, 24, 24, 24, 24)


def _spokes(scale: float) -> tuple[tuple[int, float], ...]:
    return ((1, 0.0), *((n, r * scale) for n, r in zip(_SPOKES, _SUSSEX, strict=True)))


LOOKS = {
    "A": Look(
        centre=(304, 248), radius=210, rings=((1, 0.0), *((6 * k, r) for k, r in enumerate(_BRISTOL, 1))),
        pin_width=(11.7, 11.2, 10.5), pin=(150, 139, 145), skin=(22, 23, 24), beyond=31, pin_blur=(0.73, 0.75, 0.95),
        edge_blur=1.2, surround=(191, 103), spots=(9, 3, 8.3, 250), leds=(6, 45, 1.075), tint=(1.3, 0.97, 0.75),
    ),
    "B": Look(
        centre=(301, 256), radius=210, rings=((1, 0.0), *((6 * k, r) for k, r in enumerate(
            (18, 36, 53, 70, 88, 105, 121.5, 138, 153, 169), 1))),
        pin_width=(11.5, 11.2, 10.8), pin=(234, 225, 232), skin=(64, 69, 70), beyond=77, pin_blur=(0.79, 0.84, 1.0),
        edge_blur=0.8, surround=(255, 233), spots=(6, 12, 13.3, 250), noise=(0.8, 0.8),
    ),
    "C": Look(
        centre=(301, 262), radius=169, rings=_spokes(1.0), pin_width=(9.1, 10.4, 10.0), pin=(247, 248, 248),
        skin=(92, 89, 95), beyond=109, pin_blur=(1.2, 1.2, 1.3), edge_blur=1.0, surround=(248, 194), ring=(19.5, 248),
        spots=(14, 4, 34, 251), green=199, jpeg=80, tint=(0.97, 1.0, 1.03), noise=(0.6, 0.6),
    ),
    "D": Look(
        centre=(340, 290), radius=164, rings=_spokes(1.0), pin_width=(9.8, 10.9, 10.4), pin=(223, 226, 215),
        skin=(88, 92, 80), beyond=45, pin_blur=(2.0, 2.1, 1.9), edge_blur=1.6, surround=(245, 117), ring=(15, 247),
        spots=(6, 10, 27, 248), green=192, jpeg=80, noise=(0.9, 0.7),
    ),
    "E": Look(
        centre=(325, 220), radius=144.5, rings=_spokes(0.87), pin_width=(6.1, 7.0, 6.8), pin=(180, 203, 204),
        skin=(100, 127, 94), beyond=53, pin_blur=(1.4, 1.5, 1.5), edge_blur=2.3, surround=(225, 250),
        spots=(8, 3.5, 14, 250), diffuse=(6, 26, 130), jpeg=75, noise=(1.0, 0.8),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Shot:
    """A BGR frame, the positions of its markers (n, 2), which of them are visible, and their positions at rest."""

    image: Image
    markers: Points
    visible: NDArray[np.bool_]
    rest: Points


def lattice(look: Look) -> Points:
    """Return the positions of the pins at rest, in pixels, shape (n, 2)."""
    parts = []
    for count, radius in look.rings:
        first = 7.5 if look.rings[1][0] == 12 else 0.0
        angle = np.radians(first + 360.0 * np.arange(count) / count)
        parts.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(parts) + look.centre


def pressed(rest: Points, look: Look, max_px: float, rng: np.random.Generator) -> Points:
    """Return the pins pushed away from a contact by at most ``max_px`` pixels, with the skin dragged along."""
    reach = look.rings[-1][1]
    contact = look.centre + rng.uniform(-0.3, 0.3, 2) * reach
    width = rng.uniform(0.35, 0.6) * reach
    away = (rest - contact) / width
    push = away * np.exp(0.5 - 0.5 * np.sum(away**2, axis=1, keepdims=True))
    fixed = np.clip(1.15 - np.hypot(*(rest - look.centre).T) / reach, 0.0, 1.0)[:, None]
    displacement = push * np.minimum(1.0, 2.0 * fixed) + rng.normal(0, 0.35, 2) * fixed**0.7
    return rest + displacement * max_px / np.max(np.hypot(*displacement.T))


@cache
def draw(look: Look, seed: int, max_px: float = 0.0, *, light: float = 1.0, blur: float = 0.0) -> Shot:
    """Draw a frame of a look. The frame is cached, so it must not be changed.

    Lamps, reflections and unevenness depend on the look; the press and the noise depend on the seed.

    Args:
        look: The look.
        seed: The seed of the press and the noise.
        max_px: The largest displacement of a pin, in pixels.
        light: A factor of the brightness.
        blur: The standard deviation of an additional blur inside the dome, as of a camera out of focus, in pixels.
    """
    fixed, rng = np.random.default_rng(1), np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    r = np.hypot(x - look.centre[0], y - look.centre[1])
    rel = r / look.radius
    rest = lattice(look)
    places = pressed(rest, look, max_px, rng) if max_px else rest + rng.normal(0, 0.3, 2)
    uneven = 1.0 + 0.08 * _smooth(fixed, 90) + 0.04 * _smooth(fixed, 25)
    field = look.rings[-1][1] / look.radius
    inside = np.interp(rel, (0, field / 2, field, field + 0.1), (*look.skin, look.beyond)) * uneven
    pins = np.zeros_like(x)
    where = np.hypot(*(rest - look.centre).T) / look.rings[-1][1]
    for (px, py), at in zip(places, where, strict=True):
        width, level, soft, skin = (
            np.interp(at, (0, 0.5, 1), v) for v in (look.pin_width, look.pin, look.pin_blur, look.skin)
        )
        level = level * (1.0 + 0.04 * fixed.standard_normal())
        left, top = int(px) - 16, int(py) - 16
        window = (slice(max(0, top), top + 33), slice(max(0, left), left + 33))
        d = np.hypot(x[window] - px, y[window] - py)
        disc = expit((width / 2 - d) / (0.6 * soft))
        pins[window] = np.maximum(pins[window], (level - skin) * disc)
    inside = inside + pins
    visible = np.ones(len(rest), bool)
    count, low, high, level = look.spots
    for i in range(count):
        angle, far = fixed.uniform(0, 2 * np.pi), field * look.radius * np.sqrt(fixed.uniform(0.02, 1.1))
        size = low * (high / low) ** (fixed.uniform() ** 2 if i else 1.0)
        sx, sy = look.centre[0] + far * np.cos(angle), look.centre[1] + far * np.sin(angle)
        stretch = fixed.uniform(0.6, 1.0)
        d = np.hypot((x - sx) / stretch, y - sy)
        cover = expit((size / 2 - d) / 0.7)
        inside = inside + (level - inside) * cover
        visible &= np.hypot(*(places - (sx, sy)).T) > size / 2 + 1.0
    count, size, level = look.diffuse
    for i in range(count):
        angle, far = 2 * np.pi * i / count + 0.3, look.radius * fixed.uniform(0.37, 0.55)
        sx, sy = look.centre[0] + far * np.cos(angle), look.centre[1] + far * np.sin(angle)
        inside = inside + level * np.exp(-((x - sx) ** 2 + (y - sy) ** 2) / (2 * (size / 2.355) ** 2))
        visible &= np.hypot(*(places - (sx, sy)).T) > size / 2
    outside = np.interp(rel, (1.02, 1.8), look.surround) * (1.0 + 0.1 * _smooth(fixed, 40) + 0.02 * _smooth(fixed, 3))
    count, size, far = look.leds
    for i in range(count):
        angle = 2 * np.pi * i / count
        at = np.array(look.centre) + far * look.radius * np.array([np.cos(angle), np.sin(angle)])
        d = np.hypot(x - at[0], y - at[1])
        outside = outside + 200.0 * expit((size / 2 - d) / 2.0)
    if look.green:
        outside = outside + 40.0 * np.exp(-((r - look.green) ** 2) / 18.0)
    if look.ring[0]:
        edge = expit(look.radius + look.ring[0] - r)
        outside = outside + (look.ring[1] - outside) * edge
    if blur:
        inside = cv2.GaussianBlur(inside, (0, 0), blur)
    mask = expit((look.radius - r) / (0.6 * look.edge_blur))
    grey = np.clip(light * (mask * inside + (1.0 - mask) * outside), 0, 255)
    noise = np.interp(grey, (16, 128), look.noise)
    tint = np.where(mask[..., None] > 0.5, look.tint, 1.0)
    bgr = grey[..., None] * tint + noise[..., None] * rng.standard_normal((HEIGHT, WIDTH, 3))
    image = np.clip(np.rint(bgr), 0, 255).astype(np.uint8)
    if look.jpeg:
        image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, look.jpeg])[1], cv2.IMREAD_COLOR)
    return Shot(image, places, visible, rest)


def gel(seed: int, max_px: float = 0.0) -> Shot:
    """Draw a rectangular gel with 63 dark dots, nearly as wide as the frame and lit in three colours from its sides."""
    fixed, rng = np.random.default_rng(2), np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    columns, rows = np.meshgrid(np.linspace(110, 530, 9), np.linspace(80, 400, 7))
    rest = np.column_stack([columns.ravel(), rows.ravel()])
    away = (rest - (300, 250)) / 110.0
    push = away * np.exp(0.5 - 0.5 * np.sum(away**2, axis=1, keepdims=True))
    places = rest + max_px * push
    grey = 120.0 + 10.0 * _smooth(fixed, 60)
    for px, py in places:
        d = np.hypot(x - px, y - py)
        grey = grey * (1.0 - 0.7 * expit((7.0 - d) / 0.9))
    mask = expit(np.minimum(np.minimum(x - 60, 580 - x), np.minimum(y - 30, 450 - y)))
    sides = np.stack([0.6 + 0.7 * x / WIDTH, 0.7 + 0.5 * y / HEIGHT, 1.3 - 0.7 * x / WIDTH], axis=-1)
    bgr = grey[..., None] * sides * mask[..., None] + 12.0 + rng.standard_normal((HEIGHT, WIDTH, 3))
    return Shot(np.clip(bgr, 0, 255).astype(np.uint8), places, np.ones(len(rest), bool), rest)


def _smooth(rng: np.random.Generator, width: float) -> NDArray[Any]:
    """Return a smooth random picture with standard deviation 1."""
    step = max(1.0, width / 4.0)  # a wide blur needs no full resolution
    small = rng.standard_normal((round(HEIGHT / step), round(WIDTH / step)))
    picture = cv2.resize(cv2.GaussianBlur(small, (0, 0), width / step), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.asarray(picture / picture.std())
