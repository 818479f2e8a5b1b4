"""Parsing of the lines of GRBL 1.1 and grblHAL. The functions are pure, accept any text, and never raise.

A line that was garbled by a disturbed cable must not count as a report. Therefore states must be known words, positions
must have exactly three decimals, as the firmware prints them, and a report must end with its bracket.
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
_TEXT = re.compile(r"\[[ -~]*\]|>[ -~]*|\$N\d=[ -~]*|[Gg]rbl[ -~]*", re.A)
_SETTING = re.compile(r"\$(\d{1,3})=(-?\d{1,7}(?:\.\d{1,6})?)(?: .*)?", re.A)

#: The meanings of alarms, in our own words.
ALARMS = {
    1: "an end stop was hit",
    2: "the target was beyond the firmware's soft limits",
    3: "a reset during motion, so steps were lost",
    4: "the probe was not in its expected state",
    5: "the probe made no contact",
    6: "a reset interrupted homing",
    7: "the safety door interrupted homing",
    8: "homing could not leave the end stop",
    9: "homing found no end stop",
    10: "homing found no second end stop",
}
#: The meanings of those errors that a driver's own lines can cause, in our own words.
ERRORS = {
    1: "a letter was expected",
    2: "a number was unreadable",
    3: "unknown $ command",
    5: "homing is not enabled ($22=0)",
    7: "the settings' memory could not be read",
    8: "allowed only when idle",
    9: "locked by an alarm",
    10: "soft limits need homing ($22=1)",
    15: "the target is beyond the machine's travel",
    20: "unknown command",
    22: "no feed rate",
    24: "two commands that exclude each other",
    33: "the target cannot be reached",
}


@dataclass(frozen=True, kw_only=True)
class Status:
    """A status report.

    Args:
        state: ``Idle``, ``Run``, ``Hold``, ``Jog``, ``Alarm``, ``Door``, ``Check``, ``Home``, ``Sleep`` or ``Tool``.
        detail: The number after the state: 0 for ``Hold:0`` (standing still); None if there is none.
        machine_mm: The machine position; None if the work position is reported instead.
        pins: The closed inputs: ``XZ`` if the end stops of x and z are closed.
    """

    state: str
    detail: int | None
    machine_mm: Point | None
    pins: str = ""


def status(line: str) -> Status | None:
    """Return the status report in a line; None if the line is not a report or is damaged."""
    match = _REPORT.fullmatch(line)
    if not match:
        return None
    points: dict[str, Point] = {}
    pins = ""
    for part in match[3].split("|")[1:]:
        if part.startswith(("MPos", "WPos", "WCO")):
            point = _POINT.fullmatch(part)
            if not point or point[1] in points:
                return None
            points[point[1]] = (float(point[2]), float(point[3]), float(point[4]))
        elif part.startswith("Pn:"):
            pins = part[3:]
    if "MPos" not in points and "WPos" not in points:
        return None
    return Status(
        state=match[1],
        detail=int(match[2]) if match[2] else None,
        machine_mm=points.get("MPos"),
        pins=pins,
    )


def is_banner(line: str) -> bool:
    """Return whether the firmware sends this line after a reset. The first bytes of the line may be lost."""
    return line.lower().startswith("grbl") or "for help]" in line or "to unlock]" in line


def is_hint(line: str) -> bool:
    """Return whether the firmware sends this line after its banner."""
    return line.startswith("[MSG:") or "to unlock]" in line


def is_limit(line: str) -> bool:
    """Return whether the firmware reports a closed end stop after its banner."""
    return "Check Limits" in line


def is_known(line: str) -> bool:
    """Return whether a line, other than a report, has a form that the firmware sends."""
    return line == "ok" or bool(_CODE.fullmatch(line) or _SETTING.fullmatch(line) or _TEXT.fullmatch(line))


def alarm(line: str) -> int | None:
    """Return the number of the alarm in a line; 0 if the number is unreadable; None if the line is not an alarm."""
    match = _CODE.fullmatch(line)
    if match and match[1] == "ALARM":
        return int(match[2])
    return 0 if line.startswith("ALARM") else None


def error(line: str) -> int | None:
    """Return the number of the error with which a command was refused; None if the line is not an error."""
    match = _CODE.fullmatch(line)
    return int(match[2]) if match and match[1] == "error" else None


def is_unreadable(line: str) -> bool:
    """Return whether a command was refused for its text and not executed, so that it may be sent again."""
    number = error(line)
    return number is not None and number not in (9, 15)


def version(line: str) -> str | None:
    """Return the version in a ``[VER:...]`` line: ``1.1h.20190825``; None for other lines."""
    if line.startswith("[VER:") and line.endswith("]"):
        return line[5:-1].strip(":")
    return None


def options(line: str) -> str | None:
    """Return the letters of the build's options in an ``[OPT:...]`` line; None for other lines."""
    if line.startswith("[OPT:") and line.endswith("]"):
        return line[5:-1].split(",")[0]
    return None


def settings(lines: Iterable[str]) -> dict[int, float]:
    """Return the numbers and values of the ``$number=value`` lines of ``$$``; other lines are ignored."""
    return {int(match[1]): float(match[2]) for line in lines if (match := _SETTING.fullmatch(line))}
