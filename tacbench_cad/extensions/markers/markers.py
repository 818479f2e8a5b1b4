"""Search for the markers of a tactile sensor in its frames, with sub-pixel centres.

A marker is a small bright or dark spot that occurs many times in a frame, for example a pin of a TacTip or a dot in a
gel. The finder learns the appearance of the spots from some frames of the sensor, so nothing has to be tuned:

1. *Scale.* Peaks of the normalised Laplacian of Gaussian ``-s^2 L(s)`` are highest for spots of the width
   ``sqrt(8) s``. The finder tries all scales, for bright and for dark spots, and takes the one with the largest
   ``n r^3``, where n is the number of peaks with a response of at least r. Many equal spots give a larger value than a
   few large reflections or many small grains of noise.
2. *Template.* The template is the median of the patches around these peaks, made symmetric.
3. *Fit.* Each patch is written as ``level + slope x + slope y + contrast template(x - dx, y - dy)``, linearised for
   small shifts. A single matrix then gives the contrast, the shift and the quality of the fit of every candidate.
   Reflections, rims and lamps fit badly; weak pins fit well.
4. *Field.* Only spots near other spots are markers. This removes lamps and structures next to the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from tacbench_cad.extensions.markers.pattern import MIN_MARKERS, in_field, no_pattern
from tacbench_cad.lab.rig import Frame
from tacbench_cad.lab.runs import grey, noise_counts
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Floats32

#: The scales that are tried, in pixels. Below the limit, markers are searched in frames that are enlarged twice.
SCALES_PX = 1.5 * 1.2 ** np.arange(-4, 13)
_ENLARGED_BELOW_PX = 1.5
#: The smallest response of a peak when the scale is estimated, in standard deviations of the response to noise.
_MIN_PEAK_NOISE = 4.0
#: The smallest score ``quality + weight min(1, 2 contrast / usual contrast)`` of a marker, and the weight. A weak spot
#: must look like the template; a strong spot may be partly covered by a reflection.
_MIN_SCORE, _CONTRAST_WEIGHT = 1.1, 0.35
#: The default of the smallest contrast: as a fraction of the usual contrast, and in standard deviations of the noise.
_MIN_CONTRAST, _MIN_NOISE_RATIO = 0.22, 4.0
#: The smallest distance of two markers, in scales. It is less than the width of a spot, because pins may overlap.
_MIN_DISTANCE = 2.0
#: Half the side of a patch, in scales; and the smoothing before the fit, which makes the effect of a shift more linear.
_PATCH, _SMOOTHING_PX = 1.8, 0.8
#: A fit with a quality below the first number is repeated with weights. A pixel whose distance from the model is the
#: second number, as a fraction of the usual contrast, has a quarter of the weight. The third is the number of repeats.
_GOOD_FIT, _FAR, _ROBUST_STEPS = 0.985, 0.2, 3
#: The distance of the ceiling above the markers' usual brightness, as a fraction of the contrast.
_CEILING = 0.3
#: The penalties for shapes that differ from the template, in a stiff and in a loose fit.
_STIFFNESS = (4.0, 0.003)
#: Ellipses are fitted if this increases the number of markers by more than this factor.
_MANY_MORE = 1.1
#: The smallest quality of the first fit for which a second fit is made.
_MIN_QUALITY = 0.6


@dataclass(frozen=True, kw_only=True)
class MarkerSettings(Checked):
    """The known properties of markers. Values of None are estimated from the frames.

    Args:
        sigma_px: The scale of the Laplacian of Gaussian, from 0.7 to 20: the width of a marker divided by 2.8.
        threshold: The smallest contrast of a marker with its surroundings, in counts.
        dark: Whether the markers are darker than their surroundings.
    """

    sigma_px: Annotated[float, Interval(ge=0.7, le=20.0)] | None = None
    threshold: Annotated[float, Interval(gt=0.0, le=255.0)] | None = None
    dark: bool | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Markers:
    """The markers of a frame.

    Args:
        centres_px: The column and row of each centre, shape (n, 2). The middle of the first pixel is 0, 0.
        contrast: The difference between each marker and its surroundings, in counts, shape (n,).
        quality: The correlation of each marker with the template, shape (n,).
    """

    centres_px: Floats
    contrast: Floats
    quality: Floats

    def __len__(self) -> int:
        return len(self.centres_px)

    def chosen(self, which: Bools | NDArray[np.int64]) -> Markers:
        """Return the markers at some indices, or those for which a mask is true."""
        return Markers(centres_px=self.centres_px[which], contrast=self.contrast[which], quality=self.quality[which])


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerFinder:
    """A finder of a sensor's markers in its frames.

    Args:
        sigma_px: The scale.
        threshold: The smallest contrast of a marker, in counts.
        dark: Whether the markers are darker than their surroundings.
        contrast: The usual contrast, in counts.
        template: The appearance of a marker, with a height of 1, shape (k, k), k odd.
        ceiling: The brightness at which frames are clipped when candidates are searched, in counts. Otherwise a
            reflection could shift the peak of a marker.
        ellipses: Whether some markers look like ellipses, for example at the rim of a wide dome.
        mask: The pixels in which markers are searched, shape of a frame; None for all pixels.
    """

    sigma_px: float
    threshold: float
    dark: bool
    contrast: float
    template: Floats
    ceiling: float = np.inf
    ellipses: bool = False
    mask: Bools | None = None

    @classmethod
    def learn(
        cls, frames: Sequence[Frame], settings: MarkerSettings | None = None, mask: Bools | None = None
    ) -> MarkerFinder:
        """Learn the appearance of markers.

        Args:
            frames: Frames of the sensor, preferably without contact. A single frame is enough.
            settings: The known properties of the markers.
            mask: The pixels in which markers are searched; None for all pixels.

        Raises:
            InputError: There is no frame, a frame is not an image, or the frames show no pattern of markers. Whether
                there is a pattern is not examined if the scale or the threshold is known.
        """
        known = settings or MarkerSettings()
        if not frames:
            raise InputError("frames", 0, "must be at least one frame that shows the markers")
        greys = [grey(frame) for frame in frames]
        scales = SCALES_PX if known.sigma_px is None else np.array([known.sigma_px])
        signs = (False, True) if known.dark is None else (known.dark,)
        noise = float(np.median([noise_counts(image) for image in greys]))
        unknown = cls(sigma_px=1.0, threshold=0.0, dark=False, contrast=0.0, template=np.zeros((1, 1)), mask=mask)
        tried = [replace(unknown, sigma_px=scale, dark=dark) for scale in scales.tolist() for dark in signs]
        strengths = [each._strength(greys, noise) for each in tried]
        at = int(np.argmax([strength for strength, _ in strengths]))
        strength, response = strengths[at]
        if strength == 0.0:
            raise _no_markers(f"there are fewer than {MIN_MARKERS} equal spots")
        first = replace(tried[at], contrast=response)
        response *= 0.99  # so that the weakest marker is above it
        greys = [first._enlarged(image) for image in greys]
        patches = np.concatenate([first._strong_patches(image, response) for image in greys])
        low, high = (np.quantile(patches, part, axis=(1, 2), keepdims=True) for part in (0.15, 0.98))
        heights = (-1.0 if first.dark else 1.0) * (patches - low) / np.maximum(high - low, 1.0)
        first = replace(first, template=_symmetric(np.median(heights, axis=0)))
        contrast = float(np.median(np.concatenate([first._usual(image, response) for image in greys])))
        threshold = known.threshold or max(_MIN_CONTRAST * contrast, _MIN_NOISE_RATIO * noise)
        ceiling = np.inf if first.dark else float(np.median(high)) + _CEILING * contrast
        spots = replace(first, contrast=contrast, threshold=threshold, ceiling=ceiling)
        ellipses = replace(spots, ellipses=True)
        found, more = ([each.find(frame).centres_px for frame in frames] for each in (spots, ellipses))
        if sum(map(len, more)) > _MANY_MORE * sum(map(len, found)):
            spots, found = ellipses, more
        reason = no_pattern(found, contrast) if known.sigma_px is None and known.threshold is None else ""
        if reason:
            raise _no_markers(reason)
        return spots

    def find(self, frame: Frame) -> Markers:
        """Find the markers of a frame, in no particular order.

        Args:
            frame: uint8, shape (height, width) or (height, width, 3), BGR.

        Raises:
            InputError: The frame is not an image, or has another shape than the mask.
        """
        image = grey(frame)
        if self.mask is not None and self.mask.shape != image.shape:
            raise InputError("frame", image.shape, f"must be {self.mask.shape}, the shape of the region of interest")
        image = self._enlarged(image)
        # The factor 0.5 allows for a reflection or neighbours that lower the response to the weakest marker.
        cut = np.minimum(image, np.float32(self.ceiling))
        candidates, _ = _peaks(cut, self._scale, self.dark, 0.5 * self.threshold, self._mask)
        fitted = self._fit(image, candidates)
        fitted = fitted.chosen(self._are_markers(fitted))
        fitted = _thinned(fitted, _MIN_DISTANCE * self._scale)
        fitted = fitted.chosen(in_field(fitted.centres_px))
        return replace(fitted, centres_px=(fitted.centres_px + 0.5) / self._zoom - 0.5)

    @property
    def _zoom(self) -> int:
        """The factor by which frames are enlarged: a fit needs spots that are wider than a few pixels."""
        return 2 if self.sigma_px < _ENLARGED_BELOW_PX else 1

    @property
    def _scale(self) -> float:
        """The scale in pixels of the enlarged frame."""
        return self.sigma_px * self._zoom

    @cached_property
    def _mask(self) -> Bools | None:
        """The mask of the enlarged frame."""
        return None if self.mask is None else np.kron(self.mask, np.ones((self._zoom, self._zoom), dtype=bool))

    def _enlarged(self, image: Floats32) -> Floats32:
        """Enlarge a grey frame if the markers are small."""
        import cv2

        if self._zoom == 1:
            return image
        return np.asarray(cv2.resize(image, None, fx=self._zoom, fy=self._zoom, interpolation=cv2.INTER_CUBIC))

    def _strength(self, greys: Sequence[Floats32], noise: float) -> tuple[float, float]:
        """Return the measure ``n r^3`` of this scale, and the response r that the n peaks reach.

        White noise with standard deviation s gives responses with standard deviation ``s / (sqrt(2 pi) scale)``.
        """
        low = max(1.0, _MIN_PEAK_NOISE * noise / (math.sqrt(2.0 * math.pi) * self.sigma_px))
        images = (self._enlarged(image) for image in greys)
        responses = np.concatenate([_peaks(image, self._scale, self.dark, low, self._mask)[1] for image in images])
        falling = np.sort(responses)[::-1].astype(np.float64)
        value = np.arange(1, len(falling) + 1) * falling**3
        value[: MIN_MARKERS * len(greys) - 1] = 0.0
        if not value.any():
            return 0.0, 0.0
        place = int(np.argmax(value))
        return float(value[place]), float(falling[place])

    @cached_property
    def _model(self) -> tuple[Bools, Floats32, Floats32]:
        """The pixels of a patch, the matrix from coefficients to pixels, and the penalties of a stiff and a loose fit.

        The coefficients are the level, the slopes in x and y, the contrast, the contrast times dx and dy, and how much
        wider the spot is in x, in y and diagonally (at the rim of a dome, round pins look like ellipses).
        """
        half = self.template.shape[0] // 2
        y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
        disc = np.hypot(x, y) <= half + 0.5
        along_y, along_x = (np.asarray(np.gradient(self.template, axis=axis)) for axis in (0, 1))
        columns = (
            *(np.ones_like(x), x / half, y / half, self.template, -along_x, -along_y),
            *(x * along_x, y * along_y, x * along_y + y * along_x),
        )
        design = np.column_stack([column[disc] for column in columns])
        penalties = [np.diag(np.sum(design**2, axis=0) * ([1e-6] * 6 + [stiffness] * 3)) for stiffness in _STIFFNESS]
        return disc, design.astype(np.float32), np.array(penalties, dtype=np.float32)

    def _fit(self, image: Floats32, places: Floats) -> Markers:
        """Fit the model to the patches around some places, and again at the places that the first fit gives.

        The second fit uses the template. With ``ellipses``, other spots are then fitted as ellipses.
        """
        import cv2

        smooth = cv2.GaussianBlur(image, (0, 0), _SMOOTHING_PX)
        first = self._step(smooth, places, loose=True, robust=False)
        likely = (first.quality > _MIN_QUALITY) & (first.contrast > 0.5 * self.threshold)
        second = self._step(smooth, first.centres_px[likely], loose=False, robust=True)
        if self.ellipses:
            others = np.flatnonzero(~self._are_markers(second))
            ellipses = self._step(smooth, first.centres_px[likely][others], loose=True, robust=True)
            second.centres_px[others], second.contrast[others] = ellipses.centres_px, ellipses.contrast
            second.quality[others] = ellipses.quality
        stray = np.max(np.abs(second.centres_px - places[likely]), axis=1, initial=0.0) > self._scale
        return second.chosen(~stray)

    def _are_markers(self, fitted: Markers) -> Bools:
        """Return whether each candidate is a marker."""
        score = fitted.quality + _CONTRAST_WEIGHT * np.minimum(1.0, 2.0 * fitted.contrast / self.contrast)
        return np.asarray((score >= _MIN_SCORE) & (fitted.contrast >= self.threshold))

    def _step(self, smooth: Floats32, places: Floats, *, loose: bool, robust: bool) -> Markers:
        """Fit the model once, around the pixels nearest to some places.

        If a fit is bad and ``robust`` is true, it is repeated with less weight for pixels far from the model. A
        reflection that covers a part of a marker then neither hides nor shifts the marker.
        """
        disc, design, penalties = self._model
        penalty = penalties[int(loose)]
        middle = np.rint(places).astype(np.int64)
        patches = _patches(smooth, middle, self.template.shape[0] // 2)[:, disc]
        values = np.linalg.solve(design.T @ design + penalty, design.T @ patches.T).T
        quality = _quality(patches, patches - values @ design.T)
        poor = np.flatnonzero(quality < _GOOD_FIT)
        if robust and len(poor):
            covered, fit = patches[poor], values[poor]
            for _ in range(_ROBUST_STEPS):
                residual = (covered - fit @ design.T) / np.float32(_FAR * self.contrast)
                weights = (1.0 + residual**2) ** -2
                weighted = (weights[:, :, None] * design).transpose(0, 2, 1)
                fit = np.linalg.solve(weighted @ design + penalty, weighted @ covered[:, :, None])[:, :, 0]
            values[poor] = fit
            quality[poor] *= _quality(covered, covered - fit @ design.T, weights) * np.sqrt(np.mean(weights, axis=1))
        contrast = values[:, 3:4].astype(np.float64)
        shift = np.divide(values[:, 4:6], contrast, out=np.zeros((len(places), 2)), where=contrast != 0.0)
        return Markers(
            centres_px=middle + np.clip(shift, -2.0, 2.0),
            contrast=(-1.0 if self.dark else 1.0) * contrast[:, 0],
            quality=quality.astype(np.float64),
        )

    def _strong_patches(self, image: Floats32, response: float) -> Floats:
        """Return patches around the peaks with at least the response of most markers."""
        import cv2

        places, _ = _peaks(image, self._scale, self.dark, response, self._mask)
        half = math.ceil(_PATCH * self._scale)
        smooth = cv2.GaussianBlur(image, (0, 0), _SMOOTHING_PX)
        return _patches(smooth, np.rint(places).astype(np.int64), half).astype(np.float64)

    def _usual(self, image: Floats32, response: float) -> Floats:
        """Return the contrasts of the peaks with at least the response of most markers."""
        import cv2

        places, _ = _peaks(image, self._scale, self.dark, response, self._mask)
        return self._step(cv2.GaussianBlur(image, (0, 0), _SMOOTHING_PX), places, loose=True, robust=False).contrast


def _no_markers(reason: str) -> InputError:
    advice = "use --features pixels, or give sigma_px if the sensor has markers: --features markers:sigma_px=3.5"
    return InputError("markers", None, f"there are no markers in these frames: {reason}; {advice}")


def _peaks(image: Floats32, scale: float, dark: bool, low: float, mask: Bools | None) -> tuple[Floats, Floats32]:
    """Find peaks of the normalised Laplacian of Gaussian above ``low``; return places (n, 2) and responses (n,).

    Ridges, such as rims and rings, are left out: at a spot, the smoothed image has a similar curvature in all
    directions.
    """
    import cv2

    smooth = cv2.GaussianBlur(image, (0, 0), scale)
    response = cv2.Laplacian(smooth, cv2.CV_32F, ksize=1)
    response *= scale**2 if dark else -(scale**2)
    side = 2 * math.ceil(scale) + 1
    largest = cv2.dilate(response, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    is_peak = (response == largest) & (response > low)
    step = max(1, round(scale))
    is_peak[:step] = is_peak[-step:] = is_peak[:, :step] = is_peak[:, -step:] = False
    if mask is not None:
        is_peak &= mask
    y, x = np.nonzero(is_peak)

    def at(dy: int, dx: int) -> Floats32:
        return np.asarray(smooth[y + dy * step, x + dx * step])

    xx, yy = at(0, 1) + at(0, -1) - 2 * at(0, 0), at(1, 0) + at(-1, 0) - 2 * at(0, 0)
    xy = (at(1, 1) + at(-1, -1) - at(1, -1) - at(-1, 1)) / 4
    round_ = 4 * (xx * yy - xy**2) > 0.5 * (xx + yy) ** 2
    return np.column_stack([x, y])[round_].astype(np.float64), response[y, x][round_]


def _patches(image: Floats32, middle: NDArray[np.int64], half: int) -> Floats32:
    """Return square patches around pixels, shape (n, 2 half + 1, 2 half + 1). The image's edge is repeated."""
    at = np.arange(-half, half + 1)
    rows = np.clip(middle[:, 1, None] + at, 0, image.shape[0] - 1)
    columns = np.clip(middle[:, 0, None] + at, 0, image.shape[1] - 1)
    return np.asarray(image[rows[:, :, None], columns[:, None, :]])


