"""Copies of training frames: with noise, brighter, darker. Copies are made for training sets only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats


def trial_seed(seed: int, trial: int) -> int:
    """Return the seed of all random numbers in one trial.

    Args:
        seed: The seed of the classification.
        trial: The number of the trial, from 1.
    """
    return int(np.random.SeedSequence([seed, trial]).generate_state(1)[0])


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

    def rows(self, frames: NDArray[Any], seed: int) -> Floats:
        """Make the copies of some frames.

        Args:
            frames: The frames, (n, numbers).
            seed: The seed of the noise.

        Returns:
            First the unchanged frames, then the frames with noise, then each brightness; (copies x n, numbers).
        """
        plain = frames.astype(np.float64)
        random = np.random.default_rng(seed)
        noise = [] if self.noise is None else [plain + self.noise * random.standard_normal(plain.shape)]
        return np.concatenate([plain, *noise, *(plain + level for level in self.brightness)])


#: The copies of the paper's text.
PAPER_COPIES = Augmentation(noise=5.0, brightness=(10.0, -10.0))
