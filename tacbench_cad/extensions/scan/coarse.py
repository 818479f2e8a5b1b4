"""The search for a block in a scan without a start: planes and normals first, then a correlation of heights.

The search works on a few thousand points. It finds directions that may be the vertical of the block, draws the heights
above the plane at right angles to each of them on a grid, and compares this height map with the formula at every angle
and every shift with Fourier transforms. A plane is free in each comparison, so that a small error of the vertical does
not matter. The result is a list of poses, because many textures look the same after a shift by a wavelength, after half
a turn or upside down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tacbench_cad.extensions.scan.height_model import Relief
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.spec import Block
from tacbench_cad.util.types import Bools, Floats

#: The number of points of the search.
SEARCH_POINTS = 20_000
#: The number of pixels of the height map along the longer side of the block.
_PIXELS = 52
#: The step of the angles, in degrees.
_ANGLE_STEP = 4.0
#: The number of poses that each vertical gives at most.
_POSES = 24
#: A pose is kept if its score is at least this fraction of the best.
_SCORE_KEPT = 0.4
_NEIGHBOURS = 12


@dataclass(frozen=True, eq=False)
class Seen:
    """The points of a search with their normals.

    Args:
        points: The points, shape (n, 3).
        normals: The unit normals of the surface through their neighbours, with any sign, shape (n, 3).
        flatness: The thickness of each neighbourhood divided by its width, shape (n,).
    """

    points: Floats
    normals: Floats
    flatness: Floats


def look(points: Floats) -> Seen:
    """Compute the normals of points from their nearest neighbours."""
    from scipy.spatial import cKDTree

    _, near = cKDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    around = points[near]
    around = around - around.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    flatness = np.sqrt(np.maximum(values[:, 0], 0.0) / np.maximum(values[:, 1], 1e-12))
    return Seen(points, np.ascontiguousarray(vectors[:, :, 0]), flatness)


def verticals(seen: Seen, block: Block) -> Iterator[Floats]:
    """Return unit vectors that may be the vertical of the block, the likely ones first; the sign is not known."""
    given: list[Floats] = []
    planes = _planes(seen, 0.01 * max(block.size_mm))
    for first in [_thinnest(seen.points), *planes, *_crossed(planes)]:
        for vector in (_settled(seen, first), first):
            if all(abs(float(vector @ other)) < math.cos(math.radians(3.0)) for other in given):
                given.append(vector)
                yield vector


def _thinnest(points: Floats) -> Floats:
    centred = points - np.median(points, axis=0)
    reach = np.quantile(np.linalg.norm(centred, axis=1), 0.95)
    centred = centred[np.linalg.norm(centred, axis=1) <= reach]
    return np.asarray(np.linalg.eigh(np.cov(centred.T))[1][:, 0])


def _settled(seen: Seen, vertical: Floats) -> Floats:
    """Return the direction in which the points whose normals are close to a direction are thinnest."""
    for _ in range(5):
        flat = np.abs(seen.normals @ vertical) > 0.5
        if np.count_nonzero(flat) < 50:
            return vertical
        after = _thinnest(seen.points[flat])
        if abs(float(after @ vertical)) > 0.99999:
            return after
        vertical = after
    return vertical


def _planes(seen: Seen, tolerance: float) -> list[Floats]:
    """Return the normals of the four largest planes at most, by random trials."""
    rng = np.random.default_rng(0)
    left = np.flatnonzero(seen.flatness < 0.3)
    result: list[Floats] = []
    for _ in range(4):
        if len(left) < 0.03 * len(seen.points):
            break
        some = left[rng.integers(0, len(left), min(2000, len(left)))]
        tried = rng.choice(left, min(150, len(left)), replace=False)
        offset = np.einsum("tsi,ti->ts", seen.points[some][None] - seen.points[tried][:, None], seen.normals[tried])
        agree = np.abs(seen.normals[tried] @ seen.normals[some].T) > 0.97
        best = tried[np.argmax(np.count_nonzero((np.abs(offset) < tolerance) & agree, axis=1))]
        normal = seen.normals[best]
        inside = (np.abs((seen.points[left] - seen.points[best]) @ normal) < tolerance) & (
            np.abs(seen.normals[left] @ normal) > 0.95
        )
        if np.count_nonzero(inside) < 0.03 * len(seen.points):
            break
        result.append(_thinnest(seen.points[left[inside]]))
        left = left[~inside]
    return result


def _crossed(planes: list[Floats]) -> Iterator[Floats]:
    for i, first in enumerate(planes):
        for second in planes[i + 1 :]:
            cross = np.cross(first, second)
            if np.linalg.norm(cross) > 0.5:
                yield cross / np.linalg.norm(cross)


@dataclass(frozen=True, eq=False)
class CoarseMap:
    """Heights above a plane on a grid of square pixels.

    Args:
        frame: The rows are the axes of the map and the vertical, shape (3, 3).
        corner: The place of the first pixel along the three axes; its height is 0 on the map.
        step: The side of a pixel, in mm.
        heights: The heights above the plane that fits best, 0 where nothing was seen, shape (pixels, pixels).
        mask: The pixels that were seen.
    """

    frame: Floats
    corner: Floats
    step: float
    heights: Floats
    mask: Bools


def height_map(seen: Seen, vertical: Floats, block: Block, size: int) -> CoarseMap | None:
    """Draw the heights of the points of the top; None if too few points belong to it."""
    helper = np.eye(3)[int(np.argmin(np.abs(vertical)))]
    first = np.cross(helper, vertical)
    first /= np.linalg.norm(first)
    frame = np.stack([first, np.cross(vertical, first), vertical])
    flat = np.abs(seen.normals @ vertical) > 0.35
    if np.count_nonzero(flat) < 50:
        return None
    points = seen.points[flat] @ frame.T
    relief = block.relief_mm
    high = np.quantile(points[:, 2], 0.97)
    # The table lies at the depth of the base below the valleys.
    points = points[(points[:, 2] > high - relief - 0.45 * block.base_mm) & (points[:, 2] < high + 0.5 * relief)]
    if len(points) < 50:
        return None
    step = max(block.size_mm) / _PIXELS
    middle = (np.quantile(points[:, :2], 0.01, axis=0) + np.quantile(points[:, :2], 0.99, axis=0)) / 2.0
    corner = np.append(middle - 0.5 * size * step, 0.0)
    place = np.floor((points[:, :2] - corner[:2]) / step).astype(int)
    inside = np.all((place >= 0) & (place < size), axis=1)
    cell, z = place[inside, 0] * size + place[inside, 1], points[inside, 2]
    order = np.lexsort((z, cell))
    cell, z = cell[order], z[order]
    start = np.flatnonzero(np.diff(cell, prepend=-1))
    count = np.diff(np.append(start, len(cell)))
    enough = count >= max(1, int(0.5 * np.median(count)))
    middle_z = z[start + count // 2]
    heights, mask = np.zeros(size * size), np.zeros(size * size, dtype=bool)
    mask[cell[start[enough]]] = True
    heights[cell[start[enough]]] = middle_z[enough]
    corner[2] = float(np.mean(heights[mask]))
    square = (size, size)
    return CoarseMap(
        frame, corner, step, np.where(mask, heights - corner[2], 0.0).reshape(square), mask.reshape(square)
    )


#: A score, and the indices of the angle and of the shift along both axes.
_Peak = tuple[float, int, int, int]


class Search:
    """The formula of a block at every angle, as Fourier transforms, which many scans can share."""

    def __init__(self, block: Block) -> None:
        from scipy import fft

        self.block = block
        self.step = max(block.size_mm) / _PIXELS
        reach = math.hypot(*block.size_mm)
        self.size = 2 * math.ceil(0.62 * reach / self.step)
        self.full = fft.next_fast_len(2 * self.size, real=True)
        self.angles = np.radians(np.arange(0.0, 360.0, _ANGLE_STEP))
        half = (np.arange(self.size) + 0.5 - self.size / 2.0) * self.step
        px, py = np.meshgrid(half, half, indexing="ij")
        relief = Relief.of(block)
        centre = np.array(block.size_mm) / 2.0
        spectra = []
        for angle in self.angles:
            c, s = math.cos(angle), math.sin(angle)
            x, y = c * px - s * py + centre[0], s * px + c * py + centre[1]
            beyond = (np.abs(x - centre[0]) > centre[0]) | (np.abs(y - centre[1]) > centre[1])
            if block.region is not None:
                beyond |= block.region.distance(x, y) > 0.0
            z = np.zeros(x.shape)
            z[~beyond] = relief(x[~beyond], y[~beyond])[0] - block.datum_mm
            stack = np.stack([z, z * z, (~beyond).astype(np.float64)])
            spectra.append(fft.rfft2(stack, (self.full, self.full)).astype(np.complex64))
        self.spectra = np.stack(spectra)

    def poses(self, seen: Seen, vertical: Floats) -> list[tuple[float, Pose]]:
        """Return poses with this vertical and their scores, the best first; a score of 0 explains nothing, 1 all."""
        from scipy import fft, ndimage

        found = height_map(seen, vertical, self.block, self.size)
        if found is None:
            return []
        scan, mask = found.heights, found.mask
        count = np.count_nonzero(mask)
        along = (np.arange(self.size) + 0.5 - self.size / 2.0) / self.size
        basis = np.stack([np.ones(count), *(grid[mask] for grid in np.meshgrid(along, along, indexing="ij"))], axis=1)
        q, _ = np.linalg.qr(basis)
        level = scan[mask] - q @ (q.T @ scan[mask])
        layers = np.zeros((5, self.size, self.size))
        layers[0][mask], layers[1][mask] = level, 1.0
        for k in range(3):
            layers[2 + k][mask] = q[:, k]
        spectra = np.conj(fft.rfft2(layers, (self.full, self.full))).astype(np.complex64)
        total = float(level @ level)
        spread = Relief.of(self.block).rms_mm ** 2
        best: list[_Peak] = []
        highest = 0.0
        for index in range(len(self.angles)):
            template, square, inside = self.spectra[index]
            products = np.stack(
                [template * spectra[0], square * spectra[1], inside * spectra[1], *(template * spectra[2:])]
            )
            maps = fft.irfft2(products, (self.full, self.full))
            overlap = np.clip(maps[2], 0.0, count)
            left = total - 2.0 * maps[0] + maps[1] - np.sum(maps[3:] ** 2, axis=0)
            # A pixel of the scan beside the block counts as one that the formula does not explain.
            left = left + 2.0 * spread * (count - overlap)
            score = np.where(overlap > 0.6 * count, 1.0 - left / (count * spread), -9.0)
            least = max(0.0, _SCORE_KEPT * highest)
            if score.max() <= least:
                continue
            highest = max(highest, float(score.max()))
            peak = (score == ndimage.maximum_filter(score, 5, mode="wrap")) & (score > least)
            best += [(float(score[i, j]), index, int(i), int(j)) for i, j in np.argwhere(peak)]
        best.sort(reverse=True)
        chosen: list[_Peak] = []
        for entry in best:
            if len(chosen) == _POSES or entry[0] < _SCORE_KEPT * best[0][0]:
                break
            if not any(self._same(entry, other) for other in chosen):
                chosen.append(entry)
        return [(entry[0], self._pose(found, entry)) for entry in chosen]

    def _shift(self, place: int) -> int:
        return place - self.full if place > self.full // 2 else place

    def _same(self, first: _Peak, second: _Peak) -> bool:
        turn = abs((first[1] - second[1] + len(self.angles) // 2) % len(self.angles) - len(self.angles) // 2)
        far = max(abs(self._shift(a) - self._shift(b)) for a, b in zip(first[2:], second[2:], strict=True))
        return turn <= 2 and far <= 3

    def _pose(self, found: CoarseMap, entry: _Peak) -> Pose:
        _, index, i, j = entry
        c, s = math.cos(self.angles[index]), math.sin(self.angles[index])
        turn = np.array([[c, -s], [s, c]])
        half = (np.arange(self.size) + 0.5 - self.size / 2.0) * self.step
        shift = np.array([self._shift(i), self._shift(j)]) * self.step
        plan = np.stack(np.meshgrid(half, half, indexing="ij"), axis=-1)[found.mask]
        centre = np.array(self.block.size_mm) / 2.0
        x, y = ((plan + shift) @ turn.T + centre).T
        below = found.heights[found.mask] - Relief.of(self.block)(x, y)[0]
        design = np.column_stack([plan, np.ones(len(plan))])
        keep = np.ones(len(plan), dtype=bool)
        for _ in range(4):
            tilt = np.linalg.lstsq(design[keep], below[keep], rcond=None)[0]
            rest = np.abs(below - design @ tilt)
            keep = rest <= max(2.5 * float(np.median(rest)), 1e-6)
        # z of the block = height - tilt . plan - constant, to first order a rotation about the middle of the map
        normal = np.array([-tilt[0], -tilt[1], 1.0]) / math.sqrt(1.0 + tilt[0] ** 2 + tilt[1] ** 2)
        first = np.cross([0.0, 1.0, 0.0], normal)
        first /= np.linalg.norm(first)
        level = np.stack([first, np.cross(normal, first), normal])
        middle = found.corner + np.array([0.5 * self.size * self.step, 0.5 * self.size * self.step, tilt[2]])
        planar = np.eye(3)
        planar[:2, :2] = turn
        rotation = planar @ level @ found.frame
        place = np.append(turn @ shift + centre, 0.0)
        return Pose(rotation=rotation, shift_mm=place - planar @ level @ middle, stretch=np.eye(3))
