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
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacbench_cad.lab.simulate.contact import DomeContact
from tacbench_cad.lab.simulate.rendering import READ_NOISE, Camera, blank, draw_discs, with_noise
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.spec.protocol import DOME_RADIUS_MM
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats

#: What every simulated image, run and plot says of its sensor.
SIMULATED = "simulated TacTip"
#: Rings of pins as measured on one TacTip: pins, first azimuth and step in degrees, tip's r and z in mm.
RINGS: tuple[tuple[int, float, float, float, float], ...] = (
    (1, 0.0, 0.0, 0.0, 17.48),
    (12, 7.5, 30.0, 3.38, 17.14),
    (12, 7.5, 30.0, 4.90, 16.77),
    (12, 7.5, 30.0, 7.03, 15.98),
    (24, 7.5, 15.0, 9.03, 14.92),
    (24, 7.5, 15.0, 10.88, 13.60),
    (24, 7.5, 15.0, 12.53, 12.02),
    (24, 7.5, 15.0, 14.00, 10.30),
)
#: Radius of the dome's inside; the skin's thickness is what is left to the outside.
INNER_RADIUS_MM = 18.4
#: Thickness of the skin.
SKIN_MM = DOME_RADIUS_MM - INNER_RADIUS_MM
#: Diameter of a pin.
PIN_DIAMETER_MM = 1.0
#: Mean brightness of a pin at rest, in counts, and the light's flicker from frame to frame, as a fraction.
PIN_COUNTS = 200.0
#: The light's flicker from frame to frame, as a fraction.
FLICKER = 0.003
#: LEDs in a ring round the lens: number, radius and z in the dome frame, in mm. An assumption: builds differ.
LEDS, LED_RADIUS_MM, LED_Z_MM = 6, 17.0, -15.0
#: The overlap is expanded in waves over a square of this side (wider than the dome by more than the kernel reaches)
#: up to the order at which the kernel has fallen below 1 %.
_SQUARE_MM = 52.0
_ORDER = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class Pins:
    """Where the pins are, in the dome frame.

    Args:
        tips_mm: Middle of each white tip, shape (133, 3).
        facing: Unit vector each tip faces, shape (133, 3).
    """

    tips_mm: Floats
    facing: Floats


def _pins_at_rest() -> Pins:
    rows = [
        (r * math.cos(azimuth), r * math.sin(azimuth), z)
        for count, first, step, r, z in RINGS
        for azimuth in (math.radians(first + step * i) for i in range(count))
    ]
    tips = np.array(rows)
    # Pins are radial: a tip faces the dome's centre.
    return Pins(tips_mm=tips, facing=-tips / np.linalg.norm(tips, axis=1, keepdims=True))


#: Where the pins are at rest, in mm of the dome's frame.
REST = _pins_at_rest()


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
        camera: The pinhole camera.
        flicker: Standard deviation of the light from frame to frame, as a fraction.

    Raises:
        InputError: The flicker is not from 0 to 1.
    """

    def __init__(self, *, colour: bool = True, camera: Camera | None = None, flicker: float = FLICKER) -> None:
        if not 0.0 <= flicker <= 1.0:
            raise InputError("flicker", flicker, "must be from 0 to 1")
        self.colour = colour
        self.camera = camera or Camera()
        self.flicker = flicker
        outward = -REST.facing
        self._skin = Skin(DOME_RADIUS_MM * outward[:, :2])
        middle_mm = (DOME_RADIUS_MM + INNER_RADIUS_MM) / 2.0
        self._roots_mm = middle_mm * outward
        self._levers_mm = middle_mm - np.linalg.norm(REST.tips_mm, axis=1)
        self._slopes = -outward[:, :2] / outward[:, 2:]
        self._counts = PIN_COUNTS / float(np.mean(_light(REST)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an image."""
        size = (self.camera.height_px, self.camera.width_px)
        return (*size, 3) if self.colour else size

    def as_dict(self) -> dict[str, Any]:
        """The settings as plain values."""
        return {
            "colour": self.colour,
            "flicker": self.flicker,
            "read_noise_counts": READ_NOISE,
            "focal_px": self.camera.focal_px,
        }

    def pins(self, contact: DomeContact | None, pose_mm: Point) -> Pins:
        """Where the pins are with the summit at a pose.

        Args:
            contact: What the dome is pressed on; None for the air.
            pose_mm: The summit in the work frame.
        """
        if contact is None or contact.force_n(*pose_mm) == 0.0:
            return REST
        overlap = contact.overlap(*pose_mm)
        w, slope = self._skin.displacement(overlap.depth_mm, overlap.x_mm, overlap.y_mm, overlap.cell_mm)
        facing = np.column_stack([self._slopes - slope, np.full(w.size, -1.0)])
        facing /= np.linalg.norm(facing, axis=1, keepdims=True)
        tips = self._roots_mm + self._levers_mm[:, None] * facing
        tips[:, 2] -= w
        return Pins(tips_mm=tips, facing=facing)

    def frame(self, pins: Pins, rng: np.random.Generator) -> Bytes:
        """One frame of pins, with flicker and noise.

        Args:
            pins: Where they are.
            rng: What flicker and noise are drawn by.
        """
        counts = self._counts * (1.0 + self.flicker * rng.standard_normal()) * _light(pins)
        clean = blank(self.camera)
        draw_discs(clean, self.camera, pins.tips_mm, pins.facing, PIN_DIAMETER_MM / 2.0, counts)
        return with_noise(clean, rng, colour=self.colour)

    def image(self, contact: DomeContact | None, pose_mm: Point, rng: np.random.Generator) -> Bytes:
        """The image with the summit at a pose.

        Args:
            contact: What the dome is pressed on; None for the air.
            pose_mm: The summit in the work frame.
            rng: Decides flicker and noise.

        Returns:
            uint8 of :attr:`shape`.
        """
        return self.frame(self.pins(contact, pose_mm), rng)


def _light(pins: Pins) -> Floats:
    """Light on each tip, relative: each LED gives cos / distance^2 on a matt surface; shape (133,)."""
    azimuth = 2.0 * math.pi * np.arange(LEDS) / LEDS
    leds = np.column_stack([LED_RADIUS_MM * np.cos(azimuth), LED_RADIUS_MM * np.sin(azimuth), np.full(LEDS, LED_Z_MM)])
    way = leds[None, :, :] - pins.tips_mm[:, None, :]
    square = np.sum(way**2, axis=2)
    cosine = np.einsum("pld,pd->pl", way, pins.facing) / np.sqrt(square)
    return np.asarray(np.sum(np.maximum(cosine, 0.0) / square, axis=1), dtype=np.float64)
