"""A load cell that sends one line per sample over serial: raw counts, which need a calibration, or newtons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.rig.calibration import Calibration
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.samples import BAUD, SampleStream, StuckSamples, require_stuck_samples
from tacbench_cad.lab.study.spec import GaugeSettings
from tacbench_cad.util.convert import check_fields, from_plain, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The largest plausible force, in N. A larger sample is a damaged line; several in a row mean a saturated cell.
_MAX_N = 100.0
_SEVERAL = 5
#: A sample is damaged if its distance from the median is this multiple of the standard deviation (estimated from the
#: median absolute deviation) ...
_OFF_TIMES = 10.0
#: ... and more than this, in N (motion within a window changes less), or in raw units without a calibration.
_OFF_N = 0.005
_OFF_UNITS = 10.0
#: The duration over which a tare and a calibration point are averaged, in s.
STILL_S = 1.0


@dataclass(frozen=True, kw_only=True)
class LoadCellOptions:
    """The options of a load cell in ``[gauge.options]``.

    Args:
        unit: ``counts`` or ``newtons``.
        columns: The number of values on a line.
        column: The value that is the force, counted from 1.
        temperature_column: The value that is the temperature of the room in degrees Celsius, from 1; 0 for none.
        low_counts: The counts at which the converter is saturated; the default is for the usual 24 bits (HX711,
            ADS1232).
        high_counts: The upper counts at which the converter is saturated.
        stuck_samples: The number of identical samples in a row that mean a stuck cell; 0 switches the check off, for
            a device whose rounding hides its noise.
        least_samples: The smallest number of samples for a mean, even if the window is shorter. If there are two and
            they differ by much more than noise or not at all, a third one is read.
        latency_s: The time, in s of rig time, for which the USB adapter may hold samples. Samples that arrive within
            this time were taken before the request.
    """

    unit: Literal["counts", "newtons"] = "counts"
    columns: Annotated[int, Interval(ge=1, le=1000)] = 1
    column: Annotated[int, Interval(ge=1, le=1000)] = 1
    temperature_column: Annotated[int, Interval(ge=0, le=1000)] = 0
    low_counts: float = float(-(2**23))
    high_counts: float = float(2**23 - 1)
    stuck_samples: StuckSamples = 20
    least_samples: Annotated[int, Interval(ge=1, le=10_000)] = 2
    latency_s: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.02

    def __post_init__(self) -> None:
        check_fields(self)
        if self.column > self.columns:
            raise InputError("column", self.column, f"must be from 1 to {self.columns}, the number of values on a line")
        if self.temperature_column > self.columns or self.temperature_column == self.column:
            raise InputError(
                "temperature_column",
                self.temperature_column,
                f"must be from 1 to {self.columns}, the number of values on a line, and not column, which is the "
                "force; 0 for none",
            )
        if not self.low_counts < self.high_counts:
            raise InputError("low_counts", self.low_counts, "must be below high_counts")
        require_stuck_samples(self.stuck_samples)

    @classmethod
    def of(cls, values: Mapping[str, Any], *, calibrated: bool) -> LoadCellOptions:
        """Read the keys of ``[gauge.options]``.

        Args:
            values: The table.
            calibrated: Whether the gauge has a calibration. The default unit is counts if it has, otherwise newtons.

        Raises:
            InputError: A key is unknown, or its value is not allowed.
        """
        options = from_plain(cls, {"unit": "counts" if calibrated else "newtons", **values}, "[gauge.options] ")
        if (options.unit == "counts") != calibrated:
            wrong = "needs [gauge] calibration; `tacbench rig calibrate-force` writes one"
            raise InputError(
                "[gauge.options] unit",
                options.unit,
                "must not be combined with [gauge] calibration" if calibrated else wrong,
            )
        return options


@dataclass(frozen=True, kw_only=True)
class RawMean:
    """The mean of raw samples of a load cell under a constant load.

    Args:
        mean: The mean in counts or newtons.
        spread: The standard deviation in the same unit (ddof 0).
        samples: The number of samples.
        temperature_c: The temperature of the room in degrees Celsius in the last sample; None without one.
    """

    mean: float
    spread: float
    samples: int
    temperature_c: float | None = None


class LoadCell(SampleStream):
    """A load cell as a :class:`tacbench_cad.lab.rig.gauge.Gauge`, with checks for impossible samples.

    Args:
        lines: The port.
        name: The device, for error messages.
        options: The format of its lines and its limits.
        clock: The rig's time.
        timeout_s: The longest wait for a sample, in s of real time.
        calibration: The calibration; None if the cell sends newtons or is being calibrated.
        calibration_name: The calibration's file name, for ``run.json``.
        simulated: The simulated part, or an empty text.

    Raises:
        RigError: The device sends no valid sample.
    """

    def __init__(
        self,
        lines: Line,
        *,
        name: str,
        options: LoadCellOptions,
        clock: Clock,
        timeout_s: float = GaugeSettings.timeout_s,
        calibration: Calibration | None = None,
        calibration_name: str = "",
        simulated: str = "",
    ) -> None:
        self.options, self.simulated = options, simulated
        self.calibration: dict[str, object] = {}
        # A simulated load cell has another port at each start, so its port is not part of the identity.
        self.identity = f"{f'load cell, {simulated}' if simulated else name}, {options.unit}"
        if calibration is not None:
            self.calibration = {"file": calibration_name, **to_plain(calibration)}
            self.identity += f", calibrated {calibration.date_utc}"
        self._scale, self._clock = calibration, clock
        self._zero_n, self._beyond = 0.0, 0
        super().__init__(
            lines=lines,
            name=name,
            columns=options.columns,
            timeout_s=timeout_s,
            stuck_samples=options.stuck_samples,
            watched=options.column,
        )
        self.wait_for_start()

    def mean(self, window_s: float) -> RawMean:
        """Average the samples that arrive during a window that begins now.

        Samples far from the median are damaged lines (a number with a lost digit is still a number). They are left
        out and counted as garbled.

        Args:
            window_s: The duration in s of rig time.

        Raises:
            RigError: The cell is stuck or saturated, or too many lines are garbled.
            RigError: The device is gone or silent.
        """
        self.start_fresh(self.options.latency_s / self._clock.speed)
        until = self._clock.now_s() + window_s
        samples: list[float] = []
        while len(samples) < self.options.least_samples or self._clock.now_s() < until or self._in_doubt(samples):
            values = self.next()
            value = values[self.options.column - 1]
            if self._believable(value):
                samples.append(value)
        kept = self._without_damaged(np.array(samples))
        column = self.options.temperature_column
        temperature_c = values[column - 1] if column else None
        return RawMean(
            mean=float(kept.mean()), spread=float(kept.std()), samples=len(kept), temperature_c=temperature_c
        )

    def read(self, window_s: float) -> Force:
        """See :class:`tacbench_cad.lab.rig.gauge.Gauge`."""
        raw = self.mean(window_s)
        spread_n = raw.spread * self._n_per_unit
        return Force(
            mean_n=self._newtons(raw.mean) - self._zero_n,
            spread_n=spread_n,
            samples=raw.samples,
            temperature_c=raw.temperature_c,
        )

    def tare(self) -> None:
        """Take the mean over one second as zero."""
        self._zero_n += self.read(STILL_S).mean_n

    @property
    def _n_per_unit(self) -> float:
        """The force per raw unit in N. It is unknown without a calibration, and then any count is accepted."""
        if self._scale is None:
            return 1.0 if self.options.unit == "newtons" else 0.0
        return abs(self._scale.newtons_per_count)

    def _newtons(self, value: float) -> float:
        return value * self._n_per_unit if self._scale is None else self._scale.newtons(value)

    def _believable(self, value: float) -> bool:
        """Return whether a sample is plausible.

        Raises:
            RigError: The sample is at the end of the converter's range, or several in a row are implausible.
        """
        counts = self.options.unit == "counts"
        if counts and value in (self.options.low_counts, self.options.high_counts):
            raise RigError(
                f"{self.name}: saturated at {value:.0f} counts; the cell is overloaded or one of its wires is broken"
            )
        beyond = counts and not self.options.low_counts < value < self.options.high_counts
        if not beyond and abs(self._newtons(value)) <= _MAX_N:
            self._beyond = 0
            return True
        self._beyond += 1
        if self._beyond >= _SEVERAL:
            raise RigError(
                f"{self.name}: saturated, {self._beyond} samples in a row like {value:.10g} {self.options.unit}; the "
                "cell is overloaded, one of its wires is broken, or the unit is not " + self.options.unit
            )
        self.count(False, f"{value:.10g}")
        return False

    def _in_doubt(self, samples: list[float]) -> bool:
        """Return whether a third sample has to show which one of two is damaged, or that the cell is stuck."""
        return len(samples) == 2 and not 0.0 < abs(samples[0] - samples[1]) <= self._allowed_off

    @property
    def _allowed_off(self) -> float:
        """The distance from the median, in raw units, within which no sample counts as damaged."""
        return _OFF_N / self._n_per_unit if self._n_per_unit else _OFF_UNITS

    def _without_damaged(self, samples: Floats) -> Floats:
        """Return the samples without those far from the median."""
        off = np.abs(samples - np.median(samples))
        allowed = max(_OFF_TIMES * 1.4826 * float(np.median(off)), self._allowed_off)
        for value in samples[off > allowed]:
            self.count(False, f"{value:.10g}")
        return samples[off <= allowed]


def open_load_cell(port: str, baud: int | None, **settings: Any) -> LoadCell:
    """Open a load cell.

    Args:
        port: The path, name or pyserial URL of the port.
        baud: The baud rate; None for the usual one.
        **settings: See :class:`LoadCell`.

    Raises:
        InputError: The port does not exist.
        RigError: The device sends no valid sample.
    """
    return LoadCell(Line(port, baud=baud or BAUD, what="gauge"), name=f"load cell at {port}", **settings)
