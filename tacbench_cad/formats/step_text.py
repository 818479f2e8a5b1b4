"""Shorter STEP files: points, directions, lines and contexts are written once, with small numbers and without spaces.

Open CASCADE writes a point of its own for each pole, although neighbouring patches have common poles, and a context of
its own for each curve on a surface. The shorter file describes the same shape.
"""

from __future__ import annotations

import re

_DATA = b"\nDATA;\n"
_POINT = re.compile(rb"(#\d+) = CARTESIAN_POINT\('',\(([^)]*)\)\);\n")
_ENTITY = re.compile(rb"(#\d+) = ([^;']*(?:'[^']*'[^;']*)*);")
_STRING = re.compile(rb"('[^']*')")
_STRING_OR_REFERENCE = re.compile(rb"('[^']*'|#\d+)")
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
    points = _POINT.findall(text, begin, end)
    places: dict[bytes, bytes] = {}
    same = {number: places.setdefault(place, number) for number, place in points}
    bodies = {number: _without_spaces(body) for number, body in _ENTITY.findall(_POINT.sub(b"", text[begin:end]))}
    for kinds in _VALUES:
        first: dict[bytes, bytes] = {}
        numbers = [number for number, body in bodies.items() if body.startswith(kinds)]
        renamed = _renamed(b"\n".join(bodies[number] for number in numbers), same).split(b"\n")
        bodies.update(zip(numbers, renamed, strict=False))
        for number in numbers:
            original = first.setdefault(bodies[number], number)
            if original is not number:
                same[number] = original
                del bodies[number]
    new = {number: b"#%d" % place for place, number in enumerate([*places.values(), *bodies], start=1)}
    new.update({number: new[original] for number, original in same.items()})
    shorter = [place if b"\n" not in place else b"".join(place.split()) for place in places]
    lines = [b"#%d=CARTESIAN_POINT('',(%b));\n" % line for line in enumerate(shorter, start=1)]
    others = b"".join(b"%b=%b;\n" % entity for entity in bodies.items())
    return b"".join([text[:begin], *lines, _renamed(others, new), text[end:]])


def _renamed(text: bytes, names: dict[bytes, bytes]) -> bytes:
    """Replace the numbers of entities. Strings keep their text."""
    parts = _STRING_OR_REFERENCE.split(text)
    parts[1::2] = [names.get(part, part) for part in parts[1::2]]
    return b"".join(parts)


def _without_spaces(body: bytes) -> bytes:
    """Return the text of an entity without the spaces and line ends outside of its strings."""
    if b" " not in body and b"\n" not in body:
        return body
    parts = _STRING.split(body)
    parts[::2] = [b"".join(part.split()) for part in parts[::2]]
    return b"".join(parts)
