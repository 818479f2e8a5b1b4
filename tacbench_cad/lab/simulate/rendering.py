"""The simulated sensor's camera: the scene around the pins, the pins as discs through a pinhole, and the noise."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache, lru_cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.simulate.appearances import Look, Profile, Spot, Tint
from tacbench_cad.spec.skin import CAMERA_BELOW_MM, FOCAL_PX
from tacbench_cad.util.types import Bytes, Floats

#: The smallest height of a visible pin's peak above its surroundings, in standard deviations of the noise.
VISIBLE_SIGMAS = 5.0
#: The width of the band around the dome's outline in which the outline may move, in px.
_BAND_PX = 16.0
#: The number of directions in which a pin's surroundings are sampled, and their distance in radii of the pin.
_DIRECTIONS, _SURROUNDINGS = 12, 1.5


@dataclass(frozen=True, kw_only=True)
class FrameCamera:
    """A pinhole camera on the dome's axis, looking at the summit.

    Args:
        width_px: The width of the image.
        height_px: The height of the image.
        focal_px: The focal length.
        below_mm: The distance of the pinhole from the dome's centre, on the side away from the summit.
        middle_px: The column and row of the axis.
    """

    width_px: int = 640
    height_px: int = 480
    focal_px: float = FOCAL_PX
    below_mm: float = CAMERA_BELOW_MM
    middle_px: tuple[float, float] = (319.5, 239.5)

    def pixels(self, points_mm: Floats) -> Floats:
        """Return column and row, shape (n, 2), of points of the dome frame, shape (n, 3)."""
        scale = self.focal_px / (self.below_mm + points_mm[:, 2])
        column, row = self.middle_px
        return np.stack([column + scale * points_mm[:, 0], row - scale * points_mm[:, 1]], axis=1)


class PressedScene:
    """The camera's image without pins.

    Args:
        look: The look.
        camera: The camera.

    Attributes:
        counts: Skin, reflections and surround at the mean light, float32, (height, width).
        reflections: The part of the counts that reflections on the skin add.
        regions: A mask for each of the look's tints, 1 or 0, uint8, (height, width).
        black_counts: The counts of the camera without any light.
    """

    def __init__(self, look: Look, camera: FrameCamera) -> None:
        rows, columns = np.indices((camera.height_px, camera.width_px), dtype=np.float32)
        dx, dy = columns - camera.middle_px[0], rows - camera.middle_px[1]
        distance, azimuth = np.hypot(dx, dy), np.arctan2(-dy, dx)
        half_x, half_y = look.dome_px
        outwards = distance - half_x * half_y / np.maximum(
            np.hypot(half_y * np.cos(azimuth), half_x * np.sin(azimuth)), 1e-9
        )
        radii = distance / max(look.dome_radius_px, 1.0)
        rng = np.random.Generator(np.random.SFC64(look.seed))
        inside, surround = (
            _surface(along(radii, profile), fraction, width, grain, rng)
            for profile, fraction, width, grain in zip(
                (look.skin, look.surround), look.unevenness, look.unevenness_px, look.grain, strict=True
            )
        )
        self.reflections = _spots(look.glints, look, dx, dy)
        inside += self.reflections
        surround += _spots(look.leds, look, dx, dy)
        beyond = np.where(outwards < 0.0, 0.0, np.maximum(radii, 1.0 + 1e-6))
        limits = [0.0, *(limit for limit, _ in look.tints)]
        self.regions = [
            np.asarray((low <= beyond) & (beyond < high), dtype=np.uint8) for low, high in itertools.pairwise(limits)
        ]
        self.counts = np.where(outwards < 0.0, inside, surround).astype(np.float32)
        self.black_counts = look.black_counts
        # The pixels where the outline may be; none without a dome.
        self._band = np.flatnonzero((np.abs(outwards) < _BAND_PX) & (half_x > 0.0))
        self._outwards, self._inside, self._surround, along_x, along_y = (
            np.asarray(values).ravel()[self._band]
            for values in (outwards, inside, surround, np.cos(azimuth), -np.sin(azimuth))
        )
        self._along_x, self._along_y = along_x, along_y
        self._edge_px = look.dome_edge_px

    def seen(self, light: float, sway_px: tuple[float, float, float]) -> Bytes:
        """Return the scene in one frame.

        Args:
            light: The light, relative to the mean.
            sway_px: The offset of the dome's outline: its centre along columns and rows, and its radius.
        """
        import cv2

        image = np.asarray(cv2.convertScaleAbs(self.counts, alpha=light, beta=self.black_counts), dtype=np.uint8)
        if self._band.size:
            shift = sway_px[0] * self._along_x + sway_px[1] * self._along_y + sway_px[2]
            covered = np.clip((shift - self._outwards) / self._edge_px + 0.5, 0.0, 1.0)
            band = light * (self._surround + covered * (self._inside - self._surround)) + self.black_counts
            image.ravel()[self._band] = np.clip(np.rint(band), 0.0, 255.0)
        return image


@lru_cache(maxsize=8)
def scene(look: Look, camera: FrameCamera) -> PressedScene:
    """Return the scene of a look. All sensors with this look share it."""
    return PressedScene(look, camera)


def along(places: NDArray[Any], profile: Profile) -> Floats:
    """Return a profile's values at positions."""
    knots = np.array(profile)
    return np.asarray(np.interp(places, knots[:, 0], knots[:, 1]), dtype=np.float64)


