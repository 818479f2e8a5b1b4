"""The settings of a texture on a face of a part. Importing this module does not load the CAD kernel."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from tacbench_cad.spec.presets import VALUES, with_table
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM
from tacbench_cad.spec.texture_files import find_texture
from tacbench_cad.spec.textures import Texture, require_own_unit
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.errors import InputError

#: The default height of the lowest point of a raised texture above the face, and the smallest that is allowed, in mm.
BASE_MM, MIN_BASE_MM = 0.2, 0.01
#: The height of a texture without a height of its own, and the allowed heights, in mm.
DEPTH_MM, DEPTH_RANGE_MM = 1.0, (0.01, 100.0)
#: The smallest allowed margin, in mm.
MIN_MARGIN_MM = 0.05
_Unit = Annotated[float, Interval(ge=1e-6, le=1e6)]


@dataclass(frozen=True, kw_only=True)
class Texturing(Checked):
    """The settings of a texture on a face.

    Args:
        texture: The texture.
        depth_mm: The peak-to-peak height of the texture. None keeps the height of a texture in mm, and of a file whose
            table ``[block]`` sets the mm per unit or the domain; it stands for 1 mm for other textures.
        margin_mm: The distance between the texture and the edges of the face.
        fade_mm: The length over which the texture fades out towards its outline; 0 for no fade.
        up: The direction of the texture's x on a plane, or the direction of its beginning on a cylinder: ``+X`` to
            ``-Z`` or a vector. None chooses ``+X``, or ``+Y`` if the face does not allow X.
        sunk: Whether the texture lies below the face instead of above it.
        base_mm: The distance of the texture from the face: of the lowest point of a raised texture, and of the highest
            point of a sunk texture. It makes the walls around the texture higher than zero everywhere.
        mm_per_unit: The millimetres per unit of u and v; None for those of the texture's file, or else of the preset
            ``paper``. A texture in mm is never stretched, so it allows none.
        tolerance_mm: The largest distance of the solid from the formula.
    """

    texture: Texture
    depth_mm: Annotated[float, Interval(ge=DEPTH_RANGE_MM[0], le=DEPTH_RANGE_MM[1])] | None = None
    margin_mm: Annotated[float, Interval(ge=MIN_MARGIN_MM, le=1e4)] = 1.0
    fade_mm: Annotated[float, Interval(ge=0.0, le=1e4)] = 0.0
    up: str | tuple[float, float, float] | None = None
    sunk: bool = False
    base_mm: Annotated[float, Interval(ge=MIN_BASE_MM, le=100.0)] = BASE_MM
    mm_per_unit: tuple[_Unit, _Unit] | None = None
    tolerance_mm: Annotated[float, Interval(ge=1e-5, le=1.0)] = STEP_TOLERANCE_MM

    def __post_init__(self) -> None:
        super().__post_init__()
        require_own_unit("mm_per_unit", self.mm_per_unit, self.texture.surface)

    @cached_property
    def _own(self) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """The millimetres per unit of u, v and height, and the origin, as on a block of the preset ``paper``."""
        _, unit, origin, _ = with_table(VALUES["paper"], self.texture.block, self.texture.surface)
        return unit, origin

    @property
    def unit_mm(self) -> tuple[float, float]:
        """The millimetres per unit of u and v."""
        return self.mm_per_unit or self._own[0][:2]

    @property
    def origin_uv(self) -> tuple[float, float]:
        """The point (u, v) at the lower corner of the textured region."""
        return self._own[1]

    def factor(self, relief: float) -> float:
        """Return the millimetres per unit of height.

        Args:
            relief: The peak-to-peak height of the formula over the region, in units.
        """
        if self.depth_mm is not None:
            return self.depth_mm / relief
        table = self.texture.block
        is_stated = self.texture.surface.unit == "mm" or table.mm_per_unit is not None or table.domain is not None
        return self._own[0][2] if is_stated else DEPTH_MM / relief


def texturing(texture: Texture | str | int | Path, **settings: Any) -> Texturing:
    """Return the settings of a texture.

    Args:
        texture: A texture, the number or name of one of the six, the name of a later one, or a TOML file.
        **settings: The other fields of :class:`Texturing`.

    Raises:
        InputError: A setting is unknown or not allowed.
    """
    known = [field.name for field in fields(Texturing) if field.name != "texture"]
    for name in settings:
        if name not in known:
            raise InputError("setting", name, f"is unknown; the settings are {', '.join(known)}")
    return Texturing(texture=find_texture(texture), **settings)
