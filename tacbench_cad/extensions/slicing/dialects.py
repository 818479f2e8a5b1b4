"""The dialects of slicers: their names for the features of a print, and which features belong to the part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

#: ``wall``: the part's outer wall; ``part``: the rest of the part; ``other``: purge, skirt, brim, support and the like.
Role = Literal["wall", "part", "other"]


@dataclass(frozen=True, kw_only=True)
class SlicerDialect:
    """The comments with which a family of slicers marks the features in its G-code.

    Args:
        name: The name of the slicer.
        feature: The beginning of a comment that names a feature, after the semicolon.
        roles: The role of each feature, by its name in lower case.
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

#: The known dialects. They are distinguished by the names of their features, so a file needs no header.
DIALECTS = (
    SlicerDialect(
        name="PrusaSlicer",
        feature="TYPE:",
        roles=_roles(
            "external perimeter, overhang perimeter",
            "perimeter, internal infill, solid infill, top solid infill, bridge infill, gap fill, ironing, thin wall, "
            "internal bridge infill",
            "skirt/brim, skirt, brim, support material, support material interface, wipe tower, custom, mixed, unknown",
        ),
    ),
    SlicerDialect(
        name="Cura",
        feature="TYPE:",
        roles=_roles(
            "wall-outer",
            "wall-inner, skin, fill",
            "skirt, support, support-interface, prime-tower, custom",
        ),
    ),
    SlicerDialect(name="Bambu Studio", feature=" FEATURE: ", roles=_BAMBU),
    SlicerDialect(name="OrcaSlicer", feature="TYPE:", roles=_BAMBU),
)


def dialect_of(comments: set[str]) -> SlicerDialect | None:
    """Return the dialect whose outer walls are among the comments, or None.

    Args:
        comments: All comments of the file that name a feature, without the semicolon.
    """
    for dialect in DIALECTS:
        walls = {dialect.feature + word for word, role in dialect.roles.items() if role == "wall"}
        if any(
            comment[: len(dialect.feature)] + comment[len(dialect.feature) :].lower() in walls for comment in comments
        ):
            return dialect
    return None