def _surface(counts: Floats, fraction: float, width_px: float, grain: float, rng: np.random.Generator) -> Floats:
    """Return a surface that varies by a fraction over a width, with grain from pixel to pixel."""
    from scipy.ndimage import gaussian_filter

    if fraction > 0.0:
        field = gaussian_filter(rng.standard_normal(counts.shape), width_px, mode="reflect")
        counts = counts * (1.0 + fraction * (field - np.mean(field)) / np.std(field))
    return counts + grain * rng.standard_normal(counts.shape) if grain > 0.0 else counts


def _spots(spots: tuple[Spot, ...], look: Look, dx: NDArray[Any], dy: NDArray[Any]) -> Floats:
    """Return the brightness of spots, by the distance of each pixel from the dome's centre along columns and rows."""
    from scipy.special import erfc

    counts = np.zeros(dx.shape)
    for spot in spots:
        radius, azimuth = spot.radius * look.dome_radius_px, math.radians(spot.azimuth_deg)
        distance = np.hypot(dx - radius * math.cos(azimuth), dy + radius * math.sin(azimuth))
        counts += spot.counts * 0.5 * erfc((distance - spot.diameter_px / 2.0) / spot.edge_px * math.sqrt(6.0))
    return counts


@dataclass(frozen=True, kw_only=True, eq=False)
class Discs:
    """The pins as flat discs in the image.

    Args:
        middles_px: The columns and rows of their centres, shape (n, 2).
        radius_px: Their radii, shape (n,).
        cosine: The short axis of the visible ellipse as a fraction of the long one, shape (n,).
        short_along: The unit vector of the short axis, shape (n, 2).
        counts: Their brightness above that of the skin, shape (n,).
        edge_px: The widths of their edges, shape (n,).
    """

    middles_px: Floats
    radius_px: Floats
    cosine: Floats
    short_along: Floats
    counts: Floats
    edge_px: Floats


def discs(
    camera: FrameCamera, middles_mm: Floats, facing: Floats, radius_mm: float, counts: Floats, edge_px: Floats
) -> Discs:
    """Project flat discs into the image.

    Args:
        camera: The camera.
        middles_mm: The centres of the discs in the dome frame, shape (n, 3).
        facing: Their unit normals, shape (n, 3).
        radius_mm: Their radius.
        counts: The brightness of each above that of the skin, shape (n,).
        edge_px: The widths of their edges, shape (n,).
    """
    to_camera = -middles_mm - np.array([0.0, 0.0, camera.below_mm])
    distance = np.linalg.norm(to_camera, axis=1)
    azimuth = np.arctan2(-facing[:, 1], facing[:, 0])
    return Discs(
        middles_px=camera.pixels(middles_mm),
        radius_px=radius_mm * camera.focal_px / (camera.below_mm + middles_mm[:, 2]),
        # The ellipse is short along the image of the disc's normal, by the cosine of the viewing angle.
        cosine=np.clip(np.einsum("nd,nd->n", to_camera, facing) / distance, 0.05, 1.0),
        short_along=np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1),
        counts=counts,
        edge_px=edge_px,
    )


def drawn(place: PressedScene, pins: Discs, light: float, sway_px: tuple[float, float, float]) -> Bytes:
    """Draw a grey image of a scene with discs, without noise. Discs that extend beyond the image are not drawn.

    Args:
        place: The scene.
        pins: The discs. If two overlap, the brighter one covers the other.
        light: The scene's light, relative to the mean.
        sway_px: The offset of the dome's outline, see :meth:`PressedScene.seen`.
    """
    image = place.seen(light, sway_px)
    middles, radius_px = pins.middles_px, pins.radius_px
    reach = math.ceil(float(np.max(radius_px + pins.edge_px / 2.0)))
    corner = np.floor(middles).astype(int) - reach
    at = np.arange(2 * reach + 2)
    kept = np.all((corner >= 0) & (corner <= np.array(image.shape[::-1]) - at.size), axis=1)
    corner, middles, radius_px = corner[kept], middles[kept], radius_px[kept]
    along_x, along_y, cosine, counts, edge_px = (
        values[kept, None, None] for values in (*pins.short_along.T, pins.cosine, pins.counts, pins.edge_px)
    )
    dx = (corner[:, :1] + at[None, :] - middles[:, :1])[:, None, :]
    dy = (corner[:, 1:] + at[None, :] - middles[:, 1:])[:, :, None]
    short = (dx * along_x + dy * along_y) / cosine
    long = dy * along_x - dx * along_y
    levels = np.clip((radius_px[:, None, None] - np.sqrt(short**2 + long**2)) / edge_px + 0.5, 0.0, 1.0)
    levels *= counts
    windows = np.lib.stride_tricks.sliding_window_view(place.counts, (at.size, at.size))[corner[:, 1], corner[:, 0]]
    levels += windows * light + place.black_counts
    levels += 0.5
    stamps = np.clip(levels, 0.0, 255.0, out=levels).astype(np.uint8)
    for stamp, (column, row) in zip(stamps, corner.tolist(), strict=True):
        window = image[row : row + at.size, column : column + at.size]
        np.maximum(window, stamp, out=window)
    return image


