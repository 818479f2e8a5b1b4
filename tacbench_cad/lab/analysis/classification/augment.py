"""Copies of training readings: with noise, brighter, darker. The copies are made for a training set only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.analysis.classification.features import Features
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Floats32, Ints

#: Columns of readings that are drawn noise for, or multiplied, at once.
BLOCK = 1024


def trial_seed(seed: int, trial: int) -> int:
    """The number that everything random in one trial follows from.

    Args:
        seed: The study's own.
        trial: From 1.
    """
    return int(np.random.SeedSequence([seed, trial]).generate_state(1)[0])


def noise_block(seed: int, first: int, count: int, width: int) -> Floats32:
    """Standard normal noise of some columns of all readings, the same whenever it is asked for.

    Args:
        seed: The trial's seed.
        first: First column, a multiple of :data:`BLOCK`.
        count: Readings.
        width: Columns.

    Returns:
        Shape (count, width).
    """
    return np.random.default_rng([seed, first // BLOCK]).standard_normal((count, width), dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Augmentation:
    """Which copies of a training reading are made beside the reading itself; they are not clipped.

    Args:
        noise: Standard deviation of the Gaussian noise on one copy, in the readings' unit; None for no such copy.
        brightness: What is added to every number of each other copy.

    Raises:
        InputError: A number is not allowed.
    """

    noise: float | None = 5.0
    brightness: tuple[float, ...] = (10.0, -10.0)

    def __post_init__(self) -> None:
        if self.noise is not None and not (np.isfinite(self.noise) and self.noise > 0):
            raise InputError("noise", self.noise, "must be a standard deviation above 0, or none")
        if not np.isfinite(self.brightness).all() or 0.0 in self.brightness:
            raise InputError("brightness", list(self.brightness), "must be numbers other than 0, or none")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the copies, in their order: ``none``, ``noise 5``, ``+10``, ``-10``."""
        noisy = () if self.noise is None else (f"noise {self.noise:g}",)
        return ("none", *noisy, *(f"{level:+g}" for level in self.brightness))

    @property
    def count(self) -> int:
        """Copies of each reading, itself included."""
        return len(self.names)

    @property
    def offsets(self) -> tuple[float, ...]:
        """What is added to each copy, the noise left aside."""
        return (0.0, *(() if self.noise is None else (0.0,)), *self.brightness)

    def rows(self, features: Features, chosen: Sequence[int] | Ints, seed: int) -> Floats:
        """The copies of some readings, written out.

        Args:
            features: All readings.
            chosen: Indices of the training set.
            seed: The trial's seed.

        Returns:
            All readings as they are, then all with noise, then each brightness; (copies x chosen, numbers).
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
