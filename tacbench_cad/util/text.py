"""Numbers as text, for file names, labels and reports."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from decimal import ROUND_CEILING, Context
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tomlkit.items import Item

    from tacbench_cad.util.types import Ints, Strings

#: The largest number of characters of a file name, without its hash and its ending.
_LONGEST_NAME = 100


def decimal(value: float) -> str:
    """Write a number with the fewest digits that identify it, without an exponent: ``0.5``, ``1``, ``0.00001``.

    Rounding errors are removed: 30.400000000000002 becomes ``30.4``.
    """
    import numpy as np  # imported here, so that commands that only count start faster

    exact, rounded = (np.format_float_positional(x, trim="-") for x in (value, float(f"{value:.12g}")))
    return rounded if len(rounded) <= len(exact) - 8 else exact


def short_name(name: str) -> str:
    """Shorten a file name: numbers with more than six digits are rounded to four, and a hash keeps the name unique.

    For example, ``hex_paper_x1_mm3.7083101740411615x1.5x1`` becomes ``hex_paper_x1_mm3.708x1.5x1_`` followed by six
    hexadecimal digits. Names that are still longer than 100 characters are cut off there.
    """

    def rounded(match: re.Match[str]) -> str:
        text = match[0]
        return decimal(float(f"{float(text):.4g}")) if len(text.replace(".", "").lstrip("0")) > 6 else text

    short = re.sub(r"\d+\.\d+", rounded, name)[:_LONGEST_NAME]
    import hashlib  # only for long names

    return name if short == name else f"{short}_{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def file_name(text: str, most: int) -> str:
    """Return a text as a part of a file name, which can be empty.

    Characters that a file name cannot have on every system become hyphens.

    Args:
        text: The text.
        most: The largest number of bytes.
    """
    plain = re.sub(r"[^\w.+-]+", "-", text).strip("-.").encode("utf-8", "ignore")[:most]
    return plain.decode("utf-8", "ignore").strip("-.")


def natural(text: str) -> tuple[object, ...]:
    """Return the key that sorts texts as people do: ``material-2`` before ``material-10``."""
    parts = re.split(r"([0-9]{1,18})", text)
    return (tuple(int(part) if i % 2 else part for i, part in enumerate(parts)), text)


def natural_unique(names: Strings) -> tuple[Strings, Ints]:
    """Return the different names in natural order, and for each of ``names`` its index in them."""
    import numpy as np

    unique, inverse = np.unique(names, return_inverse=True)
    order = sorted(range(len(unique)), key=lambda i: natural(str(unique[i])))
    return unique[order], np.argsort(order)[inverse]


def decimal_hint(text: str) -> str:
    """Return ``; write 1.5`` for the text ``1,5``, as the end of an error message; an empty text for all others."""
    return f"; write {text.strip().replace(',', '.')}" if re.fullmatch(r"\s*[-+]?\d*,\d+\s*", text) else ""


def toml_item(value: Any) -> Item:
    """Return a text, a number, a list or a table as the value of a key in a TOML file. A table is one line."""
    import tomlkit  # imported here, because few commands write TOML files

    if not isinstance(value, Mapping):
        item: Item = tomlkit.item(value)
        return item
    table = tomlkit.inline_table()
    table.update(value)
    return table


def counted(number: int, what: str) -> str:
    """Write a number of things: ``1 run``, ``2,400 presses``.

    Args:
        number: The number.
        what: The noun in the singular; its plural must be regular.
    """
    ending = "" if number == 1 else "es" if what.endswith("s") else "s"
    return f"{number:,} {what}{ending}"


def interval(low: float | None, high: float | None, *, signed: bool = False) -> str:
    """Write an interval with three significant digits: ``1.77 to 1,740``.

    Args:
        low: The lower end; None if there is no interval.
        high: The upper end; infinity if there is no upper bound (``1.77 or more``); None if there is no interval.
        signed: Write a plus sign before positive numbers, for intervals of differences.

    Returns:
        The interval, or ``none``.
    """
    if low is None or high is None or math.isnan(low) or math.isnan(high):
        return "none"
    return f"{short(low, signed=signed)} {f'to {short(high, signed=signed)}' if math.isfinite(high) else 'or more'}"


def short(value: float, *, signed: bool = False) -> str:
    """Write a number with three significant digits: ``0.0302``, ``4,440``. No exponent between 0.0001 and 1e15."""
    rounded = float(f"{value:.3g}") + 0.0  # adding 0.0 turns -0.0 into 0.0
    return f"{rounded:{'+' if signed else ''}{',.0f' if 1e3 <= abs(rounded) < 1e15 else '.3g'}}"


def at_most(bound: float, digits: int) -> str:
    """Write an upper bound with a number of significant digits, rounded up: 0.00264 with two digits is ``0.0027``."""
    up = Context(prec=digits, rounding=ROUND_CEILING).create_decimal(repr(float(bound)))
    return f"{float(up):.{digits}g}"


def report(title: str, lines: Mapping[str, str] | Sequence[tuple[str, str]]) -> str:
    """Write a dimension report: the title, then one line for each entry, with aligned columns.

    Args:
        title: The first line.
        lines: The entries, each with a name and a text.
    """
    pairs = list(lines.items()) if isinstance(lines, Mapping) else lines
    width = max((len(name) for name, _ in pairs), default=0)
    return "\n".join([title, *(f"  {name:<{width}}  {value}" for name, value in pairs)])


def report_rows(text: str) -> dict[str, str]:
    """Return the entries of a dimension report, that is, the ``lines`` that :func:`report` was given."""
    rows = (line.strip().partition("  ") for line in text.splitlines()[1:])
    return {name: value.strip() for name, _, value in rows}


def by(*values: float) -> str:
    """Write lengths without a unit: ``45.6 x 52.3 x 7.47``."""
    return " x ".join(f"{value:.6g}" for value in values)


def mm(*values: float) -> str:
    """Write lengths in mm: ``45.6 x 52.3 x 7.47 mm``."""
    return f"{by(*values)} mm"
