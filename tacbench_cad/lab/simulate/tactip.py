"""A simulated TacTip: from the overlap of dome and surface to the positions of its pins and the camera's image.

The skin spreads the overlap ``p`` sideways, also beyond the contact. At the depth t in an elastic layer, a load is
spread by Boussinesq's kernel ``3 t^3 / (2 pi (r^2 + t^2)^(5/2))``, whose Fourier transform is
``(1 + q t) exp(-q t)``. With t as the skin's thickness, this gives the displacement ``w`` of the skin's inside. A pin
moves inwards by ``w`` and turns with the skin, whose slope changes by the gradient of ``w``. Its white tip is the end
of a lever that begins in the middle of the skin. The gel's volume and the stretching of the skin are ignored.

Friction acts only in a motion in contact: there the skin in contact lags behind the dome (see
:class:`tacbench_cad.lab.simulate.contact.Drag`), and the pins above it with it.

Dome frame: the origin is the dome's centre, x and y are those of the block, and z points to the summit, so downwards on
the rig. The camera looks along +z. In the image x grows to the right and y upwards, as seen from above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.simulate.appearances import CLEAN, Look, Ring
from tacbench_cad.lab.simulate.contact import DomeContact
from tacbench_cad.lab.simulate.rendering import (
    Discs,
    FrameCamera,
    PressedScene,
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
from tacbench_cad.spec.skin import INNER_RADIUS_MM, SKIN_MM, skin_transfer
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats

#: The name of the sensor in every simulated image, run and plot.
SIMULATED = "simulated TacTip"
#: The ring of LEDs around the lens: number, radius and z in the dome frame, in mm. It is an assumption; builds differ.
LEDS, LED_RADIUS_MM, LED_Z_MM = 6, 17.0, -15.0
#: The smallest change of the light that a compressed video shows, as a fraction: half a count at white.
LIGHT_STEP = 0.002
#: The radius of the middle of the skin, where the levers of the pins begin.
MIDDLE_MM = (DOME_RADIUS_MM + INNER_RADIUS_MM) / 2.0
#: The side of the square over which the overlap is expanded in waves. It exceeds the dome by more than the kernel's
#: reach. The expansion ends at the order at which the kernel has fallen below 1 %.
_SQUARE_MM = 52.0
_ORDER = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class Pins:
    """The positions of the pins in the dome frame.

    Args:
        tips_mm: The centre of each white tip, shape (n, 3).
        facing: The unit vector that each tip faces, shape (n, 3).
        sway_px: The offset of the dome's outline: its centre along columns and rows, and its radius.
    """

    tips_mm: Floats
    facing: Floats
    sway_px: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class PinPositions:
    """The pins in a frame, without noise.

    Args:
        centres_px: The columns and rows of their centres, shape (n, 2).
        visible: Whether each pin is visible: the peak is 5 standard deviations of noise and grain above its
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
    """The effect of the overlap on the pins through the skin, as one linear map in Fourier space.

    Args:
        places_mm: The points of the displacement, relative to the axis, shape (n, 2).
        thickness_mm: The thickness t of the skin.
    """

    def __init__(self, places_mm: Floats, thickness_mm: float = SKIN_MM) -> None:
        step = 2.0 * math.pi / _SQUARE_MM
        self._qx = step * np.arange(_ORDER + 1)  # p is real, so the other half are conjugates
        self._qy = step * np.arange(-_ORDER, _ORDER + 1)
        q = np.hypot(self._qx[None, :], self._qy[:, None])
        kernel = skin_transfer(q, thickness_mm) / _SQUARE_MM**2
        kernel[:, 1:] *= 2.0
        self._kernel = kernel
        self._along_x = np.exp(1j * np.outer(places_mm[:, 0], self._qx))
        self._along_y = np.exp(1j * np.outer(places_mm[:, 1], self._qy))

    def displacement(self, depth_mm: Floats, x_mm: Floats, y_mm: Floats, cell_mm: float) -> tuple[Floats, Floats]:
        """Return the displacement w of the skin's inside and its gradient at the points.

        Args:
            depth_mm: The overlap of each cell, shape (ny, nx).
            x_mm: The x of the columns relative to the axis, shape (nx,).
            y_mm: The y of the rows relative to the axis, shape (ny,).
            cell_mm: The side of a cell.

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
    """The sensor. An image depends only on contact, pose and random generator.

    Args:
        colour: Whether images have shape (480, 640, 3), BGR, or (480, 640).
        camera: The pinhole camera; None for the look's own.
        flicker: The standard deviation of the light from frame to frame, as a fraction; None for the look's own.
        look: The pins, light and camera.

    Attributes:
        rest: The pins without contact.

    Raises:
        InputError: The flicker is not from 0 to 1.
    """

    def __init__(
        self,
        *,
        colour: bool = True,
        camera: FrameCamera | None = None,
        flicker: float | None = None,
        look: Look = CLEAN,
    ) -> None:
        self.flicker = look.flicker if flicker is None else flicker
        if not 0.0 <= self.flicker <= 1.0:
            raise InputError("flicker", flicker, "must be from 0 to 1")
        self.colour = colour
        self.look = look
        self.camera = camera or FrameCamera(focal_px=look.focal_px, middle_px=look.centre_px)
        self.rest = _pins_at_rest(look.rings)
        self._levers_mm = MIDDLE_MM - np.linalg.norm(self.rest.tips_mm, axis=1)
        self._skin = Skin(-DOME_RADIUS_MM * self.rest.facing[:, :2])
        radii_px = np.linalg.norm(self.camera.pixels(self.rest.tips_mm) - self.camera.middle_px, axis=1)
        places = radii_px / np.max(radii_px)
        light = _light(self.rest)
        spread = 1.0 + look.pin_spread * np.random.Generator(np.random.SFC64(look.seed)).standard_normal(light.size)
        # A single level follows the law of the LEDs. Several levels were measured and include reflections of the skin.
        self._counts = (
            spread * _by_place(places, look.pin_counts) / (np.mean(light) if len(look.pin_counts) == 1 else light)
        )
        self._edge_px = _by_place(places, look.pin_edge_px)
        self._skin_counts = along(radii_px / max(look.dome_radius_px, 1.0), look.skin)

    @cached_property
    def _scene(self) -> PressedScene:
        return scene(self.look, self.camera)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of an image."""
        size = (self.camera.height_px, self.camera.width_px)
        return (*size, 3) if self.colour else size

    def as_dict(self) -> dict[str, Any]:
        """Return the settings as plain values."""
        return {
            "look": self.look.name,
            "colour": self.colour,
            "flicker": self.flicker,
            "noise_counts": [list(knot) for knot in self.look.noise],
            "focal_px": self.camera.focal_px,
        }

    def pins(self, contact: DomeContact | None, pose_mm: Point, lag_mm: tuple[float, float] = (0.0, 0.0)) -> Pins:
        """Return the pins with the summit at a pose.

        Args:
            contact: The surface under the dome; None for no contact.
            pose_mm: The summit in the work frame.
            lag_mm: The x and y by which the dome is ahead of the skin in contact, see
                :class:`~tacbench_cad.lab.simulate.contact.Drag`.
        """
        if contact is None or contact.force_n(*pose_mm) == 0.0:
            return self.rest
        overlap, outward = contact.overlap(*pose_mm), -self.rest.facing
        w, slope = self._skin.displacement(overlap.depth_mm, overlap.x_mm, overlap.y_mm, overlap.cell_mm)
        facing = -outward
        facing[:, :2] -= outward[:, 2:] * slope
        facing /= np.linalg.norm(facing, axis=1, keepdims=True)
        tips = MIDDLE_MM * outward + self._levers_mm[:, None] * facing
        tips[:, 2] -= w
        if lag_mm != (0.0, 0.0):
            # The skin that is pressed in most is the skin in contact. The skin around it lags less.
            tips[:, :2] -= (w / np.max(w))[:, None] * np.array(lag_mm)
        return Pins(tips_mm=tips, facing=facing)

    def approach(
        self,
        contact: DomeContact | None,
        pose_mm: Point,
        rng: np.random.Generator,
        lag_mm: tuple[float, float] = (0.0, 0.0),
    ) -> Pins:
        """Return the pins after another approach to a pose, which misses the pose by a random error.

        Args:
            contact: The surface under the dome; None for no contact.
            pose_mm: The summit in the work frame, as the stage reports it. A gauge has measured the force there, so the
                force is reached at the summit's true position.
            rng: The random generator of the errors.
            lag_mm: Same as for :meth:`pins`.
        """
        force_n = contact.force_n(*pose_mm) if contact is not None and self.look.misses else 0.0
        if contact is None or force_n == 0.0:
            return self.pins(contact, pose_mm, lag_mm)
        spreads = np.repeat([self.look.approach_mm, *self.look.sway_px], (2, 2, 1))
        dx, dy, column, row, radius = (spreads * rng.standard_normal(5)).tolist()
        x, y = pose_mm[0] + dx, pose_mm[1] + dy
        pins = self.pins(contact, (x, y, contact.z_for_force(x, y, force_n)), lag_mm)
        return replace(pins, sway_px=(column, row, radius))

    def frame(self, pins: Pins, rng: np.random.Generator, seconds: float = 0.0) -> Bytes:
        """Return one frame of pins, with flicker and noise.

        Args:
            pins: The pins.
            rng: The random generator of flicker and noise.
            seconds: The time since the start of the run.
        """
        look, place = self.look, self._scene
        light = 1.0 + self.flicker * rng.standard_normal()
        light *= 1.0 + sum(excess * math.exp(-seconds / constant_s) for excess, constant_s in look.transients)
        if look.jpeg_quality is not None:
            # A video's compression keeps the picture unchanged until the light has changed enough.
            light = LIGHT_STEP * round(light / LIGHT_STEP)
        image = drawn(place, self._discs(pins, light), light, pins.sway_px)
        if look.sharpening:
            image = sharpened(image, look.sharpening)
        if self.colour:
            image = tinted(image, place, look)
        if look.jpeg_quality is not None:
            image = compressed(image, look.jpeg_quality)
        return with_noise(image, look, rng)

    def markers(self, pins: Pins) -> PinPositions:
        """Return the true positions of the pins in the image, and whether each is visible."""
        markers = self._discs(pins, 1.0)
        return PinPositions(centres_px=markers.middles_px, visible=visible(markers, self._scene, self.look))

    def _discs(self, pins: Pins, light: float) -> Discs:
        counts = self._counts * light * _light(pins) - self.look.black_counts - light * self._skin_counts
        radius_mm = self.look.pin_diameter_mm / 2.0
        return discs(self.camera, pins.tips_mm, pins.facing, radius_mm, counts, self._edge_px)

    def image(
        self,
        contact: DomeContact | None,
        pose_mm: Point,
        rng: np.random.Generator,
        seconds: float = 0.0,
    ) -> Bytes:
        """Return the image with the summit at a pose.

        Args:
            contact: The surface under the dome; None for no contact.
            pose_mm: The summit in the work frame.
            rng: The random generator of flicker and noise.
            seconds: The time since the start of the run.

        Returns:
            uint8 of :attr:`shape`.
        """
        return self.frame(self.pins(contact, pose_mm), rng, seconds)


def _by_place(places: Floats, values: tuple[float, ...]) -> Floats:
    """Interpolate values at the centre, the middle and the rim of the pins' field, at positions from 0 to 1."""
    return np.asarray(np.interp(places, np.linspace(0.0, 1.0, len(values)), values), dtype=np.float64)


def _light(pins: Pins) -> Floats:
    """Return the relative light on each tip: each LED gives cos / distance^2 on a matt surface; shape (n,)."""
    azimuth = 2.0 * math.pi * np.arange(LEDS) / LEDS
    leds = np.column_stack([LED_RADIUS_MM * np.cos(azimuth), LED_RADIUS_MM * np.sin(azimuth), np.full(LEDS, LED_Z_MM)])
    way = leds[None, :, :] - pins.tips_mm[:, None, :]
    square = np.sum(way**2, axis=2)
    cosine = np.einsum("pld,pd->pl", way, pins.facing) / np.sqrt(square)
    return np.asarray(np.sum(np.maximum(cosine, 0.0) / square, axis=1), dtype=np.float64)
