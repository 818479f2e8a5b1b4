"""GRBL's interpretation of a line of G-code: the modal state and the checks, with GRBL's own error numbers.

Straight motion, dwell, offsets and the modal words are included. Arcs, probing and stored positions (G2, G3, G28, G30,
G38) are refused as unsupported, since a pressing stage does not need them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from tacbench_cad.extensions.virtual_rig.gcode import words

_MM_PER_INCH = 25.4
#: The supported G and M numbers, by modal group. A line may contain one word of each group.
_GROUPS: dict[str, tuple[str, ...]] = {
    "other": ("G4", "G10", "G53", "G92", "G92.1"),
    "motion": ("G0", "G1", "G80"),
    "plane": ("G17", "G18", "G19"),
    "distance": ("G90", "G91"),
    "feed": ("G94",),
    "units": ("G20", "G21"),
    "system": ("G54", "G55", "G56", "G57", "G58", "G59"),
    "stop": ("M0", "M2", "M30"),
    "spindle": ("M3", "M4", "M5"),
    "coolant": ("M7", "M8", "M9"),
}
_GROUP_OF = {word: group for group, members in _GROUPS.items() for word in members}
#: Words with a value.
_VALUES = "FLNPSTXYZ"


class GcodeError(Exception):
    """A line that GRBL refuses.

    Args:
        code: The number of the error, as in ``error:22``.
    """

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"error:{code}")


@dataclass(frozen=True, kw_only=True)
class Modal:
    """The state that stays from line to line until a reset, as G-code words.

    Args:
        motion: The kind of motion.
        plane: The plane of arcs.
        distance: Absolute or relative targets.
        units: Millimetres or inches.
        system: The work coordinate system.
        spindle: State of the spindle.
        coolant: State of the coolant.
        feed_mm_min: Feed in mm/min.
    """

    motion: str = "G0"
    plane: str = "G17"
    distance: str = "G90"
    units: str = "G21"
    system: str = "G54"
    spindle: str = "M5"
    coolant: str = "M9"
    feed_mm_min: float = 0.0

    @property
    def system_index(self) -> int:
        """The index of the work coordinate system, from 0."""
        return int(self.system[1:]) - 54

    def after(self, commands: Mapping[str, str]) -> Modal:
        """Return the state after a line's commands, by modal group."""
        return replace(self, **{name: word for name, word in commands.items() if hasattr(self, name)})  # type: ignore[arg-type]

    def report(self) -> str:
        """Return the answer to ``$G``."""
        feed = f"{self.feed_mm_min:.0f}"
        inside = (self.motion, self.system, self.plane, self.units, self.distance, "G94", self.spindle, self.coolant)
        return f"[GC:{' '.join(inside)} T0 F{feed} S0]"


@dataclass(frozen=True, kw_only=True)
class GcodeBlock:
    """A checked line.

    Args:
        modal: The modal state after the line.
        action: ``move``, ``dwell``, ``offset``, ``clear``, ``pause``, ``end`` or an empty text.
        rapid: Whether the move uses the axes' own speed.
        machine: Whether the target is in machine coordinates (G53).
        axes: The values of the axes in mm, by axis index.
        values: The other words.
    """

    modal: Modal
    action: str = ""
    rapid: bool = False
    machine: bool = False
    axes: dict[int, float] = field(default_factory=dict)
    values: dict[str, float] = field(default_factory=dict)


def parse(line: str, modal: Modal, *, jog: bool = False) -> GcodeBlock:
    """Check a line against the modal state.

    Args:
        line: The line, upper case, without blanks and comments; for a jog, the part after ``$J=``.
        modal: The state before the line.
        jog: Whether the line is a jog, which does not change the modal state.

    Raises:
        GcodeError: GRBL would refuse the line.
    """
    commands, values = _sort(line)
    if jog and any(group not in ("units", "distance") and word != "G53" for group, word in commands.items()):
        raise GcodeError(16)
    other = commands.get("other", "")
    after = modal.after(commands)
    scale = _MM_PER_INCH if after.units == "G20" else 1.0
    axes = {"XYZ".index(letter): values.pop(letter) * scale for letter in "XYZ" if letter in values}
    if "F" in values:
        after = replace(after, feed_mm_min=values.pop("F") * scale)
    elif jog:
        raise GcodeError(22)
    action, rapid = "", False
    if other == "G4":
        if "P" not in values:
            raise GcodeError(28)
        action = "dwell"
    elif other in ("G10", "G92"):
        if not axes:
            raise GcodeError(26)
        if other == "G10" and (values.get("L") not in (2.0, 20.0) or not 0.0 <= values.get("P", -1.0) <= 6.0):
            raise GcodeError(28 if not {"L", "P"} <= values.keys() else 20)
        if commands.get("motion", "G80") != "G80":
            raise GcodeError(24)
        action = "offset"
    elif other == "G92.1":
        action = "clear"
    elif axes or jog:
        if not axes:
            raise GcodeError(26)
        if after.motion == "G80" and not jog:
            raise GcodeError(31)
        action, rapid = "move", after.motion == "G0" and not jog
        if not rapid and after.feed_mm_min == 0.0:
            raise GcodeError(22)
    if axes and action in ("dwell", "clear"):
        raise GcodeError(36)
    stop = commands.get("stop")
    if stop and not action:
        action = "pause" if stop == "M0" else "end"
    if other in ("G10", "G92"):
        values[other] = 1.0
    return GcodeBlock(modal=after, action=action, rapid=rapid, machine=other == "G53", axes=axes, values=values)


def _sort(line: str) -> tuple[dict[str, str], dict[str, float]]:
    """Return the commands by modal group, and the words with values."""
    line_words = words(line)
    if line_words is None:
        raise GcodeError(1)
    commands: dict[str, str] = {}
    values: dict[str, float] = {}
    if line_words and line_words[-1][1] is None:
        raise GcodeError(2)
    for letter, value in line_words:
        assert value is not None, "only the last word may lack its number"
        if letter in "GM":
            name = f"{letter}{value:g}"
            if name not in _GROUP_OF:
                raise GcodeError(20)
            if _GROUP_OF[name] in commands:
                raise GcodeError(21)
            commands[_GROUP_OF[name]] = name
        elif letter in _VALUES:
            if letter in values:
                raise GcodeError(25)
            if value < 0.0 and letter in "FNPST":
                raise GcodeError(4)
            values[letter] = value
        else:
            raise GcodeError(20)
    return commands, values
