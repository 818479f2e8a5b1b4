"""What GRBL 1.1 and grblHAL send, as values. Pure functions of one line; any text is allowed and never raises.

A line that a disturbed cable has garbled must not pass for a report: states are known words, positions have exactly
three decimals as the firmware prints them, and a report is closed by its bracket.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from tacbench_cad.lab.study.spec import Point

_REPORT = re.compile(r"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep|Tool)(?::(\d{1,2}))?((?:\|[^<>|]*)*)>", re.A)
_NUMBER = r"-?\d{1,6}\.\d{3}"
_POINT = re.compile(rf"(MPos|WPos|WCO):({_NUMBER}),({_NUMBER}),({_NUMBER})(?:,{_NUMBER})*", re.A)
_CODE = re.compile(r"(ALARM|error):(\d{1,3})", re.A)
_SETTING = re.compile(r"\$(\d{1,3})=(-?\d{1,7}(?:\.\d{1,6})?)(?: .*)?", re.A)

#: What alarms mean, in our words.
ALARMS = {
    1: "an end stop was hit",
    2: "a target beyond the firmware's soft limits",
    3: "a reset while moving, so that steps were lost",
    4: "the probe was not in its expected state",
    5: "the probe touched nothing",
    6: "homing was cut short by a reset",
    7: "homing was cut short by the safety door",
    8: "homing could not leave the end stop",
    9: "homing found no end stop",
    10: "homing found no second end stop",
}
#: What errors mean, in our words, as far as a driver's own lines can earn them.
ERRORS = {
    1: "no letter where one was expected",
    2: "a number was unreadable",
    3: "an unknown $ command",
    5: "homing is not enabled ($22=0)",
    7: "the settings' memory could not be read",
    8: "not allowed unless idle",
    9: "locked by an alarm",
    10: "soft limits need homing ($22=1)",
    15: "a target beyond the machine's travel",
    20: "an unknown command",
    22: "no feed rate",
    24: "two commands that exclude each other",
    33: "a target that cannot be reached",
}


@dataclass(frozen=True, kw_only=True)
class Status:
    """A status report.

    Args:
        state: ``Idle``, ``Run``, ``Hold``, ``Jog``, ``Alarm``, ``Door``, ``Check``, ``Home``, ``Sleep`` or ``Tool``.
        detail: The number behind it: 0 of ``Hold:0`` (standing); None if there is none.
        machine_mm: Machine position, if reported.
        work_mm: Work position, if reported in its place.
        offset_mm: Work offset: machine position less work position; only in some reports.
    """

    state: str
    detail: int | None
    machine_mm: Point | None
    work_mm: Point | None
    offset_mm: Point | None


def status(line: str) -> Status | None:
    """The status report that a line is; None if it is none, or damaged."""
    match = _REPORT.fullmatch(line)
    if not match:
        return None
    points: dict[str, Point] = {}
    for part in match[3].split("|")[1:]:
        if part.startswith(("MPos", "WPos", "WCO")):
            point = _POINT.fullmatch(part)
            if not point or point[1] in points:
                return None
            points[point[1]] = (float(point[2]), float(point[3]), float(point[4]))
    if "MPos" not in points and "WPos" not in points:
        return None
    return Status(
        state=match[1],
        detail=int(match[2]) if match[2] else None,
        machine_mm=points.get("MPos"),
        work_mm=points.get("WPos"),
        offset_mm=points.get("WCO"),
    )


def is_banner(line: str) -> bool:
    """Whether a line is what the firmware says after a reset, even with its first bytes lost."""
    return line.lower().startswith("grbl") or "for help]" in line or "to unlock]" in line


def alarm(line: str) -> int | None:
    """Number of the alarm that a line raises; 0 where the number is unreadable; None if it is no alarm."""
    match = _CODE.fullmatch(line)
    if match and match[1] == "ALARM":
        return int(match[2])
    return 0 if line.startswith("ALARM") else None


def error(line: str) -> int | None:
    """Number of the error with which a command was refused; None if the line is none."""
    match = _CODE.fullmatch(line)
    return int(match[2]) if match and match[1] == "error" else None


def is_unreadable(line: str) -> bool:
    """Whether a line refuses a command for its text, so that nothing was done: it may be sent again."""
    number = error(line)
    return number is not None and number not in (9, 15)


def version(line: str) -> str | None:
    """What stands in the ``[VER:...]`` line: ``1.1h.20190825``; None if the line is another."""
    if line.startswith("[VER:") and line.endswith("]"):
        return line[5:-1].strip(":")
    return None


def settings(lines: Iterable[str]) -> dict[int, float]:
    """The ``$number=value`` lines of ``$$``; others are passed over."""
    return {int(match[1]): float(match[2]) for line in lines if (match := _SETTING.fullmatch(line))}
