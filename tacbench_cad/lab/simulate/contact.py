"""The dome pressed on a height map: how deep it sinks everywhere, and what force that takes.

Winkler foundation: every element of the dome that overlaps the ground pushes back with ``k`` times the overlap, so
``F = k * integral of max(0, ground - dome) dA``. The dome is an exact sphere of radius R down to its equator, and the
integral is the sum over the height map's cells. k and R are calibration constants of one TacTip
(:mod:`tacbench_cad.spec.protocol`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.simulate.heights import HeightMap
from tacbench_cad.lab.simulate.prints import stimulus
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock
from tacbench_cad.spec.protocol import DOME_RADIUS_MM, FOUNDATION_N_PER_MM3
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: A force is solved to this many newtons: a two hundredth of the narrowest of the paper's bands.
FORCE_ERROR_N = 1e-5
#: Newton steps and halvings before a solution is given up; it takes fewer than ten as a rule.
MAX_STEPS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlap:
    """How far the ground stands inside the undeformed dome.

    Args:
        depth_mm: Overlap of each cell, at least 0, shape (ny, nx); both may be 0.
        x_mm: The columns' places from the summit, shape (nx,).
        y_mm: The rows' places from the summit, shape (ny,).
        cell_mm: Side of a cell.
    """

    depth_mm: Floats
    x_mm: Floats
    y_mm: Floats
    cell_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reach:
    """How high the summit may stand over one place before each cell loses touch; only cells within a radius."""

    place: tuple[float, float]
    radius_mm: float
    rows: slice
    columns: slice
    summit_mm: Floats


class DomeContact:
    """The dome over one height map. Summit and forces in the height map's frame, mm and N.

    Not for several threads at once: what was computed for the last place is kept for the next call.

    Args:
        ground: What it is pressed on.
        radius_mm: Radius of the dome.
        stiffness_n_per_mm3: The foundation's k.
    """

    def __init__(
        self,
        ground: HeightMap,
        *,
        radius_mm: float = DOME_RADIUS_MM,
        stiffness_n_per_mm3: float = FOUNDATION_N_PER_MM3,
    ) -> None:
        for name, value in (("radius_mm", radius_mm), ("stiffness_n_per_mm3", stiffness_n_per_mm3)):
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(name, value, "must be above 0")
        self.ground = ground
        self.radius_mm = radius_mm
        self.stiffness_n_per_mm3 = stiffness_n_per_mm3
        self._n_per_mm = stiffness_n_per_mm3 * ground.cell_mm**2
        self._last: _Reach | None = None

    def force_n(self, x_mm: float, y_mm: float, z_mm: float) -> float:
        """Contact force with the summit at a pose, in N; 0 in the air.

        Args:
            x_mm: Place of the summit in the work frame.
            y_mm: Likewise.
            z_mm: Its height.
        """
        return self._force_and_slope(x_mm, y_mm, z_mm)[0]

    def first_touch(self, x_mm: float, y_mm: float) -> float:
        """Highest z of the summit at which the dome touches, in mm; ``-inf`` over nothing.

        Args:
            x_mm: Place of the summit in the work frame.
            y_mm: Likewise.
        """
        highest = -math.inf
        top, radius = self.ground.top_mm, 1.0
        # What stands beyond a radius r touches at top - sag(r) at best: widen until nothing there can matter.
        while True:
            reach = self._reach(x_mm, y_mm, radius)
            if reach.summit_mm.size:
                highest = max(highest, float(np.max(reach.summit_mm)))
            if radius >= self.radius_mm or highest >= top - self._sag(radius):
                return highest
            radius = min(2.0 * radius, self.radius_mm)

    def z_for_force(self, x_mm: float, y_mm: float, force_n: float) -> float:
        """Height z of the summit at which the force is reached, within :data:`FORCE_ERROR_N`, in mm.

        Newton's method between two bounds, with ``dF/dz = -k * contact area``.

        Args:
            x_mm: Place of the summit.
            y_mm: Likewise.
            force_n: Target force; 0 gives first touch.

        Raises:
            InputError: The force is negative, or no pose reaches it here: the dome would sink to its equator first.
        """
        if not (math.isfinite(force_n) and force_n >= 0.0):
            raise InputError("force_n", force_n, "must be 0 N or more")
        high = self.first_touch(x_mm, y_mm)
        if force_n == 0.0:
            return high
        low = high - self.radius_mm
        max_n = self.force_n(x_mm, y_mm, low) if math.isfinite(high) else 0.0
        if force_n > max_n:
            raise InputError(
                "force_n", force_n, f"cannot be reached at ({x_mm:g}, {y_mm:g}) mm, where {max_n:.3g} N is the most"
            )
        # The depth that a flat ground would need is a good start everywhere.
        z = high - math.sqrt(force_n / (math.pi * self.stiffness_n_per_mm3 * self.radius_mm))
        for _ in range(MAX_STEPS):
            force, slope = self._force_and_slope(x_mm, y_mm, z)
            error = force - force_n
            if abs(error) <= FORCE_ERROR_N:
                return z
            low, high = (z, high) if error > 0.0 else (low, z)
            z = z + error / slope if slope > 0.0 else low
            if not low < z < high:
                z = (low + high) / 2.0
        raise InputError("force_n", force_n, f"was not found at ({x_mm:g}, {y_mm:g}) mm; is a height not finite?")

    def overlap(self, x_mm: float, y_mm: float, z_mm: float) -> Overlap:
        """How far the ground stands inside the dome, cell by cell round the summit."""
        reach = self._reach(x_mm, y_mm, self._contact_radius(z_mm))
        return Overlap(
            depth_mm=np.maximum(reach.summit_mm - z_mm, 0.0),
            x_mm=self.ground.x_mm[reach.columns] - x_mm,
            y_mm=self.ground.y_mm[reach.rows] - y_mm,
            cell_mm=self.ground.cell_mm,
        )

    def _force_and_slope(self, x_mm: float, y_mm: float, z_mm: float) -> tuple[float, float]:
        """Force in N, and how much of it a mm of further depth adds, in N/mm."""
        if z_mm >= self.ground.top_mm:
            return 0.0, 0.0
        summit = self._reach(x_mm, y_mm, self._contact_radius(z_mm)).summit_mm
        touching = summit[summit > z_mm]
        return self._n_per_mm * float(np.sum(touching) - touching.size * z_mm), self._n_per_mm * touching.size

    def _sag(self, radius_mm: float) -> float:
        """How far the dome's surface lies above its summit at a distance from the axis, in mm."""
        return self.radius_mm - math.sqrt(max(self.radius_mm**2 - radius_mm**2, 0.0))

    def _contact_radius(self, z_mm: float) -> float:
        """Distance from the axis beyond which even the highest ground cannot touch, in mm."""
        depth = min(max(self.ground.top_mm - z_mm, 0.0), self.radius_mm)
        return math.sqrt(depth * (2.0 * self.radius_mm - depth))

    def _reach(self, x_mm: float, y_mm: float, radius_mm: float) -> _Reach:
        """See :class:`_Reach`; the last one is taken again where it is at the same place and wide enough."""
        last = self._last
        # Up to twice the radius costs less than computing it anew.
        if last is not None and last.place == (x_mm, y_mm) and radius_mm <= last.radius_mm <= 2.0 * radius_mm:
            return last
        rows, columns = self.ground.near(x_mm, y_mm, radius_mm)
        square_x = (self.ground.x_mm[columns] - x_mm) ** 2
        square_y = (self.ground.y_mm[rows] - y_mm) ** 2
        rest = self.radius_mm**2 - square_x[None, :] - square_y[:, None]
        outside = rest < 0.0
        np.maximum(rest, 0.0, out=rest)
        np.sqrt(rest, out=rest)
        rest += self.ground.z_mm[rows, columns]
        rest -= self.radius_mm
        rest[outside] = -math.inf
        self._last = _Reach(place=(x_mm, y_mm), radius_mm=radius_mm, rows=rows, columns=columns, summit_mm=rest)
        return self._last


def contact_for(printed: PrintedBlock, holder: HolderRim, *, seed: int = 0) -> DomeContact:
    """The dome over a printed block in its holder, the block as its virtual printer makes it.

    Args:
        printed: Block, printer, filament and copy; printers and filaments without a preset of their own get the
            generic one.
        holder: What surrounds the block.
        seed: Another number gives other copies of everything.
    """
    return DomeContact(stimulus(printed, holder, seed=seed))
