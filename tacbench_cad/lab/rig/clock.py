"""The time of a rig. A simulated rig may run faster than real time, and its waits are then shorter."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

#: The date at which a clock that never waits begins. It is clearly not the date of a real run.
BEGIN = datetime(2000, 1, 1, tzinfo=UTC)


@dataclass(kw_only=True)
class Clock:
    """A clock that waits.

    Args:
        speed: How many times faster than real time the rig runs: 1 for hardware. Infinity for a simulation that never
            waits; its time begins with 0 at :data:`BEGIN` and passes only while somebody sleeps.
    """

    speed: float = 1.0
    _slept_s: float = field(default=0.0, init=False)

    @property
    def waits(self) -> bool:
        """Whether time passes by itself."""
        return math.isfinite(self.speed)

    def sleep(self, seconds: float) -> None:
        """Wait for a number of seconds of rig time."""
        if seconds > 0.0 and self.waits:
            time.sleep(seconds / self.speed)
        elif seconds > 0.0:
            self._slept_s += seconds

    def now_s(self) -> float:
        """Return the rig time in seconds from an arbitrary start, never decreasing."""
        return time.monotonic() * self.speed if self.waits else self._slept_s

    def utc(self) -> datetime:
        """Return the date and time for the tables of a run."""
        return datetime.now(UTC) if self.waits else BEGIN + timedelta(seconds=self._slept_s)
