"""Fixtures for a small study from other software: images of 24 x 32 pixels with a table."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

Texts = Sequence[object]
Images = Callable[..., Path]


def image(seed: int, shape: tuple[int, ...] = (24, 32, 3)) -> np.ndarray:
    """Return an image of noise that depends on the seed."""
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


@pytest.fixture(scope="session")
def noise() -> Callable[..., np.ndarray]:
    """Makes images."""
    return image


@pytest.fixture(scope="session")
def table() -> Callable[..., Path]:
    """Return a function that writes a CSV file."""

    def write(path: Path, header: Texts, rows: Sequence[Texts]) -> Path:
        with path.open("w", newline="", encoding="utf-8") as stream:
            csv.writer(stream).writerows([header, *rows])
        return path

    return write


@pytest.fixture
def images(tmp_path: Path) -> Images:
    """Return a function that writes a folder of images ``0.png``, ``1.png``, ..."""

    def write(count: int, name: str = "frames", suffix: str = ".png") -> Path:
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        for number in range(count):
            assert cv2.imwrite(str(folder / f"{number}{suffix}"), image(number))
        return folder

    return write
