"""G-code words."""

from __future__ import annotations

import re
from dataclasses import dataclass

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")


@dataclass(frozen=True)
class Word:
    """A letter with its number.

    Args:
        letter: The letter, upper case.
        value: The number; None where it is missing or is none.
    """

    letter: str
    value: float | None


def words(line: str, *, flags: bool = False) -> list[Word] | None:
    """The words of a line without blanks, upper case; None where a word does not begin with a letter.

    Args:
        line: The line.
        flags: Letters may stand alone, as in Marlin's ``G28 X Y``, and what is no number is passed over. Otherwise a
            word whose number is missing or wrong ends the list: what follows cannot be read.
    """
    result = []
    at = 0
    while at < len(line):
        if not "A" <= line[at] <= "Z":
            return None
        number = _NUMBER.match(line, at + 1)
        if number is not None:
            result.append(Word(line[at], float(number.group())))
            at = number.end()
            continue
        result.append(Word(line[at], None))
        if not flags:
            break
        at += 1
        while at < len(line) and not "A" <= line[at] <= "Z":
            at += 1
    return result
