"""The contact force: the gauge without its zero, and the hard limit whenever it is read."""

from __future__ import annotations

import math
from dataclasses import replace

from tacbench_cad.lab.acquire.safety import Carriage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import ForceLimitError, GaugeError
from tacbench_cad.lab.rig.gauge import Force, Gauge
from tacbench_cad.lab.study.spec import Protocol

#: A free sensor that reads more than this fraction of the hard limit is not free, or its gauge is faulty.
FREE_FRACTION = 0.1
#: The zero follows the free force once that has moved by so much of the narrowest band.
DRIFT_FRACTION = 0.25
#: A force that counts as touch: so many times the noise of the free gauge, and never less than this many newtons.
TOUCH_SPREADS = 5.0
#: The least force that counts as touch, in newtons.
MIN_TOUCH_N = 0.005


class ContactForce:
    """Reads the contact force.

    Gauges drift with warmth, by more in ten minutes than the lightest force's band. Before each press the free force
    is read at the travel height; where it moved by more than a quarter of the narrowest band since the zero was set,
    it is the new zero. The gauge itself is tared once, when a block is begun.

    Args:
        gauge: The gauge.
        carriage: Is asked before the force is read whether a signal came.
        protocol: Hard limit, bands and window.
        clock: Waits until a step has settled.
    """

    def __init__(self, gauge: Gauge, carriage: Carriage, protocol: Protocol, clock: Clock) -> None:
        self.gauge = gauge
        self.carriage = carriage
        self.protocol = protocol
        self.clock = clock
        self.zero_n = 0.0
        self.touch_n = MIN_TOUCH_N

    def tare(self) -> None:
        """Zero the gauge; the sensor must be free.

        Raises:
            RigError: The gauge failed.
        """
        self.gauge.tare()
        self.zero_n = 0.0
        self.follow_zero()

    def follow_zero(self) -> None:
        """Read the free force and take it for the zero where it moved.

        Raises:
            GaugeError: It is no force of a free sensor.
        """
        self.clock.sleep(self.protocol.settle_s)
        free = self._raw(self.protocol.force_window_s)
        max_free_n = FREE_FRACTION * self.protocol.hard_limit_n
        if abs(free.mean_n) > max_free_n:
            raise GaugeError(
                f"the gauge reads {free.mean_n:z.3f} N at the travel height, where the sensor is free (at most "
                f"{max_free_n:g} N is taken for drift); tare or repair it"
            )
        if abs(free.mean_n - self.zero_n) > DRIFT_FRACTION * min(self.protocol.bands_n):
            self.zero_n = free.mean_n
        self.touch_n = max(MIN_TOUCH_N, TOUCH_SPREADS * free.spread_n)

    def glance(self) -> Force:
        """The newest force, without waiting for the step to settle: it guards the limit between coarse steps.

        Raises:
            ForceLimitError: It lies above the hard limit.
            GaugeError: It is no number.
        """
        return self._net(0.0)

    def settled(self) -> Force:
        """The force after the step has settled, averaged over the protocol's window.

        Raises:
            ForceLimitError: It lies above the hard limit.
            GaugeError: It is no number.
        """
        self.clock.sleep(self.protocol.settle_s)
        return self._net(self.protocol.force_window_s)

    def again(self) -> Force:
        """The force once more, without waiting: after the sensor was read.

        Raises:
            ForceLimitError: It lies above the hard limit.
            GaugeError: It is no number.
        """
        return self._net(self.protocol.force_window_s)

    def _net(self, window_s: float) -> Force:
        read = self._raw(window_s)
        return replace(read, mean_n=read.mean_n - self.zero_n)

    def _raw(self, window_s: float) -> Force:
        self.carriage.check()
        read = self.gauge.read(window_s)
        if not math.isfinite(read.mean_n):
            raise GaugeError(f"the gauge reads {read.mean_n} N")
        # Pulling harms as pushing does; whichever of the raw and the zeroed force is larger counts.
        worst = max(abs(read.mean_n), abs(read.mean_n - self.zero_n))
        if worst > self.protocol.hard_limit_n:
            raise ForceLimitError(
                f"the force is {read.mean_n - self.zero_n:.3f} N at z = {self.carriage.at[2]:.3f} mm, above the hard "
                f"limit of {self.protocol.hard_limit_n:g} N; the run was stopped"
            )
        return read
