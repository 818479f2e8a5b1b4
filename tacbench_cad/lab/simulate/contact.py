"""Contact of the dome with a height map: the depth of the overlap everywhere, and the force.

The model is a Winkler foundation: every element of the dome that overlaps the surface pushes back with ``k`` times the
overlap, so ``F = k * integral of max(0, surface - dome) dA``. The dome is an exact sphere of radius R down to its
equator, and the integral is the sum over the height map's cells. k and R are calibration constants of one TacTip
(:mod:`tacbench_cad.spec.protocol`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.simulate.heights import HeightMap
from tacbench_cad.lab.simulate.prints import SimulatedPrinter, stimulus
from tacbench_cad.lab.study.spec import HolderRim, Point, PrintedBlock
from tacbench_cad.spec.protocol import DOME_RADIUS_MM, FOUNDATION_N_PER_MM3
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The accuracy of a solved force, in N: 1/200 of the narrowest of the paper's bands.
FORCE_ERROR_N = 1e-5
#: The largest number of Newton steps and halvings for a solution; it usually takes fewer than ten.
MAX_STEPS = 200
#: The assumed coefficient of friction of the skin on printed plastic.
FRICTION = 0.5
#: The assumed lateral stiffness of the dome, in N/mm.
LATERAL_N_PER_MM = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlap:
    """The overlap of the surface with the undeformed dome.

    Args:
        depth_mm: The overlap of each cell in mm, at least 0, shape (ny, nx); both may be 0.
        x_mm: The x of the columns relative to the summit, shape (nx,).
        y_mm: The y of the rows relative to the summit, shape (ny,).
        cell_mm: The side of a cell.
    """

    depth_mm: Floats
    x_mm: Floats
    y_mm: Floats
    cell_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reach:
    """The highest summit at which each cell still touches, over one position; only cells within a radius."""

    place: tuple[float, float]
    radius_mm: float
    rows: slice
    columns: slice
    summit_mm: Floats


class DomeContact:
    """The dome over one height map. Summit and forces are in the height map's frame, in mm and N.

    One object must not be used by several threads, since it keeps results for the next call.

    Args:
        ground: The height map below the dome.
        radius_mm: The radius of the dome.
        stiffness_n_per_mm3: The stiffness k of the foundation.
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
        """Return the contact force with the summit at a pose, in N; 0 without contact.

        Args:
            x_mm: The x of the summit in the work frame.
            y_mm: The y of the summit.
            z_mm: The height of the summit.
        """
        return self._force_and_slope(x_mm, y_mm, z_mm)[0]

    def first_touch(self, x_mm: float, y_mm: float) -> float:
        """Return the highest z of the summit at which the dome touches, in mm; ``-inf`` if there is no surface below.

        Args:
            x_mm: The x of the summit in the work frame.
            y_mm: The y of the summit.
        """
        highest = -math.inf
        top, radius = self.ground.top_mm, 1.0
        # A cell beyond radius r touches at top - sag(r) at most. The radius grows until no cell beyond it can touch.
        while True:
            reach = self._reach(x_mm, y_mm, radius)
            if reach.summit_mm.size:
                highest = max(highest, float(np.max(reach.summit_mm)))
            if radius >= self.radius_mm or highest >= top - self._sag(radius):
                return highest
            radius = min(2.0 * radius, self.radius_mm)

    def z_for_force(self, x_mm: float, y_mm: float, force_n: float) -> float:
        """Return the height z of the summit at which the force is reached, within :data:`FORCE_ERROR_N`, in mm.

        The solver is Newton's method between two bounds, with ``dF/dz = -k * contact area``.

        Args:
            x_mm: The x of the summit.
            y_mm: The y of the summit.
            force_n: The target force; 0 gives first touch.

        Raises:
            InputError: The force is negative, or it would need a depth beyond the dome's equator.
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
                "force_n", force_n, f"cannot be reached at ({x_mm:g}, {y_mm:g}) mm; the maximum is {max_n:.3g} N"
            )
        # The depth for a flat surface is a good start everywhere.
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
        raise InputError("force_n", force_n, f"has no solution at ({x_mm:g}, {y_mm:g}) mm; check for infinite heights")

    def overlap(self, x_mm: float, y_mm: float, z_mm: float) -> Overlap:
        """Return the overlap of the surface with the dome, cell by cell around the summit."""
        reach = self._reach(x_mm, y_mm, self._contact_radius(z_mm))
        return Overlap(
            depth_mm=np.maximum(reach.summit_mm - z_mm, 0.0),
            x_mm=self.ground.x_mm[reach.columns] - x_mm,
            y_mm=self.ground.y_mm[reach.rows] - y_mm,
            cell_mm=self.ground.cell_mm,
        )

    def _force_and_slope(self, x_mm: float, y_mm: float, z_mm: float) -> tuple[float, float]:
        """Return the force in N, and its increase per mm of further depth, in N/mm."""
        if z_mm >= self.ground.top_mm:
            return 0.0, 0.0
        summit = self._reach(x_mm, y_mm, self._contact_radius(z_mm)).summit_mm
        touching = summit[summit > z_mm]
        return self._n_per_mm * float(np.sum(touching) - touching.size * z_mm), self._n_per_mm * touching.size

    def _sag(self, radius_mm: float) -> float:
        """Return the height of the dome's surface above its summit at a distance from the axis, in mm."""
        return self.radius_mm - math.sqrt(max(self.radius_mm**2 - radius_mm**2, 0.0))

    def _contact_radius(self, z_mm: float) -> float:
        """Return the distance from the axis beyond which even the highest cell cannot touch, in mm."""
        depth = min(max(self.ground.top_mm - z_mm, 0.0), self.radius_mm)
        return math.sqrt(depth * (2.0 * self.radius_mm - depth))

    def _reach(self, x_mm: float, y_mm: float, radius_mm: float) -> _Reach:
        """See :class:`_Reach`. The last result is used again if it is for the same position and large enough."""
        last = self._last
        # A radius up to twice as large costs less than a new computation.
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


