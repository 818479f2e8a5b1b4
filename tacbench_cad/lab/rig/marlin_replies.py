"""Parsing of Marlin 2's lines, and the checksums of lines sent to it. Any text is accepted as input.

Marlin's lines end in a newline only. Each line sent to it has a number and the exclusive or of its bytes, so Marlin
refuses a garbled line and requests it again.
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Iterable
from dataclasses import dataclass

from tacbench_cad.lab.study.spec import Point

_NUMBER = r"(-?\d{1,6}\.\d{2,4})"
_POSITION = re.compile(
    rf"X:{_NUMBER} Y:{_NUMBER} Z:{_NUMBER}(?: [A-Z]:-?\d{{1,9}}\.\d{{2,4}})*"
    r"(?: Count X: ?(-?\d{1,9}) Y: ?(-?\d{1,9}) Z: ?(-?\d{1,9})(?: .*)?)?",
    re.A,
)
_RESEND = re.compile(r"(?:Resend:|rs) ?N?(\d{1,9})", re.A)
_THREE = re.compile(r"(?:echo:)? *(M\d{2,3}) X(\d{1,6}\.\d+) Y(\d{1,6}\.\d+) Z(\d{1,6}\.\d+)(?: .*)?", re.A)
_UNKNOWN = re.compile(r'(?:echo:)? *Unknown command: *"(.*)"', re.A)
_FIRMWARE = re.compile(r"FIRMWARE_NAME:(\S+)(?: (\S+))?.*", re.A)
_SWITCH = re.compile(r"([xyz])_(min|max): (open|TRIGGERED)", re.A)
_SOFT_ON = re.compile(r"M211 S([01])|[Ss]oft endstops: *(On|ON|Off|OFF)", re.A)
_SOFT_ENDS = re.compile(
    "Min: *"
    + " *".join(rf"{axis}:? ?(-?\d{{1,6}}\.\d+)" for axis in "XYZ")
    + " *Max: *"
    + " *".join(rf"{axis}:? ?(-?\d{{1,6}}\.\d+)" for axis in "XYZ"),
    re.A,
)
_BANNER = re.compile(r"start|(?:echo:)? ?Marlin \S+|.*Last Updated:.*|echo: ?Compiled:.*", re.A)


@dataclass(frozen=True, kw_only=True)
class MarlinPosition:
    """An answer to ``M114``.

    Args:
        planned_mm: The end of the planned motion in mm, with two decimals.
        steps: The position of the motors in steps; None if the build does not report it.
    """

    planned_mm: Point
    steps: tuple[int, int, int] | None


def framed(number: int, command: str) -> bytes:
    """Return a command with number and checksum: ``N3 G28 Z*27`` and a newline."""
    body = f"N{number} {command}".encode("ascii")
    return body + b"*%d\n" % functools.reduce(operator.xor, body)


def place(line: str) -> MarlinPosition | None:
    """Return the position that a line reports; None if it reports none or is damaged."""
    match = _POSITION.fullmatch(line)
    if not match:
        return None
    return MarlinPosition(
        planned_mm=(float(match[1]), float(match[2]), float(match[3])),
        steps=None if match[4] is None else (int(match[4]), int(match[5]), int(match[6])),
    )


def is_ok(line: str) -> bool:
    """Return whether a line acknowledges a command (``ok``, or ``ok`` with the state of the queue)."""
    return line == "ok" or line.startswith("ok ")


def resend(line: str) -> int | None:
    """Return the number of the line that Marlin requests again; None for other lines."""
    match = _RESEND.fullmatch(line)
    return int(match[1]) if match else None


def is_busy(line: str) -> bool:
    """Return whether the firmware reports that it is working. While it waits for a person, it reports ``paused``."""
    return "busy: processing" in line


def is_banner(line: str) -> bool:
    """Return whether the firmware sends this line after a reset."""
    return _BANNER.fullmatch(line) is not None


def is_halted(line: str) -> bool:
    """Return whether the firmware reports a halt. It then stays silent until a reset."""
    return "halted" in line or "kill()" in line


def unknown(line: str) -> str | None:
    """Return the command that Marlin reports as unknown (it still sends ``ok``); None for other lines."""
    match = _UNKNOWN.fullmatch(line)
    return match[1] if match else None


def firmware(line: str) -> str | None:
    """Return name and version from an answer to ``M115``: ``Marlin 2.1.2.7``; None for other lines."""
    match = _FIRMWARE.fullmatch(line)
    if not match:
        return None
    return f"{match[1]} {match[2]}" if match[2] and ":" not in match[2] else match[1]


def per_axis(line: str) -> tuple[str, Point] | None:
    """Return the command and values of a line like ``echo:  M92 X80.00 Y80.00 Z400.00 E93.00``; None for others."""
    match = _THREE.fullmatch(line)
    return (match[1], (float(match[2]), float(match[3]), float(match[4]))) if match else None


def soft_end_stops(lines: Iterable[str]) -> tuple[bool, Point, Point] | None:
    """Return whether soft end stops are on, and the lowest and the highest position, from the answer to ``M211``.

    Marlin 2.0 writes one line, and 2.1 writes two. None if the build has no soft end stops.
    """
    text = " ".join(lines)
    is_on, ends = _SOFT_ON.search(text), _SOFT_ENDS.search(text)
    if is_on is None or ends is None:
        return None
    low_x, low_y, low_z, high_x, high_y, high_z = map(float, ends.groups())
    return (is_on[1] == "1" or str(is_on[2]).lower() == "on", (low_x, low_y, low_z), (high_x, high_y, high_z))


def _switches(lines: Iterable[str]) -> list[tuple[str, int, bool]]:
    """Return axis, direction and state of the end stops in the answer to ``M119``."""
    matches = [_SWITCH.fullmatch(line.strip()) for line in lines]
    return [(match[1], 1 if match[2] == "max" else -1, match[3] == "TRIGGERED") for match in matches if match]


def closed_switches(lines: Iterable[str]) -> set[str]:
    """Return the axes (``x``, ``y``, ``z``) of the closed end stops in the answer to ``M119``."""
    return {axis for axis, _, closed in _switches(lines) if closed}


def homing_directions(lines: Iterable[str]) -> tuple[int, int, int] | None:
    """Return for each axis whether its end stop is at the upper (1) or lower end (-1).

    Returns:
        The directions; None if an axis does not have exactly one end stop.
    """
    found = {axis: direction for axis, direction, _ in _switches(lines)}
    if sorted(axis for axis, _, _ in _switches(lines)) != ["x", "y", "z"]:
        return None
    return (found["x"], found["y"], found["z"])
