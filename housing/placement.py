"""The placement of a block in a fixture, and the part of a block's name that its fixtures share."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.block import Block
from tacbench_cad.util.types import Floats

_TURNS = np.array(
    [[[1.0, 0.0], [0.0, 1.0]], [[0.0, -1.0], [1.0, 0.0]], [[-1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0], [-1.0, 0.0]]]
)


@dataclass(frozen=True, kw_only=True)
class Placement:
    """The placement of the block frame in the holder frame: quarter turns about z, then a translation.

    Args:
        origin_mm: The origin x, y, z of the block frame in the holder frame.
        quarter_turns: The number of quarter turns counter-clockwise, seen from above, from 0 to 3.
    """

    origin_mm: tuple[float, float, float]
    quarter_turns: int = 0

    @classmethod
    def of_box(
        cls,
        low_mm: tuple[float, float, float],
        box_mm: tuple[tuple[float, float], tuple[float, float]],
        quarter_turns: int,
    ) -> Placement:
        """Place a block so that the lower corner of a turned box is at a point.

        Args:
            low_mm: The point in the holder frame.
            box_mm: The lower and the upper corner of the box in the block frame.
            quarter_turns: The number of quarter turns counter-clockwise.
        """
        corners = np.array(box_mm) @ _TURNS[quarter_turns].T
        x, y = np.array(low_mm[:2]) - corners.min(axis=0)
        return cls(origin_mm=(float(x), float(y), low_mm[2]), quarter_turns=quarter_turns)

    def to_holder(self, xy_mm: ArrayLike) -> Floats:
        """Convert points, shape (n, 2), from the block frame to the holder frame, in mm."""
        turned = np.asarray(xy_mm, dtype=np.float64) @ _TURNS[self.quarter_turns].T
        return np.asarray(turned + np.array(self.origin_mm[:2]))

    def to_block(self, xy_mm: ArrayLike) -> Floats:
        """Convert points, shape (n, 2), from the holder frame to the block frame, in mm."""
        shifted = np.asarray(xy_mm, dtype=np.float64) - np.array(self.origin_mm[:2])
        return np.asarray(shifted @ _TURNS[self.quarter_turns])

    @property
    def matrix(self) -> Floats:
        """The matrix (4, 4) from the block frame to the holder frame, in mm."""
        matrix = np.eye(4)
        matrix[:2, :2] = _TURNS[self.quarter_turns]
        matrix[:3, 3] = self.origin_mm
        return matrix

    def as_dict(self) -> dict[str, object]:
        """Return the placement as plain values for a manifest."""
        return {"origin_mm": list(self.origin_mm), "quarter_turns_ccw": self.quarter_turns}


def turned_size_mm(size_mm: tuple[float, float], quarter_turns: int) -> tuple[float, float]:
    """Return the sides of a turned block along the holder's x and y."""
    return size_mm if quarter_turns % 2 == 0 else (size_mm[1], size_mm[0])


def block_stem(block: Block) -> str:
    """Return the part of a block's name that its fixtures share.

    This is the preset and the scale, then sides, outline and key if they are not the default. The texture, the mapping,
    the sampling, the label and the copy of a block do not matter for its fixtures.
    """
    preset, scale, *others = block.name.removeprefix(f"{block.texture.name}_").split("_")
    kept = [word for word in others if word[0].isdigit() or re.match(r"(key|disc|ring|poly|h)\d", word)]
    return "_".join([preset, scale, *kept])
