"""The limits of a print's deviations, and the verdict.

The defaults are what the sensor and the holder notice. A deviation is felt if it moves the pins of a TacTip by more
than their position varies without motion (:mod:`tacbench_cad.spec.skin`). A block with walls that stick out by more
than the clearance of a slip fit does not go into its holder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Interval

from tacbench_cad.spec import FELT_PX, FITS
from tacbench_cad.util.convert import Checked, from_plain
from tacbench_cad.util.errors import InputError, nearest
from tacbench_cad.util.text import short
from tacbench_cad.util.untrusted import read_document

Positive = Annotated[float, Ge(0.0)]
Fraction = Annotated[float, Interval(ge=0.0, le=1.0)]


@dataclass(frozen=True, kw_only=True)
class Limits(Checked):
    """The largest allowed values. None for no limit.

    Args:
        pin_shift_px: The root mean square of the shift of a TacTip's pins that the deviation of the top causes.
        top_rms_mm: The root mean square of the deviation of the top.
        top_95_mm: The deviation that 95 % of the top do not exceed.
        top_largest_mm: The largest deviation of the top.
        wall_95_mm: The deviation that 95 % of the walls do not exceed.
        wall_outward_mm: The distance outside of the nominal walls that 95 % of the walls do not exceed.
        scale_error: The difference of each scale from 1.
        skew_deg: The difference of the corners from 90 degrees.
        height_error_mm: The difference of the height from the block's height.
        lost_fraction: The fraction of the crests that are lost, and of the valleys that are filled.
        amplitude_error: The difference of the amplitude ratio of each wave from 1.
        unseen_fraction: The fraction of the top that the scan does not show.
    """

    pin_shift_px: Positive | None = FELT_PX
    top_rms_mm: Positive | None = None
    top_95_mm: Positive | None = None
    top_largest_mm: Positive | None = None
    wall_95_mm: Positive | None = None
    wall_outward_mm: Positive | None = FITS["slip"]
    scale_error: Positive | None = None
    skew_deg: Positive | None = None
    height_error_mm: Positive | None = None
    lost_fraction: Fraction | None = None
    amplitude_error: Positive | None = None
    unseen_fraction: Fraction | None = 0.5


#: How the verdict writes each limit: the words, the factor of the number and its unit.
_WORDS: Mapping[str, tuple[str, float, str]] = {
    "pin_shift_px": ("shift of the pins", 1.0, " px"),
    "top_rms_mm": ("rms deviation of the top", 1000.0, " µm"),
    "top_95_mm": ("deviation of 95 % of the top", 1000.0, " µm"),
    "top_largest_mm": ("largest deviation of the top", 1000.0, " µm"),
    "wall_95_mm": ("deviation of 95 % of the walls", 1000.0, " µm"),
    "wall_outward_mm": ("distance outside of the nominal walls", 1000.0, " µm"),
    "scale_error": ("error of the scale", 100.0, " %"),
    "skew_deg": ("skew", 1.0, " degrees"),
    "height_error_mm": ("error of the height", 1000.0, " µm"),
    "lost_fraction": ("crests lost or valleys filled", 100.0, " %"),
    "amplitude_error": ("error of the amplitudes", 100.0, " %"),
    "unseen_fraction": ("part of the top that was not scanned", 100.0, " %"),
}
NAMES = tuple(field.name for field in fields(Limits))


@dataclass(frozen=True, kw_only=True)
class LimitCheck:
    """A number and its limit.

    Args:
        name: The name of the limit.
        value: The number; None if the scan does not determine it.
        limit: The limit.
    """

    name: str
    value: float | None
    limit: float

    @property
    def ok(self) -> bool:
        """Whether the limit is met. An unknown number meets it."""
        return self.value is None or self.value <= self.limit

    def __str__(self) -> str:
        """The number and its limit in words."""
        words, factor, unit = _WORDS[self.name]
        if self.value is None:
            return f"{words} unknown"
        return f"{words} {short(factor * self.value)}{unit} (limit {short(factor * self.limit)}{unit})"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The checks against the limits.

    Args:
        checks: The checks of all limits that are not None.
    """

    checks: tuple[LimitCheck, ...]

    @property
    def ok(self) -> bool:
        """Whether all limits are met."""
        return all(check.ok for check in self.checks)

    def __str__(self) -> str:
        """The verdict in one line."""
        if not self.checks:
            return "no limits were set"
        exceeded = [check for check in self.checks if not check.ok]
        unknown = [check for check in self.checks if check.value is None]
        shown = exceeded or [check for check in self.checks if check.value is not None]
        words = ["beyond the limits" if exceeded else "within the limits", "; ".join(map(str, shown))]
        return ": ".join(filter(None, words)) + "".join(f"; {check}" for check in unknown)


def verdict(values: Mapping[str, float | None], limits: Limits) -> Verdict:
    """Compare numbers with limits.

    Args:
        values: The number for each limit.
        limits: The limits.
    """
    pairs = ((name, getattr(limits, name)) for name in NAMES)
    checks = (LimitCheck(name=name, value=values.get(name), limit=limit) for name, limit in pairs if limit is not None)
    return Verdict(checks=tuple(checks))


def limits_of(words: Sequence[str]) -> Limits:
    """Return the limits for the words of an option.

    Args:
        words: The path of a TOML file with a table ``[limits]``, or words such as ``top_rms_mm=0.05``, which change the
            defaults; ``none`` as a value removes a limit.

    Raises:
        InputError: A word is not a limit, or its value is not allowed.
    """
    values: dict[str, float | None] = {}
    for word in words:
        name, equals, value = (part.strip() for part in word.partition("="))
        if not equals and name.endswith(".toml"):
            values |= _of_file(Path(name))
            continue
        if name not in NAMES:
            raise InputError("limits", word, f"write NAME=VALUE, or the name of a TOML file; {nearest(name, NAMES)}")
        try:
            values[name] = None if value == "none" else float(value)
        except ValueError:
            raise InputError("limits", word, "the value must be a number, or none for no limit") from None
    return from_plain(Limits, values, "limits ")


def _of_file(path: Path) -> dict[str, float | None]:
    document = read_document(path, "limits", "toml")
    table = document.get("limits")
    if not isinstance(table, dict) or len(document) > 1:
        raise InputError("limits", str(path), "must have the table [limits] and no other")
    # TOML has no word for no value.
    return {name: None if value == "none" else value for name, value in table.items()}