def visible(pins: Discs, place: PressedScene, look: Look) -> NDArray[np.bool_]:
    """Return which discs are visible: the peak exceeds the noise, and no reflection covers the centre; shape (n,)."""
    height, width = place.counts.shape
    turn = 2.0 * math.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    around = _SURROUNDINGS * pins.radius_px[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)[None]

    def at(points: Floats, values: NDArray[Any]) -> Floats:
        columns = np.clip(np.rint(points[..., 0]).astype(int), 0, width - 1)
        rows = np.clip(np.rint(points[..., 1]).astype(int), 0, height - 1)
        return np.asarray(values[rows, columns], dtype=np.float64)

    middles = pins.middles_px
    surroundings = np.minimum(at(middles[:, None, :] + around, place.counts), look.white_counts).mean(axis=1)
    peak = np.minimum(at(middles, place.counts) + pins.counts, look.white_counts)
    noise = np.hypot(along(surroundings, look.noise), look.grain[0])
    stands_out = peak - surroundings >= VISIBLE_SIGMAS * noise
    bare = at(middles, place.reflections) < pins.counts / 2.0
    in_frame = np.all((middles >= 0.0) & (middles <= np.array([width - 1.0, height - 1.0])), axis=1)
    return np.asarray(stands_out & bare & in_frame)


def tinted(grey: Bytes, place: PressedScene, look: Look) -> Bytes:
    """Convert a grey image to a colour image, (height, width, 3), BGR."""
    import cv2

    wide = cv2.merge([grey, grey, grey])
    image = np.empty_like(wide)
    for (_, tint), region in zip(look.tints, place.regions, strict=True):
        cv2.copyTo(cv2.LUT(wide, _table(tint)), region, image)
    return np.asarray(image, dtype=np.uint8)


def with_noise(clean: Bytes, look: Look, rng: np.random.Generator) -> Bytes:
    """Add the camera's noise to a grey or BGR image, limited to the range from 0 to the camera's highest level.

    Args:
        clean: The image.
        look: The look with the noise.
        rng: The random generator: one byte for each value, or for each pixel.
    """
    import cv2

    pixels = clean.size if look.noise_in_each_channel else clean.shape[0] * clean.shape[1]
    drawn = np.frombuffer(rng.bytes(pixels), dtype=np.uint8)
    if pixels < clean.size:
        drawn = cv2.merge([drawn, drawn, drawn])
    places = cv2.merge([drawn.reshape(1, -1), clean.reshape(1, -1)]).view("<u2")
    return np.asarray(_noisy(look.noise, look.white_counts).take(places), dtype=np.uint8).reshape(clean.shape)


def sharpened(image: Bytes, amount: float) -> Bytes:
    """Add a fraction of an image's difference from its binomial average over 3 x 3 pixels."""
    import cv2

    kernel = -amount * np.outer((0.25, 0.5, 0.25), (0.25, 0.5, 0.25))
    kernel[1, 1] += 1.0 + amount
    return np.asarray(cv2.filter2D(image, -1, kernel), dtype=np.uint8)


def compressed(image: Bytes, quality: int) -> Bytes:
    """Compress an image in blocks of 8 x 8 pixels, and decompress it."""
    import cv2

    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), dtype=np.uint8)


@cache
def _table(tint: Tint) -> Bytes:
    """Return a table (256, 1, 3) of the counts of each grey level in blue, green and red."""
    greys = [0.0, *(grey for grey, _ in tint)]
    channels = zip((0.0, 0.0, 0.0), *(bgr for _, bgr in tint), strict=True)
    table = np.array([np.interp(np.arange(256), greys, values) for values in channels])
    return np.asarray(np.rint(table.T[:, None, :]), dtype=np.uint8)


@cache
def _noisy(noise: Profile, white: int) -> Bytes:
    """Return a table (65536,) with the noisy level for 256 level + byte, where all 256 bytes are equally likely."""
    levels, normal = np.arange(256.0), NormalDist()
    spreads = along(levels, noise)
    # Rounding adds 1/12 to the variance of a wide Gaussian. A narrow one keeps only the part beyond half a count.
    narrow = np.array([0.5 / -normal.inv_cdf(max(min(spread, 0.5) ** 2 / 2.0, 1e-9)) for spread in spreads])
    sigmas = np.where(spreads > 0.5, np.sqrt(np.maximum(spreads**2 - 1.0 / 12.0, 0.0)), narrow)
    draws = np.array([normal.inv_cdf((i + 0.5) / 256.0) for i in range(256)])
    noisy: Floats = np.clip(levels[:, None] + np.rint(sigmas[:, None] * draws), 0.0, white)
    return np.asarray(noisy, dtype=np.uint8).ravel()
