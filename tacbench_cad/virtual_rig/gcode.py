"""G-code words."""

from __future__ import annotations

import re

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")
#: A letter, upper case, with its number; None where that is missing or is none.
Word = tuple[str, float | None]


def words(line: str, *, flags: bool = False) -> list[Word] | None:
    """The words of a line without blanks, upper case; None where a word does not begin with a letter.

    Args:
        line: The line.
        flags: Letters may stand alone, as in Marlin's ``G28 X Y``, and what is no number is passed over. Otherwise a
            word whose number is missing or wrong ends the list: what follows cannot be read.
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
