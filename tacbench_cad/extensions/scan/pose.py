"""How a scan lies on its block: a rotation and a shift, and how the print was stretched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacbench_cad.util.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """The map between the frame of a scan and the frame of its block.

    A nominal point of the block is printed at ``stretch @ nominal``, and a point ``p`` of the scan lies at
    ``rotation @ p + shift_mm`` on the print.

    Args:
        rotation: The rotation, shape (3, 3), with determinant 1.
        shift_mm: The shift, shape (3,).
        stretch: The upper triangular matrix with the scales along x, y and z on its diagonal, and the skew above it.
    """

    rotation: Floats
    shift_mm: Floats
    stretch: Floats

    def to_print(self, points_mm: Floats) -> Floats:
        """Return points of the scan in the frame of the print, with its shrinkage; shape (n, 3)."""
        return np.asarray(points_mm @ self.rotation.T + self.shift_mm)

    def to_block(self, points_mm: Floats) -> Floats:
        """Return points of the scan in the frame of the block, with shrinkage and skew undone; shape (n, 3)."""
        return np.asarray(self.to_print(points_mm) @ np.linalg.inv(self.stretch).T)

    def to_scan(self, nominal_mm: Floats) -> Floats:
        """Return nominal points of the block in the frame of the scan, which is the inverse of :meth:`to_block`."""
        return np.asarray((nominal_mm @ self.stretch.T - self.shift_mm) @ self.rotation)