def _symmetric(patch: Floats) -> Floats:
    """Return the mean of a patch and its mirror images, so that the spot is centred."""
    both = patch + patch[::-1]
    both = both + both[:, ::-1]
    return (both + both.T) / 8.0


def _quality(patches: NDArray[Any], residual: NDArray[Any], weights: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return the correlation of patches with the model, from the residuals of the fit."""
    weight = np.ones((1, 1), dtype=np.float32) if weights is None else weights / np.mean(weights, axis=1, keepdims=True)
    level = np.mean(weight * patches, axis=1, keepdims=True)
    square = np.maximum(np.mean(weight * (patches - level) ** 2, axis=1), 1e-6)
    return np.asarray(np.sqrt(np.maximum(0.0, 1.0 - np.mean(weight * residual**2, axis=1) / square)))


def _thinned(markers: Markers, distance: float) -> Markers:
    """Remove markers that are nearer than a certain distance to a marker that fits better."""
    from scipy.spatial import cKDTree

    order = markers.chosen(np.argsort(-markers.quality * np.sqrt(np.maximum(markers.contrast, 0.0))))
    keep = np.ones(len(order), dtype=bool)
    for first, second in cKDTree(order.centres_px).query_pairs(distance, output_type="ndarray"):
        keep[max(first, second)] &= not keep[min(first, second)]
    return order.chosen(keep)
