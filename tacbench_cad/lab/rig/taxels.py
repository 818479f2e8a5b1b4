"""An array of taxels that sends one line per sample over serial. A frame is one sample or a short series."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.rig import ports
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.samples import BAUD, SampleStream, StuckSamples, require_stuck_samples
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.spec import Baud, SensorSettings
from tacbench_cad.util.convert import check_fields, from_plain

#: The largest number of attempts to record a series. A series with a damaged line is discarded, since it has a gap.
_ATTEMPTS = 5


@dataclass(frozen=True, kw_only=True)
class TaxelOptions:
    """The options of an array of taxels in ``[sensor]``.

    Args:
        columns: The number of taxels, which is the number of values on a line.
        samples: The number of samples in a frame: 1 gives shape (columns,), more give shape (samples, columns).
        units: The unit of the values.
        baud: The baud rate.
        timeout_s: The longest wait for a sample, in s of real time.
        stuck_samples: The number of identical samples in a row that mean a stuck array; 0 switches the check off, for a
            device whose rounding hides its noise.
        latency_s: The time, in s of rig time, for which the USB adapter may hold samples. Samples that arrive within
            this time were taken before the request.
    """

    columns: Annotated[int, Interval(ge=1, le=1000)]
    samples: Annotated[int, Interval(ge=1, le=1_000_000)] = 1
    units: str = "counts"
    baud: Baud = BAUD
    timeout_s: Annotated[float, Interval(ge=0.1, le=600.0)] = 2.0
    stuck_samples: StuckSamples = 50
    latency_s: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.02

    def __post_init__(self) -> None:
        check_fields(self)
        require_stuck_samples(self.stuck_samples)


class TaxelSensor(SampleStream):
    """An array of taxels over serial. See :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        lines: The port.
        name: The device, for error messages.
        options: The format of its lines.
        clock: The rig's time.

    Raises:
        RigError: The device sends no valid sample.
    """

    simulated = ""

    def __init__(self, lines: Line, *, name: str, options: TaxelOptions, clock: Clock) -> None:
        self.units = options.units
        self.shape: tuple[int, ...] = (options.samples, options.columns)[options.samples == 1 :]
        chosen = {"columns": options.columns, "samples": options.samples, "baud": options.baud}
        # The device cannot be asked for its settings, but every line was checked for this number of values.
        self.settings: dict[str, Any] = {"requested": chosen, "actual": {"columns": options.columns}}
        self._samples = options.samples
        self._latency_s = options.latency_s / clock.speed
        super().__init__(
            lines=lines,
            name=name,
            columns=options.columns,
            timeout_s=options.timeout_s,
            stuck_samples=options.stuck_samples,
        )
        self.wait_for_start()

    def read(self) -> Frame:
        """Return the next samples that arrive completely after this call.

        Returns:
            float64, shape (columns,) or (samples, columns).

        Raises:
            RigError: Too many lines are garbled, or the array is stuck.
            RigError: The device is gone or silent.
        """
        self.start_fresh(self._latency_s)
        for _ in range(_ATTEMPTS):
            damaged = self.garbled
            rows: list[tuple[float, ...]] = []
            while len(rows) < self._samples and self.garbled == damaged:
                rows.append(self.next())
            if self.garbled == damaged or self._samples == 1:
                return np.array(rows, dtype=np.float64).reshape(self.shape)
        raise RigError(
            f"{self.name}: {_ATTEMPTS} series in a row contained a damaged line; try a lower rate or a shorter cable"
        )


def open_taxels(settings: SensorSettings, clock: Clock, *, taken: Sequence[str] = ()) -> TaxelSensor:
    """Open the array that ``[sensor]`` describes.

    Args:
        settings: The table.
        clock: The rig's time.
        taken: The ports of the rig's other devices, which are not tried.

    Raises:
        InputError: A setting is not allowed, or the port does not exist.
        RigError: The device sends no valid sample.
    """
    options = from_plain(TaxelOptions, settings.options, "[sensor] ")
    port = ports.resolve(settings.device, "sensor", taken=taken)
    line = Line(port, baud=options.baud, what="sensor")
    return TaxelSensor(line, name=f"taxels at {port}", options=options, clock=clock)
