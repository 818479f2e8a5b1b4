"""The text of STEP files: shorter files, and the blocks that a file contains, in its header.

In a shorter file, points, directions, lines and contexts are written once, with small numbers and without spaces.

Open CASCADE writes a point of its own for each pole, although neighbouring patches have common poles, and a context of
its own for each curve on a surface. The shorter file describes the same shape.
"""

from __future__ import annotations

import re

#: The largest size of the header of a file, in bytes.
MAX_HEADER = 64_000_000
#: The end of the description in the header, and the packed blocks in it. A string may have at most 256 characters.
_DESCRIPTION_END = re.compile(rb"\)\s*,\s*'2;1'\s*\)\s*;")
_BLOCKS = re.compile(rb"'tacbench-cad blocks'((?:\s*,\s*'[A-Za-z0-9+/=]*')+)")
_STRING_LENGTH = 240
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


def with_blocks(text: bytes, packed: str) -> bytes:
    """Return a STEP file of the kernel with blocks in the description of its header.

    Args:
        text: The file.
        packed: The blocks, see :func:`tacbench_cad.spec.storage.packed_blocks`.
    """
    strings = [packed[i : i + _STRING_LENGTH] for i in range(0, len(packed), _STRING_LENGTH)]
    end = _DESCRIPTION_END.search(text)
    assert end is not None, "the kernel writes a description"
    added = "".join(f",\n'{string}'" for string in ("tacbench-cad blocks", *strings))
    return text[: end.start()] + added.encode() + text[end.start() :]


def blocks_in_header(text: bytes) -> bytes | None:
    """Return the packed blocks in the header of a STEP file, or None if there are none.

    Args:
        text: The beginning of the file.
    """
    found = _BLOCKS.search(text, 0, max(0, text.find(b"ENDSEC;")))
    return None if found is None else b"".join(re.findall(rb"'([^']*)'", found[1]))
