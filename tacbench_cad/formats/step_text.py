"""Shorter STEP files: points, directions, lines and contexts are written once, with small numbers and without spaces.

Open CASCADE writes a point of its own for each pole, although neighbouring patches have common poles, and a context of
its own for each curve on a surface. The shorter file describes the same shape.
"""

from __future__ import annotations

import re

_DATA = b"\nDATA;\n"
_POINT = b"CARTESIAN_POINT("
_NUMBERS = re.compile(rb"(#\d+)")
_STRING = re.compile(rb"'(\d+)'")
#: The beginning of most entities: an empty name. The name becomes one byte that cannot occur in the file.
_NO_NAME, _SHORT = b"('',", b"(\0,"
#: Entities whose place in the file has no meaning: two with the same text are the same. The entities of each row refer
#: only to points and to entities of the rows above.
_VALUES = (
    (b"DIRECTION(", b"(GEOMETRIC_REPRESENTATION_CONTEXT(2)PARAMETRIC_REPRESENTATION_CONTEXT()"),
    (b"VECTOR(",),
    (b"LINE(",),
    (b"DEFINITIONAL_REPRESENTATION(",),
)


def compact(text: bytes) -> bytes:
    """Return a STEP file of the kernel with the same content in fewer bytes.

    Points come first and get the smallest numbers, because they are used most often. All other entities keep their
    order.
    """
    begin, end = text.index(_DATA) + len(_DATA), text.rindex(b"ENDSEC;")
    strings, data = _without_strings(text[begin:end])
    entities = dict(entity.split(b"=", 1) for entity in data.split(b";")[:-1])
    places: dict[bytes, bytes] = {}
    same: dict[bytes, bytes] = {}
    bodies: dict[bytes, bytes] = {}
    for number, body in entities.items():
        if body.startswith(_POINT):
            same[number] = places.setdefault(body, number)
        else:
            bodies[number] = body
    for kinds in _VALUES:
        first: dict[bytes, bytes] = {}
        numbers = [number for number, body in bodies.items() if body.startswith(kinds)]
        renamed = _renamed(b";".join(map(bodies.__getitem__, numbers)), same).split(b";")
        for number, body in zip(numbers, renamed, strict=False):
            original = first.setdefault(body, number)
            if original is number:
                bodies[number] = body
            else:
                same[number] = original
                del bodies[number]
    new = {number: b"#%d" % place for place, number in enumerate([*places.values(), *bodies], start=1)}
    new.update({number: new[original] for number, original in same.items()})
    lines = [b"#%d=%b;\n" % line for line in enumerate(places, start=1)]
    others = _renamed(b"".join([b"%b=%b;\n" % entity for entity in bodies.items()]), new)
    return b"".join([text[:begin], _with_strings(b"".join([*lines, others]), strings), text[end:]])


def _without_strings(text: bytes) -> tuple[list[bytes], bytes]:
    """Replace each string by its number in a list, and remove all spaces and line ends outside of strings."""
    parts = text.replace(_NO_NAME, _SHORT).split(b"'")
    numbers: dict[bytes, int] = {}
    parts[1::2] = [b"'%d'" % numbers.setdefault(string, len(numbers)) for string in parts[1::2]]
    return list(numbers), b"".join(parts).translate(None, b" \r\n")


def _with_strings(text: bytes, strings: list[bytes]) -> bytes:
    """Put the strings back into a text."""
    return _STRING.sub(lambda number: b"'%b'" % strings[int(number[1])], text).replace(_SHORT, _NO_NAME)


def _renamed(text: bytes, names: dict[bytes, bytes]) -> bytes:
    """Replace the numbers of entities in a text without strings."""
    parts = _NUMBERS.split(text)
    parts[1::2] = [names.get(part, part) for part in parts[1::2]]
    return b"".join(parts)
