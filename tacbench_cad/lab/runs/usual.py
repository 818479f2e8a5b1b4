"""The usual frame of a run, with which each frame is compared: its kind, its colours, its orientation and its place.

The usual frame is the median of some frames. Contact changes a frame in places, but neither the colours of the lamps
nor the sides from which they shine, nor the parts of the picture that do not touch the object. Therefore each frame is
compared with the usual frame in these respects only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.vision.markers import grey, noise_counts
from tacbench_cad.util.types import Floats, Floats32

#: The fraction of the pixels of a binary image that are 0 or 255. Few others come from scaling and compression.
_BINARY = 0.999
#: The largest side of the reduced frames for the shift, and of those for colours and orientation, in pixels.
_SHIFT_SIDE_PX, _SMALL_SIDE_PX = 160, 80
#: The smoothing of a reduced frame before its shift is measured, in pixels; the number of steps of the fit, and of its
#: repeats with less weight for outliers; and the largest shift of a reduced frame, in pixels.
_SMOOTHING_PX, _STEPS, _ROBUST_STEPS, _MAX_SHIFT_PX = 1.5, 4, 2, 10.0
#: The smallest standard deviation of a pixel over the frames, in counts; and the residual, in standard deviations, from
#: which a pixel counts less, because the contact changed it.
_PIXEL_NOISE, _OUTLIER = 1.0, 2.0
#: The margin of the reduced frame that is not compared, because other pixels move into it, in pixels.
_MARGIN = 4
#: A shift counts if it reduces the median residual of the fit to at most this fraction.
_BETTER_FIT = 0.8
#: The ways to change a frame by mistake, as functions of an array (height, width) or (height, width, 3).
CHANGES: Mapping[str, Callable[[Floats32], Floats32]] = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored upside down": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "in other colours than the others: blue and red are swapped": lambda image: image[..., ::-1],
}


@dataclass(frozen=True, kw_only=True)
class Likeness:
    """The comparison of a frame with the usual frame of its run.

    Args:
        binary: Whether the frame has only the values 0 and 255.
        noise: The noise between neighbouring pixels, in counts.
        gains: By how much the frame's correlation with the usual frame increases if a change is undone, by the name of
            the change; negative for a usual frame.
        shift_px: The shift of the parts that do not touch the object, as column and row.
    """

    binary: bool
    noise: float
    gains: Mapping[str, float]
    shift_px: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Usual:
    """The usual frame of a run.

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
    def _place(self) -> tuple[Floats32, Floats32, Floats32, float]:
        """The reduced usual frame; the design and the weights of the fit of a shift; and the reduction."""
        stack = np.stack([_reduced(grey(frame), _SHIFT_SIDE_PX, _SMOOTHING_PX) for frame in self.frames])
        usual = np.median(stack, axis=0)
        deviation = 1.4826 * np.median(np.abs(stack - usual), axis=0)
        columns = (-np.gradient(usual, axis=1), -np.gradient(usual, axis=0), usual, np.ones_like(usual))
        inner = [each[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN].ravel() for each in (*columns, deviation)]
        design = np.stack(inner[:4], axis=1).astype(np.float32)
        weight = (1.0 / np.maximum(inner[4], _PIXEL_NOISE)).astype(np.float32)
        return usual, design, weight, max(self.frames[0].shape[:2]) / max(usual.shape)

    @cached_property
    def _small(self) -> Floats32:
        return np.asarray(np.median([_small(frame) for frame in self.frames], axis=0))

    def compare(self, frame: Frame) -> Likeness:
        """Compare a frame of the same shape with the usual frame."""
        image, small = grey(frame), _small(frame)
        straight = _correlation(small, self._small)
        gains = {
            name: _correlation(undone(small), self._small) - straight
            for name, undone in CHANGES.items()
            if small.ndim == 3 or "colours" not in name
        }
        return Likeness(binary=is_binary(frame), noise=noise_counts(image), gains=gains, shift_px=self._shift(image))

    def _shift(self, image: Floats32) -> tuple[float, float]:
        """Return the shift of a frame in pixels, by a robust fit of a shift, a gain and an offset (Lucas-Kanade)."""
        import cv2

        if min(image.shape) < 4 * _MARGIN:
            return 0.0, 0.0
        usual, design, weight, scale = self._place
        inner = (slice(_MARGIN, -_MARGIN), slice(_MARGIN, -_MARGIN))
        reduced = _reduced(image, _SHIFT_SIDE_PX, _SMOOTHING_PX)
        moved: Floats = np.zeros(2)
        unmoved = self._fit(design[:, 2:], (reduced - usual)[inner].ravel(), weight)[1]
        for _ in range(_STEPS):
            back = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            aligned = cv2.warpAffine(reduced, back, usual.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
            values, residual = self._fit(design, (aligned - usual)[inner].ravel(), weight)
            moved = moved + values[:2]
        if not np.hypot(*moved) < _MAX_SHIFT_PX or residual > _BETTER_FIT * unmoved:
            return 0.0, 0.0
        return float(moved[0] * scale), float(moved[1] * scale)

    @staticmethod
    def _fit(design: Floats32, target: Floats32, weight: Floats32) -> tuple[Floats, float]:
        """Fit a linear model with less weight for outliers; return the values and the median residual."""
        values: Floats = np.zeros(design.shape[1])
        residual: Floats = np.zeros(len(target))
        factor: Floats = np.ones(len(target))
        for _ in range(_ROBUST_STEPS):
            weighted = design * (factor * weight**2)[:, None]
            values = np.linalg.lstsq(weighted.T @ design, weighted.T @ target, rcond=None)[0].astype(float)
            residual = (target - design @ values) * weight
            limit = _OUTLIER * max(1.0, 1.4826 * float(np.median(np.abs(residual))))
            factor = 1.0 / (1.0 + (residual / limit) ** 2) ** 2
        return values, float(np.median(np.abs(residual)))


def is_binary(frame: Frame) -> bool:
    """Return whether a frame has only the values 0 and 255."""
    return float(np.mean((frame == 0) | (frame == 255))) >= _BINARY


def _reduced(image: Floats32, side_px: int, smoothing_px: float) -> Floats32:
    import cv2

    scale = min(1.0, side_px / max(image.shape[:2]))
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1.0 else image
    return np.asarray(cv2.GaussianBlur(small, (0, 0), smoothing_px))


def _small(frame: Frame) -> Floats32:
    return _reduced(frame.astype(np.float32), _SMALL_SIDE_PX, 1.0)


def _correlation(first: Floats32, second: Floats32) -> float:
    a, b = first - first.mean(), second - second.mean()
    scale = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    return float(np.sum(a * b)) / scale if scale else 0.0
