"""How numbers stand in file names, labels and reports."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence


def decimal(value: float) -> str:
    """The shortest decimals that give the number back, without an exponent: ``0.5``, ``1``, ``0.00001``.

    The rounding of a product is left out: ``30.4`` for 30.400000000000002.
    """
    import numpy as np  # here: a command that counts must not wait for it

    exact, rounded = (np.format_float_positional(x, trim="-") for x in (value, float(f"{value:.12g}")))
    return rounded if len(rounded) <= len(exact) - 8 else exact


def short_name(name: str) -> str:
    """A name for a file: decimals with more than six digits are rounded to four, and a hash keeps the name unique.

    ``hex_paper_x1_mm3.7083101740411615x1.5x1`` becomes ``hex_paper_x1_mm3.708x1.5x1_`` and six hexadecimal digits.
    """

    def rounded(match: re.Match[str]) -> str:
        text = match[0]
        return decimal(float(f"{float(text):.4g}")) if len(text.replace(".", "").lstrip("0")) > 6 else text

    short = re.sub(r"\d+\.\d+", rounded, name)
    return name if short == name else f"{short}_{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def counted(number: int, what: str) -> str:
    """How many of something: ``1 run``, ``2,400 presses``.

    Args:
        number: How many.
        what: One of them, regular in the plural.
    """
    ending = "" if number == 1 else "es" if what.endswith("s") else "s"
    return f"{number:,} {what}{ending}"


def interval(low: float | None, high: float | None, *, signed: bool = False) -> str:
    """An interval as it is printed everywhere: three significant digits, ``1.77 to 1,740``.

    Args:
        low: Lower end; None where there is no interval.
        high: Upper end; infinite where nothing bounds it (``1.77 or more``), None where there is no interval.
        signed: Write the sign of positive ends too, for intervals of differences.

    Returns:
        The interval, or ``none``.
    """
    if low is None or high is None or math.isnan(low) or math.isnan(high):
        return "none"
    return f"{short(low, signed=signed)} {f'to {short(high, signed=signed)}' if math.isfinite(high) else 'or more'}"


def short(value: float, *, signed: bool = False) -> str:
    """A number with three significant digits, without an exponent from 0.0001 to 1e15: ``0.0302``, ``4,440``."""
    rounded = float(f"{value:.3g}") + 0.0  # without the sign of a zero
    return f"{rounded:{'+' if signed else ''}{',.0f' if 1e3 <= abs(rounded) < 1e15 else '.3g'}}"


def report(title: str, lines: Mapping[str, str] | Sequence[tuple[str, str]]) -> str:
    """A dimension report: the title, then one aligned line for each entry.

    Args:
        title: First line.
        lines: Names and what is said of them.
    """
    pairs = list(lines.items()) if isinstance(lines, Mapping) else lines
    width = max((len(name) for name, _ in pairs), default=0)
    return "\n".join([title, *(f"  {name:<{width}}  {value}" for name, value in pairs)])


def report_rows(text: str) -> dict[str, str]:
    """The values of a dimension report by their names: what :func:`report` was given."""
    rows = (line.strip().partition("  ") for line in text.splitlines()[1:])
    return {name: value.strip() for name, _, value in rows}


def by(*values: float) -> str:
    """Lengths for people, without their unit: ``45.6 x 52.3 x 7.47``."""
    return " x ".join(f"{value:.6g}" for value in values)


def mm(*values: float) -> str:
    """Lengths for people: ``45.6 x 52.3 x 7.47 mm``."""
    return f"{by(*values)} mm"
