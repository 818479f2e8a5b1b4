"""Copies of training frames: with noise, brighter, darker. Copies are made for training sets only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.analysis.classification.features import Features
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Floats32, Ints

#: The number of columns for which noise is drawn, or which are multiplied, at a time.
BLOCK = 1024


def trial_seed(seed: int, trial: int) -> int:
    """Return the seed of all random numbers in one trial.

    Args:
        seed: The seed of the classification.
        trial: The number of the trial, from 1.
    """
    return int(np.random.SeedSequence([seed, trial]).generate_state(1)[0])


def noise_block(seed: int, first: int, count: int, width: int) -> Floats32:
    """Draw standard normal noise for some columns of all frames; equal arguments give equal noise.

    Args:
        seed: The seed of the trial.
        first: The first column, a multiple of :data:`BLOCK`.
        count: The number of frames.
        width: The number of columns.

    Returns:
        The noise, shape (count, width).
    """
    return np.random.default_rng([seed, first // BLOCK]).standard_normal((count, width), dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Augmentation:
    """The copies that are added to each training frame; they are not clipped. By default there are none.

    Args:
        noise: The standard deviation of the Gaussian noise on one copy, in the unit of the frames; None for no noisy
            copy.
        brightness: The amounts that are added to all numbers of a frame, one for each further copy.

    Raises:
        InputError: A number is not allowed.
    """

    noise: float | None = None
    brightness: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.noise is not None and not (np.isfinite(self.noise) and self.noise > 0):
            raise InputError("noise", self.noise, "must be a standard deviation above 0, or none")
        if not np.isfinite(self.brightness).all() or 0.0 in self.brightness:
            raise InputError("brightness", list(self.brightness), "must be numbers other than 0, or none")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the copies, in their order: ``none``, ``noise 5``, ``+10``, ``-10``."""
        noisy = () if self.noise is None else (f"noise {self.noise:g}",)
        return ("none", *noisy, *(f"{level:+g}" for level in self.brightness))

    @property
    def count(self) -> int:
        """The number of rows for each training frame, including the frame itself."""
        return len(self.names)

    @property
    def offsets(self) -> tuple[float, ...]:
        """The amounts that are added to the copies, without the noise."""
        return (0.0, *(() if self.noise is None else (0.0,)), *self.brightness)

    def rows(self, features: Features, chosen: Sequence[int] | Ints, seed: int) -> Floats:
        """Make the copies of some frames.

        Args:
            features: All frames.
            chosen: The indices of the training set.
            seed: The seed of the trial.

        Returns:
            First the unchanged frames, then the frames with noise, then each brightness; (copies x chosen, numbers).
        """
        indices = np.asarray(chosen, dtype=np.int64)
        plain = features.rows[indices].astype(np.float64)
        copies = [plain + level for level in self.offsets]
        if self.noise is not None:
            for first in range(0, plain.shape[1], BLOCK):
                width = min(BLOCK, plain.shape[1] - first)
                drawn = noise_block(seed, first, len(features), width)[indices]
                copies[1][:, first : first + width] += self.noise * drawn.astype(np.float64)
        return np.concatenate(copies)


#: The copies of the paper's text.
PAPER_COPIES = Augmentation(noise=5.0, brightness=(10.0, -10.0))
