"""Friction of the simulated sensor: the skin in contact stays behind the sensor until it slips.

The skin under the contact sticks to the block and lags behind the dome. The lag grows with the distance that the dome
moves sideways, and its direction is opposite to the motion. It is limited by friction: the lateral force, which is
the lag times the lateral stiffness of the dome, is at most the coefficient of friction times the contact force. This
is the elastic and perfectly plastic law of Prandtl. Both constants are assumptions, not measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tacbench_cad.lab.study.spec import Point

#: The assumed coefficient of friction of the skin on printed plastic.
FRICTION = 0.5
#: The assumed lateral stiffness of the dome, in N/mm.
LATERAL_N_PER_MM = 0.5


@dataclass
class Drag:
    """The lag of the skin in contact behind the dome.

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
