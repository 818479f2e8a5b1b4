"""How the force grows with depth: the local stiffness, and what earlier approaches on a block have met."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import accumulate, islice
from operator import sub

#: The assumed growth of the force from one coarse step to the next. A coarse step is taken only if the target would
#: still not be reached with this growth. Contact stiffens with depth: ``F ~ depth^2`` triples the increase from the
#: first step to the second. A longer step is taken only if the target would still not be reached with this multiple of
#: the known increase. If the measured increase differs from the known one by more than this factor, no further step of
#: the approach is longer.
GROWTH = 3.0


@dataclass(kw_only=True)
class Slope:
    """The local stiffness: a straight line through the forces that were measured near a height.

    Args:
        reach_mm: The largest distance from that height at which a force counts, in mm.
        min_mm: The smallest useful distance between two heights, in mm.
        seen: The heights in mm and the forces in N that were measured there.
    """

    reach_mm: float
    min_mm: float
    seen: list[tuple[float, float]] = field(default_factory=list)

    def add(self, z_mm: float, force_n: float) -> None:
        """Store a force that was reached by moving down."""
        self.seen.append((z_mm, force_n))

    def at(self, z_mm: float) -> float | None:
        """Return the stiffness in N/mm around a height; None if unknown or if the force decreases with depth."""
        near = [(z, f) for z, f in self.seen if abs(z - z_mm) <= self.reach_mm]
        if not near or max(z for z, _ in near) - min(z for z, _ in near) < self.min_mm:
            return None
        mean_z = sum(z for z, _ in near) / len(near)
        mean_f = sum(f for _, f in near) / len(near)
        slope = sum((z - mean_z) * (f - mean_f) for z, f in near) / sum((z - mean_z) ** 2 for z, _ in near)
        return -slope if slope < 0.0 else None


@dataclass(kw_only=True)
class KnownGrowth:
    """The largest force that earlier approaches on a block have met at each depth below their first contact.

    Args:
        step_mm: The distance between two depths, in mm: the approach step.
        largest_n: The forces in N at the depths 0, 1, 2, ... steps. They do not decrease.
    """

    step_mm: float
    largest_n: list[float] = field(default_factory=list)

    def add(self, depth_mm: float, force_n: float) -> None:
        """Learn the force at a depth below the last free height. First contact was at most a step below that height."""
        known, index = self.largest_n, round(depth_mm / self.step_mm) - 1
        if index == len(known):
            known.append(known[-1] if known else 0.0)
        if index >= 0:
            known[index:] = [max(force_n, largest_n) for largest_n in known[index:]]

    def safe_steps(self, now_n: float, depth_mm: float, below_n: float, *, max_steps: int) -> tuple[int, float]:
        """Return how many steps at once are safe, and the largest known increase of the force over them, in N.

        Args:
            now_n: The present force. If it is much larger than known at this depth, nothing is known.
            depth_mm: The depth below the last free height.
            below_n: The force that must not be reached with :data:`GROWTH` times the increase.
            max_steps: The largest number of steps.
        """
        index = round(depth_mm / self.step_mm) - 1
        if not (0 <= index < len(self.largest_n) and now_n <= GROWTH * self.largest_n[index]):
            return 0, 0.0
        start = max(index + 1, sum(force_n < now_n for force_n in self.largest_n))
        # Contact stiffens with depth. A smaller increase at a larger depth can come from a motor that has slipped.
        increases = accumulate(map(sub, self.largest_n, [0.0, *self.largest_n]), max)
        growths_n = accumulate(islice(increases, start + 1, start + 1 + max_steps))
        safe = [growth_n for growth_n in growths_n if now_n + GROWTH * growth_n < below_n]
        return len(safe), safe[-1] if safe else 0.0
