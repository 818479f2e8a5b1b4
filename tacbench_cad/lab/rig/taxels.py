"""An array of taxels that sends a line of numbers a sample over serial: one sample a frame, or a short series."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from tacbench_cad.lab.rig import ports
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import SensorError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.samples import BAUD, SampleStream, StuckSamples, require_stuck_samples
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.spec import Baud, SensorSettings
from tacbench_cad.util.convert import Bounds, check_fields, from_plain

#: How often a series is begun again because a line in it was damaged: a series has no holes.
_ATTEMPTS = 5


@dataclass(frozen=True, kw_only=True)
class TaxelOptions:
    """What ``[sensor]`` says of an array of taxels.

    Args:
        columns: Taxels, numbers on a line.
        samples: Samples of a frame: 1 gives shape (columns,), more give a series of shape (samples, columns).
        units: Unit of the numbers.
        baud: Symbols per second.
        timeout_s: Longest real time to wait for a sample.
        stuck_samples: So many identical samples in a row mean that the array is stuck; 0 switches the check off, for
            a device that rounds its noise away.
        latency_s: Rig time for which samples may lie in the USB adapter: what comes within it was taken before.
    """

    columns: Annotated[int, Bounds(1, 1000)]
    samples: Annotated[int, Bounds(1, 1_000_000)] = 1
    units: str = "counts"
    baud: Baud = BAUD
    timeout_s: Annotated[float, Bounds(0.1, 600.0)] = 2.0
    stuck_samples: StuckSamples = 50
    latency_s: Annotated[float, Bounds(0.0, 1.0)] = 0.02

    def __post_init__(self) -> None:
        check_fields(self)
        require_stuck_samples(self.stuck_samples)


class TaxelSensor(SampleStream):
    """Taxels over serial. See :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        lines: The port.
        name: What it is.
        options: How its lines read.
        clock: The rig's time.

    Raises:
        RigError: Nothing that is a sample comes.
    """

    simulated = ""

    def __init__(self, lines: Line, *, name: str, options: TaxelOptions, clock: Clock) -> None:
        self.units = options.units
        self.shape: tuple[int, ...] = (options.samples, options.columns)[options.samples == 1 :]
        chosen = {"columns": options.columns, "samples": options.samples, "baud": options.baud}
        # The device cannot be asked: what it sends in every line is what was checked.
        self.settings: dict[str, Any] = {"requested": chosen, "actual": {"columns": options.columns}}
        self._samples = options.samples
        self._latency_s = options.latency_s / clock.speed
        super().__init__(
            lines=lines,
            name=name,
            columns=options.columns,
            timeout_s=options.timeout_s,
            error=SensorError,
            stuck_samples=options.stuck_samples,
        )
        self.wait_for_start()

    def read(self) -> Frame:
        """The next samples that arrive whole after this call.

        Returns:
            float64, shape (columns,) or (samples, columns).

        Raises:
            SensorError: Too many garbled lines, or a stuck array.
            RigError: Lost or silent.
        """
        self.start_fresh(self._latency_s)
        for _ in range(_ATTEMPTS):
            damaged = self.garbled
            rows: list[tuple[float, ...]] = []
            while len(rows) < self._samples and self.garbled == damaged:
                rows.append(self.next())
            if self.garbled == damaged or self._samples == 1:
                return np.array(rows, dtype=np.float64).reshape(self.shape)
        raise SensorError(
            f"{self.name}: {_ATTEMPTS} series in a row had a damaged line; a slower rate or a shorter cable may help"
        )


def open_taxels(settings: SensorSettings, clock: Clock, *, taken: Sequence[str] = ()) -> TaxelSensor:
    """Open the array that ``[sensor]`` describes.

    Args:
        settings: The table.
        clock: The rig's time.
        taken: Ports of the rig's other devices, which it cannot have.

    Raises:
        InputError: A setting is not allowed, or there is no such port.
        RigError: Nothing that is a sample comes.
    """
    options = from_plain(TaxelOptions, settings.options, "[sensor] ")
    port = ports.resolve(settings.device, "sensor", taken=taken)
    line = Line(port, baud=options.baud, what="sensor")
    return TaxelSensor(line, name=f"taxels at {port}", options=options, clock=clock)
