"""G-code words."""

from __future__ import annotations

import re
from dataclasses import dataclass

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")


@dataclass(frozen=True)
class Word:
    """A letter with its number; ``value`` is None where the number is missing or is none."""

    letter: str
    value: float | None


def words(line: str) -> list[Word] | None:
    """The words of a line without blanks, upper case; None where a word does not begin with a letter.

    A word whose number is missing or wrong ends the list: what follows cannot be read.
    """
    found = []
    at = 0
    while at < len(line):
        if not "A" <= line[at] <= "Z":
            return None
        number = _NUMBER.match(line, at + 1)
        if number is None:
            found.append(Word(line[at], None))
            break
        found.append(Word(line[at], float(number.group())))
        at = number.end()
    return found
