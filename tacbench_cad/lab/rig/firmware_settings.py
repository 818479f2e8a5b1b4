"""Settings of a stage's firmware, compared with what a press rig and its study file need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tacbench_cad.lab.study.spec import Point, StageSettings

#: The coarsest step of the z axis, in mm, that reaches the paper's narrowest force band.
COARSEST_Z_MM = 0.005
#: The acceleration, in mm/s^2, below which short steps take much longer than their speed explains.
SLOW_MM_S2 = 50.0
#: GRBL's own steps per mm, which few machines have.
GRBL_STEPS_PER_MM = 250.0
#: The smallest distance by which homing should move away from a switch, in mm.
MIN_PULL_OFF_MM = 0.5


@dataclass(frozen=True, kw_only=True)
class FirmwareSetting:
    """One setting of a firmware.

    Args:
        name: Its name in the firmware: ``$1``, ``M211``.
        value: Its value, as text.
        meaning: What it sets, with the unit.
        change: The command that sets the needed value. Empty: nothing needs to be changed.
        reason: Why it should be changed, or what to check by hand; empty if it is right.
    """

    name: str
    value: str
    meaning: str
    change: str = ""
    reason: str = ""


def grbl_settings(
    values: Mapping[int, float], *, counts_from_switch: bool | None, stage: StageSettings | None = None
) -> tuple[FirmwareSetting, ...]:
    """Compare the settings of GRBL or grblHAL with those of a press rig.

    Args:
        values: The numbered settings.
        counts_from_switch: Whether the coordinates count from the switches, as in GRBL's default build, or from the
            position after homing; None if unknown.
        stage: The table ``[stage]`` of the study file, if there is one.
    """
    rows: list[FirmwareSetting] = []

    def add(number: int, meaning: str, *, change: str = "", reason: str = "") -> None:
        value = values.get(number)
        shown = "unknown" if value is None else f"{value:g}"
        rows.append(FirmwareSetting(name=f"${number}", value=shown, meaning=meaning, change=change, reason=reason))

    def require(number: int, meaning: str, is_right: bool, needed: float, reason: str) -> None:
        if is_right:
            add(number, meaning)
        else:
            add(number, meaning, change=f"${number}={needed:g}", reason=reason)

    for number, (meaning, needed, reason) in _GRBL_NEEDS.items():
        value = values.get(number)
        if number in _FLAGS:  # grblHAL's own options in the other bits are kept
            value, needed = value and float(int(value) & 1), float(int(value or 0) | 1)
        require(number, meaning, value == (1.0 if number in _FLAGS else needed), needed, reason)
    inverted, pull_off_mm = int(values.get(23, 0.0)), values.get(27, 0.0)
    upwards = "z must be homed upwards, because homing lifts the sensor after an alarm"
    require(23, "directions of homing", not inverted & 4, inverted & ~4, upwards)
    clear = "the switches must be open after homing"
    require(27, "distance from the switches after homing, in mm", pull_off_mm >= MIN_PULL_OFF_MM, 1.0, clear)
    needed = 0.0 if stage is None else 60.0 * stage.travel_mm_s
    slow = f"moves are slower than [stage] travel_mm_s, {needed:g} mm/min; raise it if the motor can do it"
    short = "short steps take long; raise it to 100 if the motor can do it"
    for first, meaning, reason_of in (
        (100, "motor steps per mm of {}", _steps_reason),
        (110, "largest speed of {}, in mm/min", lambda axis, speed: slow if speed < needed else ""),
        (120, "acceleration of {}, in mm/s2", lambda axis, value: short if value < SLOW_MM_S2 else ""),
        (
            130,
            "travel of {}, in mm",
            lambda axis, travel_mm: _limits_reason(axis, travel_mm, pull_off_mm, counts_from_switch, stage),
        ),
    ):
        for axis, letter in enumerate("xyz"):
            reason = reason_of(axis, values.get(first + axis, 0.0))
            add(first + axis, meaning.format(letter), reason=reason)
    return tuple(rows)


def marlin_settings(
    *,
    steps_per_mm: Point | None,
    speeds_mm_s: Point | None,
    soft_end_stops: tuple[bool, Point, Point] | None,
    stage: StageSettings | None = None,
) -> tuple[FirmwareSetting, ...]:
    """Compare the settings of Marlin with those of a press rig.

    Args:
        steps_per_mm: The motor steps per mm (``M92``); None if they are not reported, as for the next two.
        speeds_mm_s: The largest speeds (``M203``).
        soft_end_stops: Whether the soft end stops are on, and the lowest and highest position (``M211``).
        stage: The table ``[stage]`` of the study file, if there is one.
    """
    rows: list[FirmwareSetting] = []

    def add(name: str, value: str, meaning: str, reason: str = "", change: str = "") -> None:
        rows.append(FirmwareSetting(name=name, value=value, meaning=meaning, change=change, reason=reason))

    if soft_end_stops is not None and soft_end_stops[0]:
        add("M211", "on", "soft end stops")
    else:
        value = "unknown" if soft_end_stops is None else "off"
        add("M211", value, "soft end stops", "a wrong target must not reach an end of the travel", "M211 S1")
    for axis, letter in enumerate("xyz"):
        if soft_end_stops is not None:
            low, high = soft_end_stops[1][axis], soft_end_stops[2][axis]
            meaning = f"soft end stops of {letter}, in mm"
            add(f"M211 {letter.upper()}", f"{low:g} to {high:g}", meaning, _outside_reason(axis, low, high, stage))
    for axis, letter in enumerate("xyz"):
        if steps_per_mm is not None:
            value, reason = f"{steps_per_mm[axis]:g}", _steps_reason(axis, steps_per_mm[axis])
            add(f"M92 {letter.upper()}", value, f"motor steps per mm of {letter}", reason)
    for axis, letter in enumerate("xyz"):
        if speeds_mm_s is not None:
            needed = 0.0 if stage is None else stage.travel_mm_s
            slow = f"moves are slower than [stage] travel_mm_s, {needed:g} mm/s; raise it if the motor can do it"
            reason = slow if speeds_mm_s[axis] < needed else ""
            add(f"M203 {letter.upper()}", f"{speeds_mm_s[axis]:g}", f"largest speed of {letter}, in mm/s", reason)
    return tuple(rows)


#: The settings whose bit 0 switches something on. Their other bits are options of grblHAL: ``$22=3`` has homing, too.
_FLAGS = (20, 21, 22)
#: The meaning, the needed value and the reason of settings that have one right value.
_GRBL_NEEDS: Mapping[int, tuple[str, float, str]] = {
    1: ("time until the motors lose their power, in ms; 255: never", 255, "the sensor must not press without power"),
    13: ("reports in inches", 0, "the driver needs millimetres"),
    22: ("homing", 1, "the position is unknown without homing; send this before $20"),
    20: ("soft limits", 1, "a wrong target must not reach an end of the travel"),
    21: ("end stops stop every move", 1, "a motor that lost steps must not run into the frame of the machine"),
}


def _steps_reason(axis: int, steps_per_mm: float) -> str:
    """Return what to check about the steps per mm of an axis."""
    if steps_per_mm == GRBL_STEPS_PER_MM:
        return "this is GRBL's default; move 50 mm and measure the distance"
    if axis == 2 and 0.0 < steps_per_mm < 1.0 / COARSEST_Z_MM:
        return f"a step of {1000.0 / steps_per_mm:.1f} micrometres is too coarse for the lightest force"
    return ""


def _outside_reason(axis: int, low_mm: float, high_mm: float, stage: StageSettings | None) -> str:
    """Return how limits_mm of an axis reach beyond soft end stops; empty if they do not."""
    if stage is None or low_mm <= stage.limits_mm[axis][0] <= stage.limits_mm[axis][1] <= high_mm:
        return ""
    low, high = stage.limits_mm[axis]
    return f"[stage] limits_mm of {'xyz'[axis]} are [{low:g}, {high:g}], beyond the soft end stops; shorten them"


def _limits_reason(
    axis: int, travel_mm: float, pull_off_mm: float, counts_from_switch: bool | None, stage: StageSettings | None
) -> str:
    """Return how limits_mm of an axis disagree with the travel; empty if they agree or are unknown."""
    if stage is None:
        return ""
    low, high = stage.limits_mm[axis]
    shown = f"[stage] limits_mm of {'xyz'[axis]} are [{low:g}, {high:g}]"
    if high - low > travel_mm:
        return f"{shown}, longer than the travel; enter the real travel here or shorten the limits"
    if counts_from_switch and not -travel_mm <= low <= high <= 0.0:
        return f"{shown}, but this build allows only {-travel_mm:g} to 0"
    if counts_from_switch and axis == 2 and high > -pull_off_mm:
        return f"{shown}; the end stop closes at 0, so end them at {-pull_off_mm:g}"
    return ""
