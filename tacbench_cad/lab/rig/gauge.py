"""What a force gauge is: something that says how hard the sensor presses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from tacbench_cad.lab.rig.stage import Device


@dataclass(frozen=True, kw_only=True)
class Force:
    """A force averaged over a stretch of time that began after it was asked for.

    Args:
        mean_n: Mean of the samples in newtons, positive in compression.
        spread_n: Standard deviation of the samples (ddof 0).
        samples: How many there were, at least one.
    """

    mean_n: float
    spread_n: float
    samples: int


@runtime_checkable
class Gauge(Device, Protocol):
    """A force gauge, connected and identified when it is made.

    Attributes:
        identity: Driver, device and calibration, for people and for ``run.json``.
        simulated: What of it is simulated, or an empty text.
        calibration: Scale, residual, date and file as plain values; empty where it sends newtons.
    """

    identity: str
    simulated: str
    calibration: dict[str, object]

    def read(self, window_s: float) -> Force:
        """Average the samples that were taken during ``window_s`` from now; at least one is waited for.

        Raises:
            RigError: Lost, silent, or sending what cannot be a force.
        """

    def tare(self) -> None:
        """Take the present force as zero (the sensor must be free)."""
