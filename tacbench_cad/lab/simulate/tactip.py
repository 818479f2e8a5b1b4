"""A simulated TacTip: from the dome's overlap with the ground to where its pins are, and to the camera's image.

The skin spreads the overlap ``p`` sideways, also beyond the contact. A load on an elastic layer reaches the depth t
below it spread by Boussinesq's kernel ``3 t^3 / (2 pi (r^2 + t^2)^(5/2))``, whose Fourier transform is
``(1 + q t) exp(-q t)``: with t the skin's thickness this gives the displacement ``w`` of the skin's inside. A pin
moves inwards by ``w`` and turns with the skin, whose slope changes by the gradient of ``w``; its white tip is
the end of a lever that begins in the middle of the skin. The gel's volume and the skin's stretching are left out.

Dome frame: origin at the dome's centre, x and y as the block's, z towards the summit, so downwards on the rig. The
camera looks along +z. In the image x grows to the right and y upwards, as seen from above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.simulate.contact import DomeContact
from tacbench_cad.lab.simulate.looks import CLEAN, INNER_RADIUS_MM, SKIN_MM, Look, Ring
from tacbench_cad.lab.simulate.rendering import (
    Camera,
    Discs,
    Scene,
    along,
    compressed,
    discs,
    drawn,
    scene,
    sharpened,
    tinted,
    visible,
    with_noise,
)
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.spec.protocol import DOME_RADIUS_MM
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats

#: What every simulated image, run and plot says of its sensor.
SIMULATED = "simulated TacTip"
#: LEDs in a ring round the lens: number, radius and z in the dome frame, in mm. An assumption: builds differ.
LEDS, LED_RADIUS_MM, LED_Z_MM = 6, 17.0, -15.0
#: Fraction by which the light has to change before a compressed video shows it: half a count at white.
LIGHT_STEP = 0.002
#: The overlap is expanded in waves over a square of this side (wider than the dome by more than the kernel reaches)
#: up to the order at which the kernel has fallen below 1 %.
_SQUARE_MM = 52.0
_ORDER = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class Pins:
    """Where the pins are, in the dome frame.

    Args:
        tips_mm: Middle of each white tip, shape (n, 3).
        facing: Unit vector each tip faces, shape (n, 3).
        sway_px: How far the dome's outline is off: its centre along columns and rows, and its radius.
    """

    tips_mm: Floats
    facing: Floats
    sway_px: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Markers:
    """The pins as a frame shows them, free of noise.

    Args:
        centres_px: Columns and rows of their middles, shape (n, 2).
        visible: Which of them can be seen: the peak stands 5 standard deviations of noise and grain above its
            surroundings, and no reflection covers the centre; shape (n,).
    """

    centres_px: Floats
    visible: NDArray[np.bool_]


def _pins_at_rest(rings: tuple[Ring, ...]) -> Pins:
    rows = [
        (r * math.cos(azimuth), r * math.sin(azimuth), z)
        for count, first, step, r, z in rings
        for azimuth in (math.radians(first + step * i) for i in range(count))
    ]
    tips = np.array(rows)
    # Pins are radial: a tip faces the dome's centre.
    return Pins(tips_mm=tips, facing=-tips / np.linalg.norm(tips, axis=1, keepdims=True))


class Skin:
    """The overlap's way through the skin to the pins, as one linear map in Fourier space.

    Args:
        places_mm: Where the displacement is wanted, from the axis, shape (n, 2).
        thickness_mm: Thickness t of the skin.
    """

    def __init__(self, places_mm: Floats, thickness_mm: float = SKIN_MM) -> None:
        step = 2.0 * math.pi / _SQUARE_MM
        self._qx = step * np.arange(_ORDER + 1)  # p is real: the other half are conjugates
        self._qy = step * np.arange(-_ORDER, _ORDER + 1)
        q = np.hypot(self._qx[None, :], self._qy[:, None])
        kernel = (1.0 + q * thickness_mm) * np.exp(-q * thickness_mm) / _SQUARE_MM**2
        kernel[:, 1:] *= 2.0
        self._kernel = kernel
        self._along_x = np.exp(1j * np.outer(places_mm[:, 0], self._qx))
        self._along_y = np.exp(1j * np.outer(places_mm[:, 1], self._qy))

    def displacement(self, depth_mm: Floats, x_mm: Floats, y_mm: Floats, cell_mm: float) -> tuple[Floats, Floats]:
        """Displacement w of the skin's inside, and its gradient, at the places.

        Args:
            depth_mm: The overlap of each cell, shape (ny, nx).
            x_mm: The columns' places from the axis, shape (nx,).
            y_mm: The rows' places from the axis, shape (ny,).
            cell_mm: Side of a cell.

        Returns:
            w in mm, shape (n,), and its gradient, shape (n, 2).
        """
        turn_x, turn_y = np.outer(x_mm, self._qx), np.outer(self._qy, y_mm)
        by_column = depth_mm @ np.hstack([np.cos(turn_x), -np.sin(turn_x)])
        half = self._qx.size
        waves = np.exp(-1j * turn_y) @ (by_column[:, :half] + 1j * by_column[:, half:])
        waves *= self._kernel * cell_mm**2
        spread = self._along_y @ waves
        w = np.real(np.sum(spread * self._along_x, axis=1))
        slope_x = np.real(np.sum(spread * (1j * self._qx) * self._along_x, axis=1))
        slope_y = np.real(np.sum((self._along_y * (1j * self._qy)) @ waves * self._along_x, axis=1))
        return w, np.stack([slope_x, slope_y], axis=1)


class TacTip:
    """The sensor. It has no memory: an image follows from contact, pose and generator alone.

    Args:
        colour: Images of shape (480, 640, 3), BGR; else (480, 640).
        camera: The pinhole camera; None for the look's own.
        flicker: Standard deviation of the light from frame to frame, as a fraction; None for the look's own.
        look: Its pins, light and camera.

    Attributes:
        rest: The pins in the air.

    Raises:
        InputError: The flicker is not from 0 to 1.
    """

    def __init__(
        self, *, colour: bool = True, camera: Camera | None = None, flicker: float | None = None, look: Look = CLEAN
    ) -> None:
        self.flicker = look.flicker if flicker is None else flicker
        if not 0.0 <= self.flicker <= 1.0:
            raise InputError("flicker", flicker, "must be from 0 to 1")
        self.colour = colour
        self.look = look
        self.camera = camera or Camera(focal_px=look.focal_px, middle_px=look.centre_px)
        self.rest = _pins_at_rest(look.rings)
        outward = -self.rest.facing
        self._skin = Skin(DOME_RADIUS_MM * outward[:, :2])
        middle_mm = (DOME_RADIUS_MM + INNER_RADIUS_MM) / 2.0
        self._roots_mm = middle_mm * outward
        self._levers_mm = middle_mm - np.linalg.norm(self.rest.tips_mm, axis=1)
        self._slopes = -outward[:, :2] / outward[:, 2:]
        radii_px = np.linalg.norm(self.camera.pixels(self.rest.tips_mm) - self.camera.middle_px, axis=1)
        places = radii_px / np.max(radii_px)
        light = _light(self.rest)
        spread = 1.0 + look.pin_spread * np.random.Generator(np.random.SFC64(look.seed)).standard_normal(light.size)
        # A single level is that of the LEDs' law; several are what was measured, reflections of the skin included.
        self._counts = (
            spread * _by_place(places, look.pin_counts) / (np.mean(light) if len(look.pin_counts) == 1 else light)
        )
        self._edge_px = _by_place(places, look.pin_edge_px)
        self._skin_counts = along(radii_px / max(look.dome_radius_px, 1.0), look.skin)

    @cached_property
    def _scene(self) -> Scene:
        return scene(self.look, self.camera)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an image."""
        size = (self.camera.height_px, self.camera.width_px)
        return (*size, 3) if self.colour else size

    def as_dict(self) -> dict[str, Any]:
        """The settings as plain values."""
        return {
            "look": self.look.name,
            "colour": self.colour,
            "flicker": self.flicker,
            "noise_counts": [list(knot) for knot in self.look.noise],
            "focal_px": self.camera.focal_px,
        }

    def pins(self, contact: DomeContact | None, pose_mm: Point) -> Pins:
        """Where the pins are with the summit at a pose.

        Args:
            contact: What the dome is pressed on; None for the air.
            pose_mm: The summit in the work frame.
        """
        if contact is None or contact.force_n(*pose_mm) == 0.0:
            return self.rest
        overlap = contact.overlap(*pose_mm)
        w, slope = self._skin.displacement(overlap.depth_mm, overlap.x_mm, overlap.y_mm, overlap.cell_mm)
        facing = np.column_stack([self._slopes - slope, np.full(w.size, -1.0)])
        facing /= np.linalg.norm(facing, axis=1, keepdims=True)
        tips = self._roots_mm + self._levers_mm[:, None] * facing
        tips[:, 2] -= w
        return Pins(tips_mm=tips, facing=facing)

    def approach(self, contact: DomeContact | None, pose_mm: Point, rng: np.random.Generator) -> Pins:
        """Where the pins are after another approach to a pose, which misses it by an error of its own.

        Args:
            contact: What the dome is pressed on; None for the air.
            pose_mm: The summit in the work frame, as the stage reports it. A gauge has found the force there, so it is
                reached where the summit really is.
            rng: Decides the errors.
        """
        force_n = contact.force_n(*pose_mm) if contact is not None and self.look.misses else 0.0
        if contact is None or force_n == 0.0:
            return self.pins(contact, pose_mm)
        spreads = np.repeat([self.look.approach_mm, *self.look.sway_px], (2, 2, 1))
        dx, dy, column, row, radius = (spreads * rng.standard_normal(5)).tolist()
        x, y = pose_mm[0] + dx, pose_mm[1] + dy
        return replace(self.pins(contact, (x, y, contact.z_for_force(x, y, force_n))), sway_px=(column, row, radius))

    def frame(self, pins: Pins, rng: np.random.Generator, seconds: float = 0.0) -> Bytes:
        """One frame of pins, with flicker and noise.

        Args:
            pins: Where they are.
            rng: What flicker and noise are drawn by.
            seconds: Time since the run began.
        """
        look, place = self.look, self._scene
        light = 1.0 + self.flicker * rng.standard_normal()
        light *= 1.0 + sum(excess * math.exp(-seconds / constant_s) for excess, constant_s in look.transients)
        if look.jpeg_quality is not None:
            # A video's compression keeps the picture as it is until the light has changed.
            light = LIGHT_STEP * round(light / LIGHT_STEP)
        image = drawn(place, self._discs(pins, light), light, pins.sway_px)
        if look.sharpening:
            image = sharpened(image, look.sharpening)
        if self.colour:
            image = tinted(image, place, look)
        if look.jpeg_quality is not None:
            image = compressed(image, look.jpeg_quality)
        return with_noise(image, look, rng)

    def markers(self, pins: Pins) -> Markers:
        """The truth of a frame of pins: where each of them is in the image, and whether it can be seen."""
        markers = self._discs(pins, 1.0)
        return Markers(centres_px=markers.middles_px, visible=visible(markers, self._scene, self.look))

    def _discs(self, pins: Pins, light: float) -> Discs:
        counts = self._counts * light * _light(pins) - self.look.black_counts - light * self._skin_counts
        radius_mm = self.look.pin_diameter_mm / 2.0
        return discs(self.camera, pins.tips_mm, pins.facing, radius_mm, counts, self._edge_px)

    def image(
        self, contact: DomeContact | None, pose_mm: Point, rng: np.random.Generator, seconds: float = 0.0
    ) -> Bytes:
        """The image with the summit at a pose.

        Args:
            contact: What the dome is pressed on; None for the air.
            pose_mm: The summit in the work frame.
            rng: Decides flicker and noise.
            seconds: Time since the run began.

        Returns:
            uint8 of :attr:`shape`.
        """
        return self.frame(self.pins(contact, pose_mm), rng, seconds)


def _by_place(places: Floats, values: tuple[float, ...]) -> Floats:
    """Values at the centre, the middle and the rim of the pins' field, taken at places from 0 to 1."""
    return np.asarray(np.interp(places, np.linspace(0.0, 1.0, len(values)), values), dtype=np.float64)


def _light(pins: Pins) -> Floats:
    """Light on each tip, relative: each LED gives cos / distance^2 on a matt surface; shape (n,)."""
    azimuth = 2.0 * math.pi * np.arange(LEDS) / LEDS
    leds = np.column_stack([LED_RADIUS_MM * np.cos(azimuth), LED_RADIUS_MM * np.sin(azimuth), np.full(LEDS, LED_Z_MM)])
    way = leds[None, :, :] - pins.tips_mm[:, None, :]
    square = np.sum(way**2, axis=2)
    cosine = np.einsum("pld,pd->pl", way, pins.facing) / np.sqrt(square)
    return np.asarray(np.sum(np.maximum(cosine, 0.0) / square, axis=1), dtype=np.float64)
