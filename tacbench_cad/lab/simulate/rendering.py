"""The simulated sensor's camera: discs through a pinhole, antialiased, and the noise of a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist

import numpy as np

from tacbench_cad.util.types import Bytes, Floats

#: Read noise in counts, one standard deviation of a pixel from frame to frame, in every channel that is stored.
READ_NOISE = 1.4
#: What the dark skin between the pins sends back, in counts.
BACKGROUND = 2
#: Width over which the lens blurs an edge, in pixels.
EDGE_PX = 1.5
#: Fraction of the light in blue, green and red.
WHITE_LED_BGR = (0.92, 1.0, 0.96)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera on the dome's axis, looking at the summit.

    Args:
        width_px: Width of the image.
        height_px: Height of the image.
        focal_px: Focal length.
        below_mm: How far the pinhole lies from the dome's centre, on the side away from the summit.
    """

    width_px: int = 640
    height_px: int = 480
    focal_px: float = 601.0
    below_mm: float = 48.9

    @property
    def middle_px(self) -> tuple[float, float]:
        """Column and row of the axis."""
        return ((self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0)

    def pixels(self, points_mm: Floats) -> Floats:
        """Column and row, shape (n, 2), of points of the dome frame, shape (n, 3)."""
        scale = self.focal_px / (self.below_mm + points_mm[:, 2])
        column, row = self.middle_px
        return np.stack([column + scale * points_mm[:, 0], row - scale * points_mm[:, 1]], axis=1)


def blank(camera: Camera) -> Bytes:
    """What the camera sees without pins."""
    return np.full((camera.height_px, camera.width_px), BACKGROUND, dtype=np.uint8)


def draw_discs(
    image: Bytes, camera: Camera, middles_mm: Floats, facing: Floats, radius_mm: float, counts: Floats
) -> None:
    """Draw flat discs, which the camera sees as ellipses, into a grey image; the brighter one covers the other.

    Args:
        image: Changed in place.
        camera: The camera.
        middles_mm: Middles of the discs in the dome frame, shape (n, 3). A disc that leaves the image is not drawn.
        facing: Their unit normals, shape (n, 3).
        radius_mm: Their radius.
        counts: Brightness of each, shape (n,).
    """
    middles = camera.pixels(middles_mm)
    to_camera = -middles_mm - np.array([0.0, 0.0, camera.below_mm])
    distance = np.linalg.norm(to_camera, axis=1)
    radius_px = radius_mm * camera.focal_px / (camera.below_mm + middles_mm[:, 2])
    # An ellipse is short along the image of the disc's normal, by the cosine of the angle it is seen at.
    cosine = np.clip(np.einsum("nd,nd->n", to_camera, facing) / distance, 0.05, 1.0)
    azimuth = np.arctan2(-facing[:, 1], facing[:, 0])
    along_x, along_y = np.cos(azimuth), np.sin(azimuth)
    reach = math.ceil(float(np.max(radius_px)) + EDGE_PX)
    corner = np.floor(middles).astype(int) - reach
    at = np.arange(2 * reach + 2)
    dx = (corner[:, :1] + at[None, :] - middles[:, :1])[:, None, :]
    dy = (corner[:, 1:] + at[None, :] - middles[:, 1:])[:, :, None]
    short = (dx * along_x[:, None, None] + dy * along_y[:, None, None]) / cosine[:, None, None]
    long = dy * along_x[:, None, None] - dx * along_y[:, None, None]
    inside = np.clip((radius_px[:, None, None] - np.sqrt(short**2 + long**2)) / EDGE_PX + 0.5, 0.0, 1.0)
    stamps = np.clip(BACKGROUND + inside * (counts[:, None, None] - BACKGROUND) + 0.5, 0.0, 255.0).astype(np.uint8)
    side = at.size
    for stamp, (column, row) in zip(stamps, corner, strict=True):
        if 0 <= column <= camera.width_px - side and 0 <= row <= camera.height_px - side:
            window = image[row : row + side, column : column + side]
            np.maximum(window, stamp, out=window)


def with_noise(clean: Bytes, rng: np.random.Generator, *, colour: bool) -> Bytes:
    """A frame: the clean image with read noise, clipped at 0 and 255.

    Args:
        clean: Grey, shape (height, width).
        rng: Decides the noise: one byte of it for each value.
        colour: Return (height, width, 3), BGR, each channel with noise of its own.
    """
    import cv2

    image = clean
    if colour:
        image = np.asarray(cv2.LUT(cv2.merge([clean, clean, clean]), _white_led()), dtype=np.uint8)
    up, down = _noise_tables()
    drawn = np.frombuffer(rng.bytes(image.size), dtype=np.uint8).reshape(image.shape)
    # Of the two tables one is 0 at every byte, and both sums saturate: the result is clean + noise, clipped.
    brighter = cv2.add(image, cv2.LUT(drawn, up))
    return np.asarray(cv2.subtract(brighter, cv2.LUT(drawn, down)), dtype=np.uint8)


@cache
def _white_led() -> Bytes:
    """A table (256, 1, 3): counts of grey in blue, green and red."""
    return np.asarray(np.rint(np.arange(256)[:, None, None] * np.array(WHITE_LED_BGR)), dtype=np.uint8)


@cache
def _noise_tables() -> tuple[Bytes, Bytes]:
    """For each of 256 equally likely bytes what is added, and what is taken away: rounded Gaussian noise.

    Rounding adds 1/12 to the variance, so the Gaussian has that much less.
    """
    gaussian = NormalDist(0.0, math.sqrt(READ_NOISE**2 - 1.0 / 12.0))
    noise = np.rint([gaussian.inv_cdf((i + 0.5) / 256.0) for i in range(256)]).astype(int)
    return np.maximum(noise, 0).astype(np.uint8), np.maximum(-noise, 0).astype(np.uint8)
