"""Parsing of G-code words."""

from __future__ import annotations

import re

#: A letter, its number, and what follows up to the next letter.
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))?([^A-Z]*)")
#: A letter, upper case, with its number; None if the number is missing or invalid.
Word = tuple[str, float | None]


def words(line: str, *, flags: bool = False) -> list[Word] | None:
    """Return the words of a line without blanks, upper case; None if a word does not begin with a letter.

    Args:
        line: The line.
        flags: Whether letters may stand alone, as in Marlin's ``G28 X Y``. Invalid numbers are then ignored. Otherwise
            a word with a missing or invalid number ends the list, since the rest cannot be read.
    """
    if line and not "A" <= line[0] <= "Z":
        return None
    result: list[Word] = []
    for letter, number, rest in _WORD.findall(line):
        if number and rest:
            return None
        result.append((letter, float(number) if number else None))
        if not number and not flags:
            break
    return result
