"""Handheld force gauges on a serial port or USB, which answer each question with one value: Mark-10, Sauter, Imada.

Mark-10 (Series 4, 5 and 7): ``?`` asks for the displayed value; the answer is ``4.285 N``, or the number alone. Sauter
(FH, FL): ``9`` asks for the value; the answer is ``0011.70``, where the first digit is the direction (0: compression,
1: tension). Imada (DST): ``D`` asks for the value; the answer is ``+001.17NTO`` with the unit, the mode (T: present
value, P: peak) and the judgement.

Each value was asked for after the request, so nothing has to be discarded. The gauge must show the present value and
not the peak.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.rig import Clock, Closing, Context, Driver, Force, Line, NoAnswerError, RigError, ports
from tacbench_cad.lab.study import GaugeSettings
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError

#: The units of force that a gauge may display, in N.
UNITS_N: Mapping[str, float] = {
    "N": 1.0,
    "mN": 1e-3,
    "kN": 1e3,
    "gF": 9.80665e-3,
    "kgF": 9.80665,
    "lbF": 4.4482216,
    "ozF": 0.27801385,
}
#: The time over which the zero is averaged, in s.
STILL_S = 1.0
#: The number of damaged answers in a row that are an error.
DAMAGED = 3
#: The largest plausible force in N.
MAX_N = 1000.0


@dataclass(frozen=True, kw_only=True)
class GaugeOptions:
    """The options in ``[gauge.options]``.

    Args:
        unit: The displayed unit, if the answers do not contain it.
        compression: The sign of a compression in the answers. It depends on the settings of the gauge.
        least_samples: The smallest number of values for a mean, even if the window is shorter.
    """

    unit: Literal["N", "mN", "kN", "gF", "kgF", "lbF", "ozF"] = "N"
    compression: Literal["positive", "negative"] = "positive"
    least_samples: Annotated[int, Interval(ge=1, le=10_000)] = 3


@dataclass(frozen=True, kw_only=True)
class Make:
    """The protocol of a make of gauges.

    Args:
        name: The make.
        question: The bytes that ask for a value.
        answer: The pattern of an answer, with the groups ``value`` and perhaps ``sign``, ``unit`` and ``mode``.
        baud: The baud rate of a new gauge.
        signs: The signs of a compression and of a tension.
        units: The words for the units in an answer, with the names of :data:`UNITS_N`.
    """

    name: str
    question: bytes
    answer: re.Pattern[bytes]
    baud: int
    signs: Mapping[str, float]
    units: Mapping[str, str]


_SIGNS = {"": 1.0, "+": 1.0, "-": -1.0}
MARK_10 = Make(
    name="mark-10",
    question=b"?\r\n",
    answer=re.compile(rb"(?<![^\r\n])(?P<sign>[+-]?)(?P<value>\d*\.?\d+) *(?P<unit>[A-Za-z]*)\r?\n"),
    baud=115_200,
    signs=_SIGNS,
    units={name.lower(): name for name in UNITS_N},
)
SAUTER = Make(
    name="sauter",
    question=b"9",
    answer=re.compile(rb"(?<![\d.])(?P<sign>[01])(?P<value>(?=[\d.]{6})\d+\.\d+)"),
    baud=9_600,
    signs={"0": 1.0, "1": -1.0},
    units={},
)
IMADA = Make(
    name="imada",
    question=b"D\r",
    answer=re.compile(rb"(?<![^\r\n])(?P<sign>[+-])(?P<value>\d+\.?\d*)(?P<unit>[NKO])(?P<mode>[TP])[LOHE]\r"),
    baud=19_200,
    signs=_SIGNS,
    units={"n": "N", "k": "kgF", "o": "lbF"},
)


class AskedGauge(Closing):
    """A gauge that is asked for each value. See :class:`tacbench_cad.lab.rig.gauge.Gauge`.

    Args:
        port: The path, name or pyserial URL of the port.
        make: The make.
        options: See :class:`GaugeOptions`.
        baud: The baud rate; None for that of a new gauge.
        clock: The rig's time.
        timeout_s: The longest wait for an answer, in s of real time.

    Raises:
        InputError: The port does not exist.
        RigError: The gauge does not answer, or sends other values.
    """

    simulated = ""

    def __init__(
        self,
        port: str,
        make: Make,
        options: GaugeOptions | None = None,
        *,
        baud: int | None = None,
        clock: Clock | None = None,
        timeout_s: float = GaugeSettings.timeout_s,
    ) -> None:
        self.identity = self.name = f"{make.name} gauge at {port}"
        self.calibration: dict[str, object] = {}
        self._make, self._options = make, options or GaugeOptions()
        self._clock, self._timeout_s, self._zero_n = clock or Clock(), timeout_s, 0.0
        self._line = Line(port, baud=baud or make.baud, what="gauge")
        try:
            self._ask()
        except BaseException:
            self.close()
            raise

    def read(self, window_s: float) -> Force:
        """Ask for values until the window has passed, and average them."""
        until_s = self._clock.now_s() + window_s
        values: list[float] = []
        while len(values) < self._options.least_samples or self._clock.now_s() < until_s:
            values.append(self._ask())
        return Force(mean_n=float(np.mean(values)) - self._zero_n, spread_n=float(np.std(values)), samples=len(values))

    def tare(self) -> None:
        """Take the mean over one second as zero. The zero of the gauge itself stays."""
        self._zero_n += self.read(STILL_S).mean_n

    def close(self) -> None:
        """Close the port. Never raises; a second call has no effect."""
        self._line.close()

    def _ask(self) -> float:
        """Ask for one value and return it in N, positive in compression.

        Raises:
            NoAnswerError: The gauge does not answer as its make does.
            RigError: The gauge shows the peak, or the force or its unit is impossible.
            DeviceLostError: The port is gone.
        """
        for _ in range(DAMAGED):
            self._line.forget()
            self._line.write(self._make.question)
            answer = self._line.match(self._make.answer, self._timeout_s)
            if answer is not None:
                return self._value_n(answer)
        raise NoAnswerError(
            f"{self.name}: does not answer as a {self._make.name} gauge does; check that it is on, the baud rate, the "
            "cable and the format of its data"
        )

    def _value_n(self, answer: str) -> float:
        match = self._make.answer.fullmatch(answer.encode("ascii", errors="replace"))
        if match is None:
            raise RigError(f"{self.name}: sends {answer[:40]!r} instead of a force; check the baud rate")
        parts = {name: (value or b"").decode("ascii") for name, value in match.groupdict().items()}
        if parts.get("mode") == "P":
            raise RigError(f"{self.name}: shows the peak; switch it to the present value")
        word = parts.get("unit", "")
        unit = self._make.units.get(word.lower()) if word else self._options.unit
        if unit is None:
            raise RigError(f"{self.name}: shows {word}, which is no unit of force; switch it to N")
        value_n = self._make.signs[parts["sign"]] * float(parts["value"]) * UNITS_N[unit]
        if abs(value_n) > MAX_N:
            raise RigError(f"{self.name}: {value_n:g} N is not possible; set options.unit to the displayed unit")
        return value_n if self._options.compression == "positive" else -value_n


def _driver(make: Make, summary: str) -> Driver:
    def open(settings: GaugeSettings, context: Context) -> AskedGauge:
        if settings.calibration is not None:
            allowed = f"must be left out: a {make.name} gauge sends forces"
            raise InputError("[gauge] calibration", settings.calibration, allowed)
        return AskedGauge(
            ports.resolve(settings.port, "gauge", taken=context.taken),
            make,
            from_plain(GaugeOptions, dict(settings.options), "[gauge.options] "),
            baud=settings.baud,
            clock=context.clock,
            timeout_s=settings.timeout_s,
        )

    return Driver(open=open, summary=summary, connection="serial port", modules=("serial",))


MARK_10_DRIVER = _driver(MARK_10, "Mark-10 force gauges, Series 4, 5 and 7")
SAUTER_DRIVER = _driver(SAUTER, "Sauter force gauges FH and FL")
IMADA_DRIVER = _driver(IMADA, "Imada force gauges DST")
