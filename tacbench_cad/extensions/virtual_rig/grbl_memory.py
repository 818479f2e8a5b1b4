"""GRBL's permanent memory, and the differences of its descendants on the line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tacbench_cad.extensions.virtual_rig.grbl_gcode import GcodeError
from tacbench_cad.extensions.virtual_rig.machine import MotorAxis
from tacbench_cad.lab.study import Point

#: The settings in the order of ``$$``. The flags 20, 21 and 22 are on and the motors stay powered (``$1=255``), as on a
#: stage for pressing. GRBL's own defaults are 0 for the flags and ``$1=25``.
SETTINGS: Mapping[int, float] = {
    0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0, 20: 1, 21: 1, 22: 1, 23: 3,
    24: 100, 25: 1500, 26: 250, 27: 1, 30: 1000, 31: 0, 32: 0, 100: 400, 101: 400, 102: 1600, 110: 3000, 111: 3000,
    112: 900, 120: 200, 121: 200, 122: 100, 130: 200, 131: 200, 132: 100,
}  # fmt: skip
_WHOLE = (0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 32)


@dataclass(frozen=True, kw_only=True)
class FirmwareDialect:
    """The differences between GRBL and its descendants on the line."""

    #: The line after a reset.
    banner: str = "Grbl 1.1h ['$' for help]"
    #: The version in the answer to ``$I``.
    version: str = "1.1h.20190830"
    #: The second line of the answer to ``$I``.
    options: str = "[OPT:VZ,15,128]"
    #: The line of a fresh memory before the banner.
    fresh_memory: str = ""
    #: Whether status requests are answered while an alarm waits for a reset.
    status_in_alarm: bool = False
    #: The pause after an alarm's message in s, during which nothing is read.
    alarm_pause_s: float = 0.5
    #: Whether a reset during motion locks GRBL with ALARM:3.
    abort_alarm: bool = True
    #: The additional fields at the end of each status report.
    more_fields: str = ""
    #: Whether a status report contains the free space of the buffers.
    buffer_field: bool = False
    #: The time from a status request to the report, in s. A second request within it gets no report of its own.
    status_s: float = 0.0005
    #: Whether every line of G-code after a refused line is refused too, until an empty line or a reset.
    refuses_after_error: bool = False
    #: The size of the serial receive buffer, in bytes.
    rx_bytes: int = 128
    #: The time from a reset to the banner, in s.
    boot_s: float = 1.2


#: GRBL 1.1h itself.
GRBL = FirmwareDialect()
#: grblHAL 1.1f answers during ALARM:2, resets in motion without an alarm, stops at an error, reports more, and has
#: larger buffers.
GRBLHAL = FirmwareDialect(
    banner="GrblHAL 1.1f ['$' or '$HELP' for help]",
    version="1.1f.20200818",
    options="[OPT:VNMZSL,35,1024,3,0]",
    fresh_memory="error:7",
    status_in_alarm=True,
    alarm_pause_s=0.0,
    abort_alarm=False,
    more_fields="|A:|H:0|TLR:0",
    buffer_field=True,
    status_s=0.005,
    refuses_after_error=True,
    rx_bytes=1024,
    boot_s=0.3,
)


class Memory:
    """The settings and work offsets.

    Args:
        axes: The axes, whose steps and travel become settings 100 to 102 and 130 to 132.
        changed: Settings that differ from :data:`SETTINGS`.
    """

    def __init__(self, axes: Sequence[MotorAxis], changed: Mapping[int, float]) -> None:
        self._settings: dict[int, float] = {**SETTINGS, **{int(number): value for number, value in changed.items()}}
        for i, axis in enumerate(axes):
            self._settings[100 + i], self._settings[130 + i] = axis.steps_per_mm, axis.travel_mm
        self.offsets: list[Point] = [(0.0, 0.0, 0.0)] * 6
        #: The text of the user in the answer to ``$I``.
        self.text = "SIMULATED"

    def __getitem__(self, number: int) -> float:
        return self._settings[number]

    def store(self, line: str) -> None:
        """Execute a line like ``$20=1``.

        Raises:
            GcodeError: GRBL would refuse the line.
        """
        name, equals, value = line[1:].partition("=")
        if not (equals and name.isascii() and name.isdigit()):
            raise GcodeError(3)
        try:
            number = float(value)
        except ValueError:
            raise GcodeError(2) from None
        if not 0.0 <= number <= 1e7:
            raise GcodeError(4)
        if int(name) not in self._settings:
            raise GcodeError(3)
        if int(name) == 20 and number and not self._settings[22]:
            raise GcodeError(10)
        self._settings[int(name)] = number
        if int(name) == 22 and not number:
            self._settings[20] = 0

    def listed(self) -> str:
        """Return the answer to ``$$``."""
        lines = []
        for number, value in self._settings.items():
            shown = f"{value:.0f}" if number in _WHOLE else f"{value:.3f}"
            lines.append(f"${number}={shown}\r\n")
        return "".join(lines)

    def parameters(self, shift: Point) -> str:
        """Return the answer to ``$#``.

        Args:
            shift: The offset of G92, which is not stored.
        """
        zero = triple((0.0, 0.0, 0.0))
        lines = [f"[G{54 + index}:{triple(offset)}]" for index, offset in enumerate(self.offsets)]
        lines += [f"[G28:{zero}]", f"[G30:{zero}]", f"[G92:{triple(shift)}]", "[TLO:0.000]", f"[PRB:{zero}:0]"]
        return "".join(f"{line}\r\n" for line in lines)


def triple(point: Point) -> str:
    """Return a point as in reports, without a sign before zero."""
    return ",".join(f"{value + 0.0:.3f}" for value in point)
