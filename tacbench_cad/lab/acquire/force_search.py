"""The contact force with a check of the hard limit at every reading, and how it grows with depth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import accumulate, islice
from operator import sub

from tacbench_cad.lab.acquire.safety import Carriage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import ContactError, ForceLimitError, RigError
from tacbench_cad.lab.rig.gauge import Force, Gauge
from tacbench_cad.lab.study.spec import Point, Protocol

#: The force of a free sensor as a fraction of the hard limit, above which the sensor touches something or the gauge is
#: faulty.
FREE_FRACTION = 0.1
#: The zero is updated when the free force has drifted by this fraction of the narrowest band.
DRIFT_FRACTION = 0.25
#: The smallest force that counts as touch, as a multiple of the noise of the free gauge, but at least MIN_TOUCH_N.
TOUCH_DEVIATIONS = 5.0
#: The smallest force that counts as touch, in N.
MIN_TOUCH_N = 0.005
#: The largest force of a free sensor, and the largest drift of the zero from one press to the next, as a multiple of
#: the smallest force that counts as touch. A load cell creeps back by a few mN after a press.
FREE_TOUCHES = 5.0
#: The assumed growth of the force from one coarse step to the next. A coarse step is taken only if the target would
#: still not be reached with this growth. Contact stiffens with depth: ``F ~ depth^2`` triples the increase from the
#: first step to the second. A longer step is taken only if the target would still not be reached with this multiple of
#: the known increase. If the measured increase differs from the known one by more than this factor, no further step of
#: the approach is longer.
GROWTH = 3.0


class ContactForce:
    """Reads the contact force.

    Gauges drift with temperature, in ten minutes by more than the band of the lightest force. Before each press, the
    free force is read at the travel height. If it has changed by more than a quarter of the narrowest band since the
    zero was set, it becomes the new zero. The gauge itself is tared once, at the start of a block.

    Args:
        gauge: The gauge.
        carriage: Checked for a signal before each reading.
        protocol: The protocol with hard limit, bands and window.
        clock: Waits until a step has settled.
        felt: Receives the height in mm and the contact force in N of each reading; see
            :class:`~tacbench_cad.lab.acquire.progress.PressProgress`.
    """

    def __init__(
        self,
        gauge: Gauge,
        carriage: Carriage,
        protocol: Protocol,
        clock: Clock,
        felt: Callable[[float, float], None] = lambda z_mm, force_n: None,
    ) -> None:
        self.gauge = gauge
        self.carriage = carriage
        self.protocol = protocol
        self.clock = clock
        self.felt = felt
        self.zero_n = 0.0
        self.touch_n = MIN_TOUCH_N
        self._newest: tuple[Point, float] | None = None

    def tare(self) -> None:
        """Zero the gauge. The sensor must be free.

        Raises:
            RigError: The gauge failed.
        """
        self.gauge.tare()
        self.zero_n = 0.0
        self.follow_zero()

    def follow_zero(self) -> None:
        """Read the free force and use it as the new zero if it has drifted.

        The first reading does not wait until the sensor has settled. It is enough if it shows the old zero with the
        noise of a sensor at rest.

        Raises:
            ContactError: The force has changed too much for drift since the last press.
            RigError: The value is too large for a free sensor.
        """
        free = self._raw(self.protocol.steps.force_window_s)
        if TOUCH_DEVIATIONS * free.spread_n > self.touch_n or self._has_drifted(free):
            self.clock.sleep(self.protocol.steps.settle_s)
            free = self._raw(self.protocol.steps.force_window_s)
        self.touch_n = max(MIN_TOUCH_N, TOUCH_DEVIATIONS * free.spread_n)
        self._require_free(free.mean_n - self.zero_n)
        max_free_n = FREE_FRACTION * self.protocol.limits.hard_limit_n
        if abs(free.mean_n) > max_free_n:
            raise RigError(
                f"the gauge reads {free.mean_n:z.3f} N at the travel height, where the sensor is free (at most "
                f"{max_free_n:g} N counts as drift); tare or repair it"
            )
        if self._has_drifted(free):
            self.zero_n = free.mean_n

    def require_free(self) -> None:
        """Check at the travel height, before the sensor moves sideways, that it touches nothing.

        Raises:
            ContactError: There is a force. A motor may have slipped, so the true height is unknown.
        """
        try:
            if abs(self.glance().mean_n) > FREE_TOUCHES * self.touch_n:
                self._require_free(self.settled().mean_n)
        except ForceLimitError as error:
            raise ContactError(f"{error}, although the sensor was lifted; a motor has slipped") from None

    def touches(self) -> bool:
        """Return whether the sensor touches something. A first reading above the limit may come from the motion."""
        return self.glance().mean_n > self.touch_n and self.settled().mean_n > self.touch_n

    def glance(self) -> Force:
        """Return the newest force without waiting for the step to settle, to check the limit between coarse steps.

        Raises:
            ForceLimitError: The force is above the hard limit.
            RigError: The force is not a number.
        """
        return self._net(0.0)

    def here_n(self) -> float:
        """Return the newest force. It is read again only if the carriage has moved since.

        Raises:
            ForceLimitError: The force is above the hard limit.
            RigError: The force is not a number.
        """
        if self._newest is None or self._newest[0] != self.carriage.at:
            return self.glance().mean_n
        return self._newest[1]

    def moving_n(self) -> float:
        """Return the newest force in N while the sensor slides. Another thread may call this method.

        Raises:
            ForceLimitError: The force is above the hard limit.
            RigError: The force is not a number.
        """
        return self._raw(0.0).mean_n - self.zero_n

    def settled(self) -> Force:
        """Return the force after the step has settled, averaged over the protocol's window.

        Raises:
            ForceLimitError: The force is above the hard limit.
            RigError: The force is not a number.
        """
        self.clock.sleep(self.protocol.steps.settle_s)
        return self._net(self.protocol.steps.force_window_s)

    def again(self) -> Force:
        """Read the force again without waiting, after the sensor was read.

        Raises:
            ForceLimitError: The force is above the hard limit.
            RigError: The force is not a number.
        """
        return self._net(self.protocol.steps.force_window_s)

    def _has_drifted(self, free: Force) -> bool:
        return abs(free.mean_n - self.zero_n) > DRIFT_FRACTION * min(self.protocol.targets.bands_n)

    def _require_free(self, net_n: float) -> None:
        if abs(net_n) > FREE_TOUCHES * self.touch_n:
            raise ContactError(
                f"the gauge reads {net_n:z.3f} N at the travel height, where the sensor should be free: it touches "
                "something, a motor has slipped, or the gauge is faulty; find the cause, then run the command again"
            )

    def _net(self, window_s: float) -> Force:
        read = self._raw(window_s)
        force = replace(read, mean_n=read.mean_n - self.zero_n)
        self._newest = self.carriage.at, force.mean_n
        self.felt(self.carriage.at[2], force.mean_n)
        return force

    def _raw(self, window_s: float) -> Force:
        self.carriage.check()
        read = self.gauge.read(window_s)
        if not math.isfinite(read.mean_n):
            raise RigError(f"the gauge reads {read.mean_n} N")
        # Pulling is as harmful as pushing. The larger of the raw force and the force minus its zero counts.
        worst = max(abs(read.mean_n), abs(read.mean_n - self.zero_n))
        if worst > self.protocol.limits.hard_limit_n:
            raise ForceLimitError(
                f"the force is {read.mean_n - self.zero_n:.3f} N at z = {self.carriage.at[2]:.3f} mm, above the hard "
                f"limit of {self.protocol.limits.hard_limit_n:g} N; the run was stopped"
            )
        return read


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
