"""Faults that a virtual rig can be given: on the wire, in the firmware, in the motors and in the load cell."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

from tacbench_cad.util.errors import InputError, nearest, one_of

#: Faults of single bytes on a line, of the load cell, and all.
BYTE_KINDS = ("drop", "double", "garble", "silence")
#: Faults of the load cell.
GAUGE_KINDS = ("noise", "stuck", "saturated")
#: All faults.
KINDS = (*BYTE_KINDS, "reset", "alarm", "unplug", "slip", "stall", *GAUGE_KINDS)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault.

    Args:
        kind: ``drop``, ``double``, ``garble`` (bytes on the line); ``silence`` (nothing comes or goes); ``reset`` (the
            board's button); ``alarm`` (an end stop; on Marlin and Arduino a halt); ``unplug`` (the port closes, and
            comes back after ``seconds``); ``slip`` (the carriage jumps by ``mm``, the firmware doesn't know);
            ``stall`` (a motor does not turn); ``noise``, ``stuck``, ``saturated`` (the load cell).
        at_s: Rig time from the start at which it begins.
        after_bytes: It begins when so many bytes have come from the host; with neither, at once.
        seconds: How long it lasts, in rig time; None for good. A slip, a reset and an alarm happen once.
        count: How many bytes are hit before it is over; by default one, or all of them where ``seconds`` or ``chance``
            is given.
        chance: Probability with which each byte is hit.
        direction: ``in`` (to the device), ``out`` (from it) or ``both``.
        where: ``stage`` or ``gauge``: which line, or which port is unplugged.
        axis: ``x``, ``y`` or ``z``: which motor.
        mm: Length of a slip.
        n: Standard deviation of the load cell's added noise in newtons.
    """

    kind: str
    at_s: float | None = None
    after_bytes: int | None = None
    seconds: float | None = None
    count: int | None = None
    chance: float | None = None
    direction: Literal["in", "out", "both"] = "out"
    where: Literal["stage", "gauge"] = "stage"
    axis: Literal["x", "y", "z"] = "z"
    mm: float = 0.5
    n: float = 0.5

    def __post_init__(self) -> None:
        one_of("fault", self.kind, KINDS)
        one_of("fault direction", self.direction, ("in", "out", "both"))
        one_of("fault where", self.where, ("stage", "gauge"))
        one_of("fault axis", self.axis, ("x", "y", "z"))
        for name in ("at_s", "seconds", "chance", "mm", "n"):
            value = getattr(self, name)
            if value is not None and (
                isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value)
            ):
                raise InputError(f"fault {name}", value, "must be a number")
        for name in ("at_s", "seconds", "n"):
            value = getattr(self, name)
            if value is not None and value < 0.0:
                raise InputError(f"fault {name}", value, "must not be negative")
        for name in ("after_bytes", "count"):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
                raise InputError(f"fault {name}", value, "must be a whole number, 0 or more")
        if self.chance is not None and not 0.0 <= self.chance <= 1.0:
            raise InputError("fault chance", self.chance, "must be from 0 to 1")
        if self.at_s is not None and self.after_bytes is not None:
            raise InputError("fault", self.kind, "give at_s or after_bytes, not both")
        if self.after_bytes is not None and self.of_gauge:
            raise InputError("fault after_bytes", self.after_bytes, "the load cell receives no bytes; give at_s")

    @property
    def of_gauge(self) -> bool:
        """Whether it befalls the load cell."""
        return self.where == "gauge" or self.kind in GAUGE_KINDS

    @property
    def bytes_hit(self) -> float:
        """How many bytes it hits at most."""
        if self.kind == "silence":
            return math.inf
        if self.count is not None:
            return self.count
        return 1 if self.seconds is None and self.chance is None else math.inf

    def as_dict(self) -> dict[str, Any]:
        """Plain values; only those that are set."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Fault:
        """The fault again from plain values.

        Raises:
            InputError: A key is unknown or a value wrong.
        """
        known = {one.name for one in fields(cls)}
        for key in values:
            if key not in known:
                raise InputError("fault", key, nearest(str(key), known))
        if "kind" not in values:
            raise InputError("fault", None, f"kind is missing; one of {', '.join(KINDS)}")
        return cls(**values)

    @classmethod
    def of(cls, given: Fault | Mapping[str, Any] | str) -> Fault:
        """The fault, from its plain values or its text as well."""
        if isinstance(given, Fault):
            return given
        return cls.parse(given) if isinstance(given, str) else cls.from_dict(given)

    @classmethod
    def parse(cls, text: str) -> Fault:
        """A fault written as ``drop at_s=12 count=3 direction=in``.

        Raises:
            InputError: It cannot be read.
        """
        kind, *rest = text.split() or [""]
        return cls.from_dict({"kind": kind, **settings_of(rest)})


def settings_of(words: Iterable[str]) -> dict[str, Any]:
    """Values written as ``key=value``; numbers where they can be.

    Raises:
        InputError: One has no equals sign.
    """
    values: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise InputError("setting", word, "write key=value")
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
    """Spoils the bytes of one line.

    Args:
        random_: Source of chance.
    """

    def __init__(self, random_: random.Random) -> None:
        self._random = random_
        self._active: list[_Active] = []

    def add(self, fault: Fault, now_s: float) -> None:
        """Begin a fault of bytes."""
        until = math.inf if fault.seconds is None else now_s + fault.seconds
        self._active.append(_Active(fault=fault, until_s=until, left=fault.bytes_hit))

    def spoil(self, data: bytes, direction: str, now_s: float) -> bytes:
        """What arrives of the bytes that were sent.

        Args:
            data: The bytes.
            direction: ``in`` or ``out``.
            now_s: Rig time.
        """
        if not self._active:
            return data
        self._active = [one for one in self._active if one.left > 0 and now_s < one.until_s]
        for one in self._active:
            if one.fault.kind == "silence" or one.fault.direction in (direction, "both"):
                data = self._apply(one, data)
        return data

    def _apply(self, one: _Active, data: bytes) -> bytes:
        made = bytearray()
        chance = 1.0 if one.fault.chance is None else one.fault.chance
        for byte in data:
            if one.left <= 0 or self._random.random() >= chance:
                made.append(byte)
                continue
            one.left -= 1
            if one.fault.kind == "double":
                made += bytes((byte, byte))
            elif one.fault.kind == "garble":
                # One bit or several, never none: a garbled byte differs.
                made.append(byte ^ self._random.randint(1, 255))
        return bytes(made)


@dataclass(kw_only=True)
class _Active:
    fault: Fault
    until_s: float
    left: float
