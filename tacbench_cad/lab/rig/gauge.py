"""The interface of a force gauge, which measures how hard the sensor presses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from tacbench_cad.lab.rig.stage import Device


@dataclass(frozen=True, kw_only=True)
class Force:
    """A force averaged over a period that began after the request.

    Args:
        mean_n: The mean of the samples in N, positive in compression.
        spread_n: The standard deviation of the samples in N (ddof 0).
        samples: The number of samples, at least one.
        temperature_c: The temperature of the room in degrees Celsius; None if the gauge does not measure it.
    """

    mean_n: float
    spread_n: float
    samples: int
    temperature_c: float | None = None


@runtime_checkable
class Gauge(Device, Protocol):
    """A force gauge. It is connected and identified when it is created.

    Attributes:
        identity: Driver, device and calibration, for people and for ``run.json``.
        simulated: The simulated part, or an empty text.
        calibration: Scale, residual, date and file as plain values; empty for a gauge that sends newtons.
    """

    identity: str
    simulated: str
    calibration: dict[str, object]

    def read(self, window_s: float) -> Force:
        """Average the samples that were taken during the next ``window_s`` seconds; wait for at least one.

        Raises:
            RigError: The gauge is gone or silent, or sends invalid samples.
        """

    def tare(self) -> None:
        """Take the present force as zero. The sensor must not touch anything."""
