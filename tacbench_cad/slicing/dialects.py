"""What slicers call the pieces of a print in the comments of their G-code, and which of them are the part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

#: ``wall``: the part's outer wall; ``part``: the rest of the part; ``other``: purge, skirt, brim, support and the like.
Role = Literal["wall", "part", "other"]


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """How one family of slicers marks its G-code.

    Args:
        name: For people.
        feature: What a comment that names a feature begins with, after the semicolon.
        roles: What each feature is, by its name in lower case.
    """

    name: str
    feature: str
    roles: Mapping[str, Role]


def _roles(wall: str, part: str, other: str) -> dict[str, Role]:
    roles: dict[str, Role] = {}
    for role, words in (("wall", wall), ("part", part), ("other", other)):
        for word in words.split(", "):
            roles[word] = role  # type: ignore[assignment]
    return roles


_BAMBU = _roles(
    "outer wall, overhang wall",
    "inner wall, sparse infill, internal solid infill, solid infill, top surface, bottom surface, bridge, "
    "internal bridge, gap infill, ironing, floating vertical shell",
    "skirt, brim, support, support interface, support transition, prime tower, wipe tower, custom, undefined, "
    "flush, skirt/brim, multiple",
)

#: Told apart by the names of their features, so that a file without its header is still understood.
DIALECTS = (
    Dialect(
        name="PrusaSlicer",
        feature="TYPE:",
        roles=_roles(
            "external perimeter, overhang perimeter",
            "perimeter, internal infill, solid infill, top solid infill, bridge infill, gap fill, ironing, thin wall, "
            "internal bridge infill",
            "skirt/brim, skirt, brim, support material, support material interface, wipe tower, custom, mixed, unknown",
        ),
    ),
    Dialect(
        name="Cura",
        feature="TYPE:",
        roles=_roles(
            "wall-outer",
            "wall-inner, skin, fill",
            "skirt, support, support-interface, prime-tower, custom",
        ),
    ),
    Dialect(name="Bambu Studio", feature=" FEATURE: ", roles=_BAMBU),
    Dialect(name="OrcaSlicer", feature="TYPE:", roles=_BAMBU),
)


def dialect_of(comments: set[str]) -> Dialect | None:
    """The dialect whose outer walls are among the comments, or None.

    Args:
        comments: Every comment of the file that names a feature, without its semicolon.
    """
    for dialect in DIALECTS:
        walls = {dialect.feature + word for word, role in dialect.roles.items() if role == "wall"}
        if any(
            comment[: len(dialect.feature)] + comment[len(dialect.feature) :].lower() in walls for comment in comments
        ):
            return dialect
    return None
