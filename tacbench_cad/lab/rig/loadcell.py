"""A load cell that sends a line a sample over serial: raw counts, which need a calibration, or newtons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from tacbench_cad.lab.rig.calibration import Calibration
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import GaugeError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.samples import BAUD, SampleStream, StuckSamples, require_stuck_samples
from tacbench_cad.lab.study.spec import GaugeSettings
from tacbench_cad.util.convert import Bounds, check_fields, from_plain, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: A sample further from zero is no force of this rig: a damaged line, or a saturated cell if several come in a row.
_MAX_N = 100.0
_SEVERAL = 5
#: A sample is damaged if it lies this many standard deviations (from the median absolute deviation) off the median ...
_OFF_TIMES = 10.0
#: ... and further than this, in newtons (motion within a window is slower), or in raw units without a calibration.
_OFF_N = 0.005
_OFF_UNITS = 10.0
#: Time over which a tare and a calibration point are averaged, in seconds.
STILL_S = 1.0


@dataclass(frozen=True, kw_only=True)
class LoadCellOptions:
    """What ``[gauge.options]`` says of a load cell.

    Args:
        unit: ``counts`` or ``newtons``.
        columns: Numbers on a line.
        column: Which of them is the force, from 1.
        low_counts: Counts at which the converter is saturated: by default those of the usual 24 bits (HX711, ADS1232).
        high_counts: Likewise.
        stuck_samples: So many identical samples in a row mean that the cell is stuck; 0 switches the check off, for a
            device that rounds its noise away.
        least_samples: Samples that a mean needs at least, however short the window.
        latency_s: Rig time for which samples may lie in the USB adapter: what comes within it was taken before.
    """

    unit: Literal["counts", "newtons"] = "counts"
    columns: Annotated[int, Bounds(1, 1000)] = 1
    column: Annotated[int, Bounds(1, 1000)] = 1
    low_counts: float = float(-(2**23))
    high_counts: float = float(2**23 - 1)
    stuck_samples: StuckSamples = 20
    least_samples: Annotated[int, Bounds(1, 10_000)] = 3
    latency_s: Annotated[float, Bounds(0.0, 1.0)] = 0.02

    def __post_init__(self) -> None:
        check_fields(self)
        if self.column > self.columns:
            raise InputError("column", self.column, f"must be from 1 to {self.columns}, the numbers on a line")
        if not self.low_counts < self.high_counts:
            raise InputError("low_counts", self.low_counts, "must be below high_counts")
        require_stuck_samples(self.stuck_samples)

    @classmethod
    def of(cls, values: Mapping[str, Any], *, calibrated: bool) -> LoadCellOptions:
        """Read the keys of ``[gauge.options]``.

        Args:
            values: The table.
            calibrated: Whether the gauge has a calibration; lines are raw counts if it has, else newtons.

        Raises:
            InputError: A key is unknown, or its value is not allowed.
        """
        options = from_plain(cls, {"unit": "counts" if calibrated else "newtons", **values}, "[gauge.options] ")
        if (options.unit == "counts") != calibrated:
            wrong = "needs [gauge] calibration; `tacbench rig calibrate-force` writes one"
            raise InputError(
                "[gauge.options] unit", options.unit, "is calibrated already: no calibration" if calibrated else wrong
            )
        return options


@dataclass(frozen=True, kw_only=True)
class RawMean:
    """Raw samples of a still load cell.

    Args:
        mean: Their mean, in counts or newtons.
        spread: Their standard deviation (ddof 0).
        samples: How many there were.
    """

    mean: float
    spread: float
    samples: int


class LoadCell(SampleStream):
    """A load cell as a :class:`tacbench_cad.lab.rig.gauge.Gauge`, looked at for what no living cell sends.

    Args:
        lines: The port.
        name: What it is, for the messages.
        options: How its lines read.
        clock: The rig's time.
        timeout_s: Longest real time to wait for a sample.
        calibration: Its calibration; None where it sends newtons, or is about to be calibrated.
        calibration_name: The calibration's file name, for ``run.json``.
        simulated: What of it is simulated, or an empty text.

    Raises:
        RigError: Nothing that is a sample comes.
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
        # A simulated one gets another port each time it is started.
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
            error=GaugeError,
            stuck_samples=options.stuck_samples,
            watched=options.column,
        )
        self.wait_for_start()

    def mean(self, window_s: float) -> RawMean:
        """Average the samples that arrive during a window that begins now.

        Samples far off the others' median are damaged lines (a lost digit still reads as a number): they are left
        out and counted as garbled.

        Args:
            window_s: Rig time.

        Raises:
            GaugeError: Stuck, saturated, or too many garbled lines.
            RigError: Lost or silent.
        """
        self.start_fresh(self.options.latency_s / self._clock.speed)
        until = self._clock.now_s() + window_s
        samples: list[float] = []
        while len(samples) < self.options.least_samples or self._clock.now_s() < until:
            value = self.next()[self.options.column - 1]
            if self._believable(value):
                samples.append(value)
        kept = self._without_damaged(np.array(samples))
        return RawMean(mean=float(kept.mean()), spread=float(kept.std()), samples=len(kept))

    def read(self, window_s: float) -> Force:
        """See :class:`tacbench_cad.lab.rig.gauge.Gauge`."""
        raw = self.mean(window_s)
        spread_n = raw.spread * self._n_per_unit
        return Force(mean_n=self._newtons(raw.mean) - self._zero_n, spread_n=spread_n, samples=raw.samples)

    def tare(self) -> None:
        """Take the mean of a second as zero."""
        self._zero_n += self.read(STILL_S).mean_n

    @property
    def _n_per_unit(self) -> float:
        """Newtons that a raw unit stands for; before a calibration nobody knows, and any count is believed."""
        if self._scale is None:
            return 1.0 if self.options.unit == "newtons" else 0.0
        return abs(self._scale.newtons_per_count)

    def _newtons(self, value: float) -> float:
        return value * self._n_per_unit if self._scale is None else self._scale.newtons(value)

    def _believable(self, value: float) -> bool:
        """Whether a sample can be true.

        Raises:
            GaugeError: It is at the converter's end, or one of several in a row that are no force.
        """
        counts = self.options.unit == "counts"
        if counts and value in (self.options.low_counts, self.options.high_counts):
            raise GaugeError(
                f"{self.name}: saturated at {value:.0f} counts: overloaded, or a wire of the cell is broken"
            )
        beyond = counts and not self.options.low_counts < value < self.options.high_counts
        if not beyond and abs(self._newtons(value)) <= _MAX_N:
            self._beyond = 0
            return True
        self._beyond += 1
        if self._beyond >= _SEVERAL:
            raise GaugeError(
                f"{self.name}: saturated, {self._beyond} samples in a row such as {value:.10g} {self.options.unit}: "
                "overloaded, a wire of the cell is broken, or these are no " + self.options.unit
            )
        self.count(False, f"{value:.10g}")
        return False

    def _without_damaged(self, samples: Floats) -> Floats:
        """The samples but for those far off."""
        floor = _OFF_N / self._n_per_unit if self._n_per_unit else _OFF_UNITS
        off = np.abs(samples - np.median(samples))
        allowed = max(_OFF_TIMES * 1.4826 * float(np.median(off)), floor)
        for value in samples[off > allowed]:
            self.count(False, f"{value:.10g}")
        return samples[off <= allowed]


def open_load_cell(port: str, baud: int | None, **settings: Any) -> LoadCell:
    """Open a load cell.

    Args:
        port: Path, name or pyserial URL.
        baud: Symbols per second; None for the usual rate.
        **settings: See :class:`LoadCell`.

    Raises:
        InputError: There is no such port.
        RigError: Nothing that is a sample comes.
    """
    return LoadCell(Line(port, baud=baud or BAUD, what="gauge"), name=f"load cell at {port}", **settings)
