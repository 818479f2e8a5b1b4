"""Principal components of augmented images without the augmented images.

The paper trains on four copies of each image: as it is, with Gaussian noise, and brighter and darker by 10. Written out
in float64 that is 2.8 GB for 1,800 images of 256 x 192, anew for each trial. Everything that the principal components
need follows from inner products:

- of the images with each other: their Gram matrix, once for all trials, exact, since sums of products of whole numbers
  below 2^24 are exact in float32;
- of the brightness copies: unclipped, they differ by multiples of the constant image 1, so image . 1 and 1 . 1 do;
- of the noise: for n images of p pixels, n x p independent normal numbers are drawn only as far as they are seen. Along
  the m directions that the images span they are n x m independent normal numbers, since a rotation of such noise is
  such noise. In the p - m directions beside them only their inner products count, whose law is Wishart's: L L' with a
  lower triangular L of normal numbers and roots of chi squares (Bartlett, 1933). The directions of the components in
  that remaining space are then uniform, so a few random vectors made orthonormal stand for them (Eaton, 1983).

So scores and components have exactly the law that drawn pixels of noise would give them, and for any one draw they are
the components of an explicit set of images with that noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from tacbench_cad.lab.analysis.classification.gram import (
    BLOCK,
    MIDDLE,
    RANK,
    Chosen,
    Scores,
    gram,
    leading,
)
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class _Noise:
    """Noise of all images in the samples' rotated frame.

    Args:
        seen: Along the images' directions, (n, m).
        unseen: Bartlett's triangle for the directions beside them, (n, k); its product with a random orthonormal
            (k, pixels - m) would be the noise there.
    """

    seen: Floats
    unseen: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class _Solution:
    """Leading directions of an augmented set.

    Args:
        seen: Their coordinates along the images' directions, (m, components).
        unseen: Their coordinates beside these directions, (k, components).
        frame: The same along r orthonormal columns, (r, components).
        scores: (copies, n, components).
        offset: Score that the noise's mean adds, taken from every image, (components,).
        variance: (components,).
    """

    seen: Floats
    unseen: Floats
    frame: Floats
    scores: Floats
    offset: Floats
    variance: Floats


class AugmentedPCA:
    """Principal components of the augmented copies of some images, for any number of draws of the noise.

    What all draws share is computed when it is made: Gram matrix and its eigenvectors. ``noise=None`` leaves the noise
    copy out, an empty ``brightness`` the others.

    Args:
        images: All images, (N, pixels).
        chosen: Indices of those that are augmented.
        components: Components to keep.
        noise: Standard deviation of the noise copy.
        brightness: What is added to every pixel of each other copy.

    Raises:
        InputError: A parameter is not allowed, or there are more components than dimensions.
    """

    def __init__(
        self,
        images: Bytes,
        chosen: Chosen,
        *,
        components: int = 25,
        noise: float | None = 5.0,
        brightness: Sequence[float] = (10.0, -10.0),
    ) -> None:
        if images.dtype != np.uint8 or images.ndim != 2:
            raise InputError("images", f"{images.dtype} {images.shape}", "must be uint8, one row an image")
        if noise is not None and not (np.isfinite(noise) and noise >= 0):
            raise InputError("noise", noise, "must be a standard deviation of at least 0, or None")
        if not np.isfinite(list(brightness)).all():
            raise InputError("brightness", tuple(brightness), "must be finite")
        self.images = images
        self.chosen = np.asarray(chosen, dtype=np.int64)
        self.count, self.pixels = len(self.chosen), images.shape[1]
        self.components = components
        self.noise = noise
        self.copies = 1 + (noise is not None) + len(brightness)
        rows = self.copies * self.count
        offsets = np.array([0.0, *brightness])
        #: Each plain copy's brightness from the mean of all copies, and that of the noise copy.
        self._offsets, self._noise_offset = offsets - offsets.sum() / self.copies, -offsets.sum() / self.copies
        if not 1 <= components <= min(rows, self.pixels):
            raise InputError("components", components, f"must be from 1 to {min(rows, self.pixels)}")
        self._find_basis()
        flat = noise is None and not self._offsets.any()
        most = len(self._lengths) if flat else len(self._ones) + self._beside
        if components > most:
            raise InputError("components", components, f"must be at most {most}: so many directions do the images have")

    def _find_basis(self) -> None:
        """Directions that images and the constant image span, from inner products alone."""
        train = self.images[self.chosen]
        products = gram(train)
        sums = train.sum(axis=1, dtype=np.float64) - float(MIDDLE * self.pixels)
        self._centre = train.mean(axis=0, dtype=np.float64) - MIDDLE
        mean = products.mean(axis=0)
        squares, turn = np.linalg.eigh(products - mean - mean[:, None] + mean.mean())
        kept = squares[::-1] > RANK * max(squares[-1], 1.0)
        #: The samples' rotation (n, n), largest direction first: centred images = turn[:, :s] * lengths @ directions.
        self._turn = np.ascontiguousarray(turn[:, ::-1])
        self._lengths = np.sqrt(squares[::-1][kept])
        span = len(self._lengths)
        along = self._turn[:, :span].T @ (sums - sums.mean()) / self._lengths
        beside = self.pixels - float(along @ along)
        rest = [np.sqrt(beside)] if beside > RANK * self.pixels else []
        #: The constant image in the basis, (m,): the images' directions, then what of it they leave.
        self._ones = np.concatenate([along, rest])
        self._beside = min(self.count, self.pixels - len(self._ones)) if self.noise is not None else 0

    def fits(self, seeds: Sequence[int], others: Chosen = (), *, keep_components: bool = False) -> list[Scores]:
        """Scores of the augmented set and of other images for each draw of the noise.

        The images are gone through once for all draws. Memory: 25 float64 numbers for each image and draw, some blocks
        of pixels, and (n, 2 n) numbers for the draw at work.

        Args:
            seeds: One seed a draw.
            others: Indices of images to project as they are.
            keep_components: Keep the components' pixels, (components, pixels) float64 a draw.

        Returns:
            One for each seed; a seed's numbers do not depend on the other seeds, up to rounding.
        """
        if not len(seeds):
            return []
        solutions = [self._solve(self._draw(seed)) for seed in seeds]
        frames = self._frames(seeds, [len(one.frame) for one in solutions])
        weights = [self._weights(one, frame) for one, frame in zip(solutions, frames, strict=True)]
        indices = np.asarray(others, dtype=np.int64)
        width = self.components
        scores = np.zeros((len(indices), width * len(solutions)))
        peaks = np.zeros(width * len(solutions))
        pixels: list[Floats] = []
        onto = np.concatenate([one.onto for one in weights], axis=1)
        for block, train in self._blocks():
            found = train.T @ onto
            for index, (seed, one) in enumerate(zip(seeds, weights, strict=True)):
                here = found[:, index * width : (index + 1) * width]
                here += one.ones
                here += self._random(seed, block, len(one.frame)) @ one.frame
            peak = found[np.argmax(np.abs(found), axis=0), np.arange(len(peaks))]
            peaks = np.where(np.abs(peak) > np.abs(peaks), peak, peaks)
            scores += (self.images[indices, block].astype(np.float64) - (MIDDLE + self._centre[block])) @ found
            if keep_components:
                pixels.append(found)
        signs = np.where(peaks < 0, -1.0, 1.0).reshape(len(solutions), width)
        parts = np.split(scores, len(solutions), axis=1)
        whole = np.concatenate(pixels).T.reshape(len(solutions), width, -1) if pixels else None
        return [
            Scores(
                augmented=one.scores * sign,
                others=(part - one.offset - self._ones_score(one)) * sign,
                variance=one.variance,
                components=None if whole is None else whole[index] * sign[:, None],
            )
            for index, (one, part, sign) in enumerate(zip(solutions, parts, signs, strict=True))
        ]

    def _ones_score(self, solution: _Solution) -> Floats:
        """Score of the mean brightness of all copies, which the mean of the set has more than that of the images."""
        return cast(Floats, -self._noise_offset * (self._ones @ solution.seen))

    def _draw(self, seed: int) -> _Noise:
        """Draw the noise of all images."""
        n, m, k = self.count, len(self._ones), self._beside
        if self.noise is None:
            return _Noise(seen=np.zeros((n, m)), unseen=np.zeros((n, 0)))
        random = np.random.default_rng([seed, 0])
        seen = random.standard_normal((n, m))
        beside = self.pixels - m
        unseen = np.zeros((n, k))
        if beside < n:
            random.standard_normal(out=unseen)
        else:
            for row in range(n):
                random.standard_normal(out=unseen[row, :row])
            unseen[np.arange(n), np.arange(n)] = np.sqrt(random.chisquare(beside - np.arange(n)))
        seen *= self.noise
        unseen *= self.noise
        return _Noise(seen=seen, unseen=unseen)

    def _solve(self, noise: _Noise) -> _Solution:
        """Leading directions and scores of the augmented set for one draw."""
        n, m, span, width = self.count, len(self._ones), len(self._lengths), self.components
        plain, rows = len(self._offsets), self.copies * self.count
        turned = self._turn.sum(axis=0)  # the samples' ones, rotated
        mean = np.concatenate([turned @ noise.seen, turned @ noise.unseen]) / rows
        ones = np.concatenate([self._ones, np.zeros(self._beside)])
        lengths = np.zeros(m + self._beside)
        lengths[:span] = self._lengths
        noisy = np.zeros((n if self.noise is not None else 0, m + self._beside))
        if self.noise is not None:
            noisy[:, :m], noisy[:, m:] = noise.seen, noise.unseen
            noisy[np.arange(span), np.arange(span)] += self._lengths
            noisy += self._noise_offset * np.outer(turned, ones)
        spread = n * float(self._offsets @ self._offsets)

        def scatter(vectors: Floats) -> Floats:
            product = noisy.T @ (noisy @ vectors)
            product += plain * (lengths**2)[:, None] * vectors
            product += spread * np.outer(ones, ones @ vectors)
            product -= rows * np.outer(mean, mean @ vectors)
            return product

        values, vectors = leading(scatter, m + self._beside, width)
        offset = mean @ vectors
        images = self._turn[:, :span] @ (self._lengths[:, None] * vectors[:span])
        copies = [images + level * (ones @ vectors) for level in self._offsets]
        if self.noise is not None:
            copies.insert(1, self._turn @ (noisy @ vectors))
        _, frame = np.linalg.qr(vectors[m:])
        return _Solution(
            seen=vectors[:m],
            unseen=vectors[m:],
            frame=frame,
            scores=np.stack(copies) - offset,
            offset=offset,
            variance=values / (rows - 1),
        )

    def _blocks(self) -> Iterator[tuple[slice, Floats]]:
        """Blocks of pixels of the chosen images, 128 taken off, float64 (n, pixels of the block)."""
        for first in range(0, self.pixels, BLOCK):
            block = slice(first, min(first + BLOCK, self.pixels))
            yield block, self.images[self.chosen, block].astype(np.float64) - MIDDLE

    def _random(self, seed: int, block: slice, count: int) -> Floats:
        """Normal numbers (pixels of the block, count) that are the same whenever they are asked for."""
        return np.random.default_rng([seed, 1, block.start]).standard_normal((block.stop - block.start, count))

    def _frames(self, seeds: Sequence[int], counts: Sequence[int]) -> list[_Frame]:
        """Inner products of each draw's random vectors with the images, the constant image and each other."""
        frames = [_Frame(images=np.zeros((self.count, c)), ones=np.zeros(c), products=np.zeros((c, c))) for c in counts]
        if not any(counts):
            return frames
        for block, train in self._blocks():
            vectors = [self._random(seed, block, count) for seed, count in zip(seeds, counts, strict=True)]
            found = np.split(train @ np.concatenate(vectors, axis=1), np.cumsum(counts)[:-1], axis=1)
            for frame, vector, product in zip(frames, vectors, found, strict=True):
                frame.images[:] += product
                frame.ones[:] += vector.sum(axis=0)
                frame.products[:] += vector.T @ vector
        return frames

    def _weights(self, solution: _Solution, frame: _Frame) -> _Weights:
        """The components as sums of images, the constant image and the random vectors."""
        span = len(self._lengths)
        vectors = solution.seen
        mix = np.zeros_like(solution.frame)
        if len(mix):
            along = self._turn[:, :span].T @ (frame.images - frame.images.mean(axis=0)) / self._lengths[:, None]
            if len(self._ones) > span:
                along = np.vstack([along, (frame.ones - self._ones[:span] @ along) / self._ones[span]])
            left = np.linalg.cholesky(frame.products - along.T @ along)
            mix = cast(Floats, np.linalg.solve(left.T, solution.frame))
            vectors = vectors - along @ mix
        ones = np.zeros(self.components)
        inner = vectors[:span]
        if len(self._ones) > span:
            ones = vectors[span] / self._ones[span]
            inner = inner - np.outer(self._ones[:span], ones)
        onto = self._turn[:, :span] @ (inner / self._lengths[:, None])
        return _Weights(onto=onto - onto.mean(axis=0), ones=ones, frame=mix)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frame:
    """Random vectors through their inner products: with images (n, c), with the constant image (c,), (c, c)."""

    images: Floats
    ones: Floats
    products: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class _Weights:
    """Components as sums: of images (n, components), the constant image (components,), random ones (c, components)."""

    onto: Floats
    ones: Floats
    frame: Floats