@dataclass
class Drag:
    """The lag of the skin in contact behind the dome, because of friction.

    The skin under the contact sticks to the block and lags behind the dome. The lag grows with the distance that the
    dome moves sideways, and its direction is opposite to the motion. It is limited by friction: the lateral force,
    which is the lag times the lateral stiffness of the dome, is at most the coefficient of friction times the contact
    force. This is the elastic and perfectly plastic law of Prandtl. Both constants are assumptions, not measurements.

    Attributes:
        lag_mm: The x and y by which the dome is ahead of the skin in contact, in the block frame.
    """

    lag_mm: tuple[float, float] = (0.0, 0.0)
    _last_mm: Point | None = None

    def move(self, pose_mm: Point, force_n: float) -> tuple[float, float]:
        """Move the dome to a pose, and return the new lag.

        Args:
            pose_mm: The summit in the work frame.
            force_n: The contact force there. Without contact there is no lag.
        """
        last, self._last_mm = self._last_mm, pose_mm
        if force_n <= 0.0 or last is None:
            self.lag_mm = (0.0, 0.0)
            return self.lag_mm
        x, y = self.lag_mm[0] + pose_mm[0] - last[0], self.lag_mm[1] + pose_mm[1] - last[1]
        length, limit = math.hypot(x, y), FRICTION * force_n / LATERAL_N_PER_MM
        fraction = 1.0 if length <= limit else limit / length
        self.lag_mm = (fraction * x, fraction * y)
        return self.lag_mm


def contact_for(
    printed: PrintedBlock, holder: HolderRim, printer: SimulatedPrinter | None = None, *, seed: int = 0
) -> DomeContact:
    """Create the dome over a printed block in its holder, with the block as its virtual printer prints it.

    Args:
        printed: The block, printer, filament and copy. Printers and filaments without a preset use the generic one.
        holder: The rim of the holder.
        printer: The simulated printer; None for the preset of the block's printer and filament.
        seed: The seed. Another seed gives other copies.
    """
    return DomeContact(stimulus(printed, holder, printer, seed=seed))
