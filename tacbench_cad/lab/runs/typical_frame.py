"""The typical frame of a run, with which each frame is compared: its kind, colours, orientation and place.

The typical frame is the median of some frames. Contact changes a frame in places, but neither the colours of the lamps
nor the sides from which they shine, nor the parts of the picture that do not touch the object. Therefore each frame is
compared with the typical frame in these respects only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.frame_files import grey, noise_counts
from tacbench_cad.util.types import Bools, Floats, Floats32

#: The fraction of the pixels of a binary image that are 0 or 255. Few others come from scaling and compression.
_BINARY = 0.999
#: The largest side of the reduced frames for the shift, and of those for colours and orientation, in pixels.
_SHIFT_SIDE_PX, _SMALL_SIDE_PX = 160, 80
#: The smoothings of a reduced frame with which its shift is measured, in pixels, each with the largest fraction of the
#: residual that a shift may leave if it counts. The second one is for small frames, in which a shift can be as large as
#: the distance of two markers. The contact with a soft gel leaves 0.62 or more of it, a moved camera mostly less.
_SMOOTHINGS = ((1.5, 0.6), (4.0, 0.4))
#: The smallest side of a reduced frame for such a smoothing, relative to the smoothing.
_MIN_SIDE = 16.0
#: The number of steps of the fit, and of its repeats with less weight for outliers; and the largest shift of a reduced
#: frame, in pixels.
_STEPS, _ROBUST_STEPS, _MAX_SHIFT_PX = 4, 2, 10.0
#: The smallest standard deviation of a pixel over the frames, in counts; and the residual, in standard deviations, from
#: which a pixel counts less, because the contact changed it.
_PIXEL_NOISE, _OUTLIER = 1.0, 2.0
#: The margin of the reduced frame that is not compared, because other pixels move into it, in pixels.
_MARGIN = 4
#: The scales of the band of details by which the sharpness is measured, in pixels; the side of the cells in which their
#: energy is averaged; the energy of white noise of one count in the band; the smallest energy of a cell with details,
#: as a multiple of that of the noise; and the smallest number of such cells.
_DETAILS_PX, _CELL_PX, _NOISE_ENERGY, _MIN_ENERGY, _MIN_CELLS = (1.0, 2.0), 16, 0.036, 10.0, 12
#: The fraction of the cells with details that must lose them in a blurred frame. The surroundings, which may be sharp,
#: have many of these cells.
_BLURRED_PART = 0.3
#: The ways to change a frame by mistake, as functions of an array (height, width) or (height, width, 3).
CHANGES: Mapping[str, Callable[[Floats32], Floats32]] = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored upside down": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "in other colours than the others: blue and red are swapped": lambda image: image[..., ::-1],
}


@dataclass(frozen=True, kw_only=True)
class Likeness:
    """The comparison of a frame with the typical frame of its run.

    Args:
        binary: Whether the frame has only the values 0 and 255.
        noise: The noise between neighbouring pixels, in counts.
        correlation: The correlation with the typical frame.
        gains: By how much the frame's correlation with the typical frame increases if a change is undone, by the name
            of the change; negative for a typical frame.
        shift_px: The shift of the parts that do not touch the object, as column and row.
        sharpness: The energy of the fine details relative to that of the typical frame, in most of the places that have
            details; None if too few places have them.
    """

    binary: bool
    noise: float
    correlation: float
    gains: Mapping[str, float]
    shift_px: tuple[float, float]
    sharpness: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class TypicalFrame:
    """The typical frame of a run.

    Args:
        frames: Some frames of the run, of the same shape.
    """

    frames: Sequence[Frame]

    @cached_property
    def binary(self) -> bool:
        """Whether most frames are binary images, which are not all black or all white."""
        binary = float(np.mean([is_binary(frame) for frame in self.frames]))
        return binary > 0.5 and 0.0 < float(np.mean(self.frames)) < 255.0

    @cached_property
    def _places(self) -> tuple[_Place, ...]:
        """The reduced typical frame with each smoothing, without those with too few independent pixels for a fit."""
        small = _reduced(grey(self.frames[0]), _SHIFT_SIDE_PX, 1.0)
        return tuple(
            _Place.of(self.frames, smoothing, better)
            for smoothing, better in _SMOOTHINGS
            if min(small.shape) >= _MIN_SIDE * smoothing
        )

    @cached_property
    def _small(self) -> Floats32:
        return np.asarray(np.median([_small(frame) for frame in self.frames], axis=0))

    def compare(self, frame: Frame) -> Likeness:
        """Compare a frame of the same shape with the typical frame."""
        image, small = grey(frame), _small(frame)
        straight = _correlation(small, self._small)
        gains = {
            name: _correlation(undone(small), self._small) - straight
            for name, undone in CHANGES.items()
            if small.ndim == 3 or "colours" not in name
        }
        return Likeness(
            binary=is_binary(frame),
            noise=noise_counts(image),
            correlation=straight,
            gains=gains,
            shift_px=self._shift(image),
            sharpness=self._sharpness(image),
        )

    @cached_property
    def _details(self) -> tuple[Floats, Bools, float]:
        """The usual energy of the details in each cell, the cells that have details, and the usual mean brightness."""
        images = [grey(frame) for frame in self.frames]
        noise = max(1.0, float(np.median([noise_counts(image) for image in images])))
        usual = np.median([_details(image) for image in images], axis=0)
        mean = float(np.median([image.mean() for image in images]))
        return usual, usual >= _MIN_ENERGY * _NOISE_ENERGY * noise**2, mean

    def _sharpness(self, image: Floats32) -> float | None:
        """Return the sharpness of a frame relative to the typical frame."""
        usual, has_details, mean = self._details
        if has_details.sum() < _MIN_CELLS or not image.any():
            return None
        ratio = _details(image)[has_details] / usual[has_details]
        return float(np.quantile(ratio, _BLURRED_PART)) * (mean / float(image.mean())) ** 2

    def _shift(self, image: Floats32) -> tuple[float, float]:
        """Return the shift of a frame in pixels."""
        shifts = (place.shift_px(image) for place in self._places)
        return next((shift for shift in shifts if shift is not None), (0.0, 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Place:
    """The reduced typical frame, with which the place of a frame is compared.

    Args:
        usual: The reduced and smoothed typical frame.
        design: The design of the fit of a shift, a gain and an offset, shape (pixels, 4).
        weight: The weight of each pixel, shape (pixels,).
        scale: The reduction.
        smoothing_px: The smoothing of reduced frames.
        better: The largest fraction of the residual that a shift may leave if it counts.
    """

    usual: Floats32
    design: Floats32
    weight: Floats32
    scale: float
    smoothing_px: float
    better: float

    @classmethod
    def of(cls, frames: Sequence[Frame], smoothing_px: float, better: float) -> _Place:
        stack = np.stack([_reduced(grey(frame), _SHIFT_SIDE_PX, smoothing_px) for frame in frames])
        usual = np.median(stack, axis=0)
        deviation = 1.4826 * np.median(np.abs(stack - usual), axis=0)
        columns = (-np.gradient(usual, axis=1), -np.gradient(usual, axis=0), usual, np.ones_like(usual))
        return cls(
            usual=usual,
            design=np.stack([_inner(each) for each in columns], axis=1).astype(np.float32),
            weight=(1.0 / np.maximum(_inner(deviation), _PIXEL_NOISE)).astype(np.float32),
            scale=max(frames[0].shape[:2]) / max(usual.shape),
            smoothing_px=smoothing_px,
            better=better,
        )

    def shift_px(self, image: Floats32) -> tuple[float, float] | None:
        """Return the shift of a frame by a robust fit of a shift, a gain and an offset (Lucas-Kanade).

        The result is None if the frame is not clearly more like the typical frame after the shift.
        """
        import cv2

        reduced = _reduced(image, _SHIFT_SIDE_PX, self.smoothing_px)
        moved: Floats = np.zeros(2)
        residual = unmoved = self._fit(self.design[:, 2:], _inner(reduced - self.usual))[1]
        for _ in range(_STEPS):
            back = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            size = self.usual.shape[::-1]
            aligned = cv2.warpAffine(reduced, back, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
            values, residual = self._fit(self.design, _inner(aligned - self.usual))
            moved = moved + values[:2]
        if not np.hypot(*moved) < _MAX_SHIFT_PX or residual > self.better * unmoved:
            return None
        return float(moved[0] * self.scale), float(moved[1] * self.scale)

    def _fit(self, design: Floats32, target: Floats32) -> tuple[Floats, float]:
        """Fit a linear model with less weight for outliers; return the values and the usual residual.

        The usual residual is a median in which pixels count by how much a shift changes them. A black background, which
        may be most of a frame, says nothing about a shift.
        """
        weight = self.weight
        values: Floats = np.zeros(design.shape[1])
        residual: Floats = np.zeros(len(target))
        factor: Floats = np.ones(len(target))
        for _ in range(_ROBUST_STEPS):
            weighted = design * (factor * weight**2)[:, None]
            values = np.linalg.lstsq(weighted.T @ design, weighted.T @ target, rcond=None)[0].astype(float)
            residual = np.abs(target - design @ values) * weight
            limit = _OUTLIER * max(1.0, 1.4826 * float(np.median(residual)))
            factor = 1.0 / (1.0 + (residual / limit) ** 2) ** 2
        order = np.argsort(residual)
        change = np.cumsum((np.hypot(self.design[:, 0], self.design[:, 1]) * weight)[order])
        return values, float(residual[order][np.searchsorted(change, change[-1] / 2.0)])


def _inner(image: Floats32) -> Floats32:
    """Return the pixels of a reduced frame without its margin."""
    return image[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN].ravel()


def is_binary(frame: Frame) -> bool:
    """Return whether a frame has only the values 0 and 255."""
    return float(np.mean((frame == 0) | (frame == 255))) >= _BINARY


def _reduced(image: Floats32, side_px: int, smoothing_px: float) -> Floats32:
    import cv2

    scale = min(1.0, side_px / max(image.shape[:2]))
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1.0 else image
    return np.asarray(cv2.GaussianBlur(small, (0, 0), smoothing_px))


def _details(image: Floats32) -> Floats32:
    """Return the energy of the fine details in each cell of an image."""
    import cv2

    fine, coarse = (cv2.GaussianBlur(image, (0, 0), scale) for scale in _DETAILS_PX)
    size = (max(1, image.shape[1] // _CELL_PX), max(1, image.shape[0] // _CELL_PX))
    return np.asarray(cv2.resize((fine - coarse) ** 2, size, interpolation=cv2.INTER_AREA))


def _small(frame: Frame) -> Floats32:
    return _reduced(frame.astype(np.float32), _SMALL_SIDE_PX, 1.0)


def _correlation(first: Floats32, second: Floats32) -> float:
    a, b = first - first.mean(), second - second.mean()
    scale = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    return float(np.sum(a * b)) / scale if scale else 0.0
