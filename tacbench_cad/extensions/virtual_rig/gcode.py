"""Parsing of G-code words."""

from __future__ import annotations

import re

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")
#: A letter, upper case, with its number; None if the number is missing or invalid.
Word = tuple[str, float | None]


def words(line: str, *, flags: bool = False) -> list[Word] | None:
    """Return the words of a line without blanks, upper case; None if a word does not begin with a letter.

    Args:
        line: The line.
        flags: Whether letters may stand alone, as in Marlin's ``G28 X Y``. Invalid numbers are then ignored. Otherwise
            a word with a missing or invalid number ends the list, since the rest cannot be read.
    """
    result: list[Word] = []
    at = 0
    while at < len(line):
        if not "A" <= line[at] <= "Z":
            return None
        number = _NUMBER.match(line, at + 1)
        if number is not None:
            result.append((line[at], float(number.group())))
            at = number.end()
            continue
        result.append((line[at], None))
        if not flags:
            break
        at += 1
        while at < len(line) and not "A" <= line[at] <= "Z":
            at += 1
    return result
