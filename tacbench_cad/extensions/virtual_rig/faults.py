"""Faults for a virtual rig: on the line, in the firmware, in the motors and in the load cell."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from annotated_types import Ge, Interval

from tacbench_cad.util.convert import check_fields, from_plain
from tacbench_cad.util.errors import InputError, located

#: Faults of single bytes on a line.
BYTE_KINDS = ("drop", "double", "garble", "silence")
#: Faults of the load cell.
GAUGE_KINDS = ("noise", "stuck", "saturated")
#: All faults.
KINDS = (*BYTE_KINDS, "reset", "alarm", "unplug", "slip", "stall", "switch", *GAUGE_KINDS)
Seconds = Annotated[float, Ge(0.0)]
Count = Annotated[int, Ge(0)]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault.

    Args:
        kind: ``drop``, ``double``, ``garble`` (bytes on the line); ``silence`` (no bytes in either direction);
            ``reset`` (the board's button); ``alarm`` (an end stop; with Marlin and Arduino a halt); ``unplug`` (the
            port closes and returns after ``seconds``); ``slip`` (the carriage jumps by ``mm`` without the firmware's
            knowledge); ``stall`` (a motor does not turn); ``switch`` (an end stop stays closed); ``noise``, ``stuck``,
            ``saturated`` (the load cell).
        at_s: The rig time at which the fault begins, from the start.
        after_bytes: The number of bytes from the host after which it begins. Without ``at_s`` and ``after_bytes``, it
            begins at once.
        seconds: Its duration in rig time; None for ever. A slip, a reset and an alarm occur once.
        count: The number of affected bytes. The default is one, or all of them if ``seconds`` or ``chance`` is given.
        chance: The probability that a byte is affected.
        direction: ``in`` (to the device), ``out`` (from it) or ``both``.
        where: The line, or the unplugged port: ``stage`` or ``gauge``.
        axis: The motor or end stop: ``x``, ``y`` or ``z``.
        mm: The length of a slip in mm.
        n: The standard deviation of the load cell's additional noise, in N.
    """

    kind: Literal[KINDS]  # type: ignore[valid-type]
    at_s: Seconds | None = None
    after_bytes: Count | None = None
    seconds: Seconds | None = None
    count: Count | None = None
    chance: Annotated[float, Interval(ge=0.0, le=1.0)] | None = None
    direction: Literal["in", "out", "both"] = "out"
    where: Literal["stage", "gauge"] = "stage"
    axis: Literal["x", "y", "z"] = "z"
    mm: float = 0.5
    n: Annotated[float, Ge(0.0)] = 0.5

    def __post_init__(self) -> None:
        with located("fault "):
            check_fields(self)
        if self.at_s is not None and self.after_bytes is not None:
            raise InputError("fault", self.kind, "give at_s or after_bytes, not both")
        if self.after_bytes is not None and self.of_gauge:
            raise InputError("fault after_bytes", self.after_bytes, "the load cell receives no bytes; give at_s")

    @property
    def of_gauge(self) -> bool:
        """Whether the fault affects the load cell."""
        return self.where == "gauge" or self.kind in GAUGE_KINDS

    @property
    def bytes_hit(self) -> float:
        """The largest number of affected bytes."""
        if self.kind == "silence":
            return math.inf
        if self.count is not None:
            return self.count
        return 1 if self.seconds is None and self.chance is None else math.inf

    @classmethod
    def of(cls, given: Fault | Mapping[str, Any] | str) -> Fault:
        """Return the fault itself, or create it from its plain values or its text."""
        if isinstance(given, Fault):
            return given
        return cls.parse(given) if isinstance(given, str) else from_plain(cls, given, "fault ")

    @classmethod
    def parse(cls, text: str) -> Fault:
        """Parse a fault that is written as ``drop at_s=12 count=3 direction=in``.

        Raises:
            InputError: The text is not a valid fault.
        """
        kind, *rest = text.split() or [""]
        return from_plain(cls, {"kind": kind, **settings_of(rest)}, "fault ")


def settings_of(words: Iterable[str]) -> dict[str, Any]:
    """Parse settings that are written as ``key=value``; numbers are converted if possible.

    Raises:
        InputError: A setting has no equals sign.
    """
    values: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise InputError("setting", word, "must be key=value")
        values[key] = _number(value)
    return values


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


class Spoiler:
    """Applies faults to the bytes of one line.

    Args:
        random_: The source of randomness.
    """

    def __init__(self, random_: random.Random) -> None:
        self._random = random_
        self._active: list[_Active] = []

    def add(self, fault: Fault, now_s: float) -> None:
        """Begin a fault that affects bytes."""
        until = math.inf if fault.seconds is None else now_s + fault.seconds
        self._active.append(_Active(fault=fault, until_s=until, left=fault.bytes_hit))

    def spoil(self, data: bytes, direction: str, now_s: float) -> bytes:
        """Return the bytes that arrive when bytes are sent.

        Args:
            data: The bytes.
            direction: ``in`` or ``out``.
            now_s: The rig time.
        """
        if not self._active:
            return data
        self._active = [active for active in self._active if active.left > 0 and now_s < active.until_s]
        for active in self._active:
            if active.fault.kind == "silence" or active.fault.direction in (direction, "both"):
                data = self._apply(active, data)
        return data

    def _apply(self, active: _Active, data: bytes) -> bytes:
        result = bytearray()
        chance = 1.0 if active.fault.chance is None else active.fault.chance
        for byte in data:
            if active.left <= 0 or self._random.random() >= chance:
                result.append(byte)
                continue
            active.left -= 1
            if active.fault.kind == "double":
                result += bytes((byte, byte))
            elif active.fault.kind == "garble":
                # At least one bit changes, so a garbled byte always differs.
                result.append(byte ^ self._random.randint(1, 255))
        return bytes(result)


@dataclass(kw_only=True)
class _Active:
    fault: Fault
    until_s: float
    left: float
