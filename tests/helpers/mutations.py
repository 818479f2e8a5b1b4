"""Ways to damage a file, and the description of a kind of file whose reader has to survive the damage.

The readers run in a child process with limits of time and memory: see ``tests/hostile/test_mutations.py``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hypothesis import strategies as st

#: Texts that replace a number or a word, or are inserted.
TOKENS = tuple(
    token.encode("utf-8", "surrogatepass")
    for line in (
        ("0", "-1", "1e9", "-0.0", "1e999", "-1e-320", "nan", "inf", "NaN", "Infinity", "9" * 20, "9" * 400),
        ("9" * 5000, "0x" + "f" * 5000, "true", "null", '""', "''", "[]", "{}", "[[1]]", '{"a": 1}', "[" * 10_000),
        ("0001-01-01T00:00:00Z", "9999-12-31T23:59:59+00:00", "2026-13-45", "../../etc/passwd", "/dev/zero", "\0"),
        ("\n", "\r", ",", ";", '"', "#", "=", "(", ")", "$", "*", "é", "\ud800", '"\\ud800"', "x" * 3000, " " * 3000),
        ("1 2", "()", "#1", "-", "E9", "1.0.0"),
    )
    for token in line
)
_PIECE = re.compile(rb"-?\d[\d.eE+-]*|[A-Za-z_][\w-]*|[\[\]{}(),;=:\"'\n]")


@dataclass(frozen=True)
class Mutation:
    """A change of a file's bytes.

    Args:
        how: The kind of change.
        at: The position, from 0 to 1 of the file or of its tokens.
        length: The length, from 0 to 1.
        data: The inserted bytes.
    """

    how: str
    at: float
    length: float
    data: bytes

    def __call__(self, content: bytes) -> bytes:
        place = int(self.at * len(content))
        span = max(1, int(self.length**4 * len(content) / 4))
        if self.how == "cut":
            return content[:place]
        if self.how == "drop":
            return content[:place] + content[place + span :]
        if self.how == "repeat":
            return content[: place + span] + content[place:]
        if self.how == "swap":
            return content[:place] + content[place + span : place + 2 * span] + content[place : place + span]
        if self.how == "bytes":
            return content[:place] + self.data + content[place + len(self.data) :]
        pieces = list(_PIECE.finditer(content[: 2 << 20]))
        if not pieces:
            return content + self.data
        piece = pieces[min(int(self.at * len(pieces)), len(pieces) - 1)]
        if self.how == "line":
            lines = content.splitlines(keepends=True)
            i = min(int(self.at * len(lines)), len(lines) - 1)
            j = min(int(self.length * len(lines)), len(lines) - 1)
            lines[i], lines[j] = lines[j], lines[i]
            return b"".join(lines[:i] if self.data[:1] < b"\x40" else lines)
        end = piece.end() if self.how == "replace" else piece.start()
        return content[: piece.start()] + self.data + content[end:]


def mutations() -> st.SearchStrategy[list[Mutation]]:
    """Return a strategy for one to four changes."""
    data = st.one_of(st.sampled_from(TOKENS), st.binary(min_size=1, max_size=8))
    unit = st.floats(0.0, 1.0, exclude_max=True)
    ways = ("replace", "replace", "replace", "insert", "bytes", "bytes", "drop", "repeat", "swap", "line", "cut")
    return st.lists(st.builds(Mutation, st.sampled_from(ways), unit, unit, data), min_size=1, max_size=4)


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Args:
        file: The name of the file that is changed, in the folder that ``make`` fills.
        make: Fills a folder with the valid file and the files that belong to it.
        read: Reads the folder as a command does.
        harmless: Changes of the text that must not change the result.
    """

    file: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]
    harmless: tuple[Callable[[bytes], bytes], ...] = ()


def writer(name: str, text: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / name).write_text(text)

    return make


def windows(content: bytes) -> bytes:
    return content.replace(b"\n", b"\r\n")


def marked(content: bytes) -> bytes:
    return b"\xef\xbb\xbf" + content


def commented(content: bytes) -> bytes:
    return b"# a comment\n\n" + content.replace(b"\n", b"  # more\n\n") + b"\n\n"


def spaced(content: bytes) -> bytes:
    return content.replace(b" = ", b"   =\t")


def indented(content: bytes) -> bytes:
    return json.dumps(dict(reversed(json.loads(content).items())), indent=7).encode() + b"\n\n"


HARMLESS_IN_TOML = (windows, marked, commented, spaced)
