"""The time of a rig. A simulated rig may run faster than real time, and its waits are then shorter."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Clock:
    """A clock that waits.

    Args:
        speed: How many times faster than real time the rig runs; 1 for hardware.
    """

    speed: float = 1.0

    def sleep(self, seconds: float) -> None:
        """Wait for a number of seconds of rig time."""
        if seconds > 0.0:
            time.sleep(seconds / self.speed)

    def now_s(self) -> float:
        """Return the rig time in seconds from an arbitrary start, never decreasing."""
        return time.monotonic() * self.speed
