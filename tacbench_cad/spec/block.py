"""A block: a texture at a size in mm. Only this module converts between the formula's units and mm.

Block frame: origin at the lower corner of the underside, x and y along the sides, z up, underside at 0, highest point
at ``height_mm``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.extremes import Extremes
from tacbench_cad.spec.label import LABEL_DEPTH_MM, Engraving, engrave
from tacbench_cad.spec.outlines import LoopRegion, Outline, outline_of, without_key
from tacbench_cad.spec.presets import PRESETS, VALUES, grid_of_same_step, with_table
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM, SampleGrid, Tolerance, attainable_mm, highest_sample
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.texture_files import find_texture
from tacbench_cad.spec.textures import BlockTable, Texture, require_own_unit
from tacbench_cad.util.errors import InputError, one_of, require_between
from tacbench_cad.util.text import decimal, mm, report
from tacbench_cad.util.types import Floats

#: The smallest allowed thickness below the lowest valley, and above the pockets of the label, in mm.
MIN_BASE_MM = 0.8
#: The allowed range of sides and heights, in mm. Values outside of it are probably mistakes.
SIZE_RANGE_MM = (0.5, 2000.0)
#: The largest number of copies of a block.
MAX_COPIES = 999
#: The default leg of the key, in mm.
KEY_MM = 3.0


@dataclass(frozen=True, kw_only=True)
class Block:
    """A texture block. Use :meth:`of` to make one from a preset and options.

    Args:
        texture: The texture.
        preset: The name of the preset that the block was made from.
        nominal_size_mm: The sides x, y before scaling, in mm.
        nominal_height_mm: The height of the highest point before scaling, in mm.
        nominal_mm_per_unit: The millimetres per unit of u, v and height before scaling.
        sampling: How the mesh approximates the formula.
        origin_uv: The point (u, v) at the corner of the block.
        scale: The factor that multiplies the sides, the height and the millimetres per unit.
        key_mm: The leg of the chamfered corner at (x, 0), in mm; None for no key.
        label: Whether texture, preset, scale and copy are engraved in the underside.
        copy: The number of this copy, or None.
        step_tolerance_mm: The largest vertical distance of the solid (and of a STEP file) from the formula, in mm.
        nominal_outline: The outline before scaling; None for a rectangle.

    Raises:
        InputError: A field has a value that is not allowed.
    """

    texture: Texture
    preset: str
    nominal_size_mm: tuple[float, float]
    nominal_height_mm: float
    nominal_mm_per_unit: tuple[float, float, float]
    sampling: Tolerance | SampleGrid
    origin_uv: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    key_mm: float | None = None
    label: bool = False
    copy: int | None = None
    step_tolerance_mm: float = STEP_TOLERANCE_MM
    nominal_outline: Outline | None = None

    @classmethod
    def of(
        cls,
        texture: Texture | str | int | Path,
        preset: str = "paper",
        *,
        mm_per_unit: tuple[float, float, float] | None = None,
        size_mm: tuple[float, float] | None = None,
        height_mm: float | None = None,
        scale: float = 1.0,
        sampling: Tolerance | SampleGrid | Literal["grid"] | None = None,
        key_mm: float | None = None,
        label: bool = False,
        copy: int | None = None,
        step_tolerance_mm: float | None = None,
        table: BlockTable | None = None,
        outline: Outline | str | None = None,
    ) -> Block:
        """Make a block from a preset. The options are applied in this order: mm per unit, size, height, scale.

        Args:
            texture: A texture, the number or name of one of the six, the name of a later one, or a TOML file.
            preset: ``paper`` or ``released``.
            mm_per_unit: A new mapping from units to mm. The sides stay the same, and the domain changes. A texture in
                mm is never stretched, so it allows none.
            size_mm: New sides, in mm. The mapping stays the same, and the domain changes.
            height_mm: A new height, in mm. Only the base becomes thicker or thinner.
            scale: The factor that multiplies the sides, the height and the mm per unit. The domain stays the same.
            sampling: The tolerance or the sample grid of the mesh. ``"grid"`` selects the preset's own grid, or a grid
                with the same step if the sides differ. None selects the preset's default, or a larger tolerance if the
                texture's own error needs it.
            key_mm: The leg of the key, in mm; None for no key.
            label: Whether to engrave the underside.
            copy: The number of the copy. It is engraved, so it implies ``label``.
            step_tolerance_mm: The largest vertical distance of the solid (and of a STEP file) from the formula, in mm.
                None selects 0.001, or more if the texture's own error is larger.
            table: The block settings of a texture file, which replace the values of the preset; None for those of
                the texture itself.
            outline: The outline before scaling: a :class:`~tacbench_cad.spec.outlines.Disc`, ``RegularPolygon``,
                ``Polygon`` or ``Ring``, or a word such as ``disc`` (the largest disc in the sides) or ``disc:30``.
                None for the outline of the texture file, or a rectangle. The sides become those of its box.

        Raises:
            InputError: A value is not allowed.
        """
        one_of("preset", preset, PRESETS)
        surface = find_texture(texture, preset)
        values, table = VALUES[preset], surface.block if table is None else table
        require_own_unit("mm_per_unit", mm_per_unit, surface.surface)
        start = with_table(values, table, surface.surface)
        if preset == "released" and sampling is None and (mm_per_unit or size_mm or height_mm or start[3]):
            raise InputError(
                "preset", preset, "with other sides, height or mm per unit it needs --grid or --tolerance as well"
            )
        size, unit, origin, _ = start
        size, unit = size_mm or size, mm_per_unit or unit
        shape = outline if outline is not None else table.outline
        if isinstance(shape, str):
            word, shape = shape, outline_of(shape, size)
            if size_mm is not None and ":" in word and not _same(size, shape.size_mm):
                own = " x ".join(f"{side:g}" for side in shape.size_mm)
                raise InputError(
                    "size", f"{size[0]:g} x {size[1]:g} mm", f"the outline {word} has {own} mm; leave it out"
                )
        if isinstance(shape, Outline):
            size = shape.size_mm
        height = height_mm if height_mm is not None else table.height_mm or values.height_mm
        # the error of the texture over the block is a little larger where creases are rounded
        own_mm = 1.01 * surface.surface.error * unit[2] * scale
        chosen = sampling if sampling is not None else values.sampling
        if sampling is None and isinstance(chosen, Tolerance):
            chosen = Tolerance(mm=attainable_mm(chosen.mm, 2.0 * own_mm))
        if step_tolerance_mm is None:
            step_tolerance_mm = attainable_mm(STEP_TOLERANCE_MM, own_mm)
        if chosen == "grid":
            chosen = grid_of_same_step(values, size, unit)
        assert not isinstance(chosen, str)
        return cls(
            texture=surface,
            preset=preset,
            nominal_size_mm=size,
            nominal_height_mm=height,
            nominal_mm_per_unit=unit,
            origin_uv=origin,
            scale=scale,
            sampling=chosen,
            key_mm=key_mm,
            label=label or copy is not None,
            copy=copy,
            step_tolerance_mm=step_tolerance_mm,
            nominal_outline=shape,
        )

    def __post_init__(self) -> None:
        one_of("preset", self.preset, PRESETS)
        require_between("scale", self.scale, 0.01, 100.0)
        sides = (*self.nominal_size_mm, self.nominal_height_mm)
        for name, nominal in zip(("size x", "size y", "height"), sides, strict=True):
            least, most = SIZE_RANGE_MM
            if not least <= nominal * self.scale <= most:
                raise InputError(name, nominal, f"must be between {least:g} and {most:g} mm once scaled")
        for name, value in zip("xyz", self.nominal_mm_per_unit, strict=True):
            require_between(f"mm per unit {name}", value, 1e-6, 1e6, " mm")
        if self.copy is not None:
            require_between("copy", self.copy, 1, MAX_COPIES)
        if not 0.0 < self.step_tolerance_mm <= 1.0:
            raise InputError("step tolerance", self.step_tolerance_mm, "must be above 0 and at most 1 mm")
        if self.nominal_outline is not None:
            self._check_outline(self.nominal_outline)
        if self.key_mm is not None:
            self._check_key(self.key_mm)
        self._check_base()

    def _check_outline(self, outline: Any) -> None:
        if not isinstance(outline, Outline):
            allowed = "must be a Disc, RegularPolygon, Polygon or Ring, or a word such as disc:30"
            raise InputError("outline", outline, allowed)
        if not _same(outline.size_mm, self.nominal_size_mm):
            box = " x ".join(f"{side:g}" for side in outline.size_mm)
            raise InputError("size", self.nominal_size_mm, f"must be {box} mm, the box of the {outline}")
        if self.key_mm is not None:
            raise InputError("key", self.key_mm, f"needs a rectangular block, but the outline is a {outline}")
        if isinstance(self.sampling, SampleGrid):
            raise InputError(
                "grid",
                f"{self.sampling.nx}x{self.sampling.ny}",
                f"needs a rectangular block; use a tolerance for a {outline}",
            )

    def _check_key(self, key: float) -> None:
        most = min(self.size_mm) / 3.0
        if not 0.0 < key <= most:
            raise InputError("key", key, f"must be above 0 and at most {most:.4g} mm, a third of the shorter side")

    def _check_base(self) -> None:
        least = MIN_BASE_MM + (LABEL_DEPTH_MM if self.label else 0.0)
        if self.base_mm < least - 1e-9:
            missing = least - self.base_mm
            need = math.ceil((self.height_mm + missing) / self.scale * 100.0 - 1e-6) / 100.0
            raise InputError(
                "height",
                self.nominal_height_mm,
                f"the relief of {self.relief_mm:.4g} mm leaves a base of {self.base_mm:.4g} mm, {missing:.4g} mm less "
                f"than the {least:g} mm needed{' below the label' if self.label else ''}; "
                f"use a height of at least {need:g} mm",
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """The sides x, y of the printed block, in mm."""
        return (self.nominal_size_mm[0] * self.scale, self.nominal_size_mm[1] * self.scale)

    @property
    def height_mm(self) -> float:
        """The height of the highest point of the printed block, in mm."""
        return self.nominal_height_mm * self.scale

    @property
    def mm_per_unit(self) -> tuple[float, float, float]:
        """The millimetres per unit of u, v and height of the printed block."""
        x, y, z = self.nominal_mm_per_unit
        return (x * self.scale, y * self.scale, z * self.scale)

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The part of the plane (u, v) that the block shows."""
        (x, y), (mx, my, _), (u, v) = self.nominal_size_mm, self.nominal_mm_per_unit, self.origin_uv
        return ((u, u + x / mx), (v, v + y / my))

    @cached_property
    def surface(self) -> Surface:
        """The formula in mm over (x, y) of the block frame, without the offset :attr:`datum_mm`."""
        x, y, z = self.mm_per_unit
        width, depth = self.size_mm
        return self.texture.surface.mapped((x, y), z, self.origin_uv, "mm").over((0.0, width), (0.0, depth))

    @cached_property
    def region(self) -> LoopRegion | None:
        """The part of the rectangle that belongs to the block; None for the whole rectangle."""
        return self.outline if self.key_mm is None else without_key(self.size_mm, self.key_mm)

    @cached_property
    def extremes(self) -> Extremes:
        """The lowest and the highest value of :attr:`surface` over the top of the block, without the key, in mm."""
        return extremes_on(self.surface, self.size_mm, self.region)

    @property
    def formula_datum_mm(self) -> float:
        """The height z of the formula's zero if the formula's highest point lies at :attr:`height_mm`, in mm."""
        return self.height_mm - self.extremes.high

    @cached_property
    def datum_mm(self) -> float:
        """The height z of the formula's zero in the mesh, in mm.

        If the mesh has a sample grid, its highest vertex lies at :attr:`height_mm`.
        """
        if isinstance(self.sampling, Tolerance):
            return self.formula_datum_mm
        return self.height_mm - highest_sample(self.surface, self.samples_mm, self.region)

    @property
    def solid_datum_mm(self) -> float:
        """The height z of the formula's zero in the solid, in mm, whose highest point lies at :attr:`height_mm`."""
        return self.formula_datum_mm

    @property
    def samples_mm(self) -> tuple[Floats, Floats]:
        """Return the coordinates x (nx,) and y (ny,) of the sample grid, in mm.

        Raises:
            InputError: The mesh has a tolerance and no sample grid.
        """
        if not isinstance(self.sampling, SampleGrid):
            raise InputError("sampling", None, "the mesh of this block has a tolerance and no sample grid")
        return self.sampling.lines(self.size_mm)

    @property
    def relief_mm(self) -> float:
        """The peak-to-peak height of the formula over the top of the block, in mm."""
        return self.extremes.high - self.extremes.low

    @property
    def base_mm(self) -> float:
        """The thickness below the lowest valley of the formula, in mm."""
        return self.height_mm - self.relief_mm

    @property
    def grid_aliases(self) -> bool:
        """Whether the sample grid has too few samples for the finest wave (fewer than two per period)."""
        if not isinstance(grid := self.sampling, SampleGrid):
            return False
        (x, y), (f, g) = self.size_mm, self.surface.highest_frequency
        return f * x / (grid.nx - 1) > math.pi or g * y / (grid.ny - 1) > math.pi

    def height_at(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return the height of the formula above the underside, with the offset of the mesh.

        Args:
            x: The coordinates along x, in mm, from 0 at the corner of the block.
            y: The coordinates along y, in mm. They must broadcast with ``x``.

        Returns:
            The heights z in mm, with the broadcast shape.
        """
        return self.datum_mm + self.surface(x, y)

    @cached_property
    def engraving(self) -> Engraving | None:
        """The label in the underside; None if the block has none."""
        if not self.label:
            return None
        return engrave(self.label_words, self.size_mm, self.region)

    @property
    def label_words(self) -> tuple[str, ...]:
        """The words of the label: texture, preset, scale and copy."""
        first = f"T{self.texture.number}" if self.texture.number else self.texture.name.upper()
        copy = () if self.copy is None else (f"{self.copy:02d}",)
        return (first, self.preset.upper(), f"X{decimal(self.scale)}", *copy)

    @cached_property
    def outline(self) -> Outline | None:
        """The outline of the printed block; None for a rectangle, with or without a key."""
        return None if self.nominal_outline is None else self.nominal_outline.scaled(self.scale)

    @property
    def silhouette(self) -> tuple[tuple[float, float], float, float | None, Outline | None]:
        """Sides, height, key and outline, from which a holder is made. Blocks with the same values fit one holder.

        The numbers are rounded, so that blocks that were computed differently are equal.
        """
        x, y = self.size_mm if self.outline is None else self.outline.size_mm
        key = None if self.key_mm is None else round(self.key_mm, 9)
        return ((round(x, 9), round(y, 9)), round(self.height_mm, 9), key, self.outline)

    @property
    def footprint_mm2(self) -> float:
        """The area inside the outline of the underside, in mm^2."""
        x, y = self.size_mm
        return x * y if self.region is None else self.region.area_mm2

    def volume_mm3(self, datum_mm: float) -> float:
        """Return the volume below the formula in closed form, without the key and the label, in mm^3.

        Args:
            datum_mm: The height z of the formula's zero: :attr:`datum_mm` or :attr:`solid_datum_mm`.
        """
        x, y = self.size_mm
        region = self.region
        relief = self.surface.integral((0.0, x), (0.0, y)) if region is None else region.integral(self.surface)
        engraved = self.engraving.volume_mm3 if self.engraving else 0.0
        return datum_mm * self.footprint_mm2 + relief - engraved

    @property
    def name(self) -> str:
        """The name of the STL and 3MF files: texture, preset and scale, then all values that are not the default.

        The defaults of the sides and the height are those of the preset. The defaults of the mm per unit and of the
        origin are those of the texture's own file.
        """
        own = self.sampling
        return self._name(own.mm if isinstance(own, Tolerance) and own != VALUES[self.preset].sampling else None)

    @property
    def solid_name(self) -> str:
        """The name of the STEP file, which differs from :attr:`name` because a solid has its own tolerance."""
        own = self.step_tolerance_mm
        return self._name(own if own != STEP_TOLERANCE_MM else None)

    def _name(self, tolerance_mm: float | None) -> str:
        values, sampling = VALUES[self.preset], self.sampling
        parts = [self.texture.name, self.preset, f"x{decimal(self.scale)}"]
        if self.nominal_outline is not None:
            parts.append(self.nominal_outline.word)
            if self.nominal_height_mm != values.height_mm:
                parts.append(f"h{decimal(self.nominal_height_mm)}")
        elif (*self.nominal_size_mm, self.nominal_height_mm) != (*values.size_mm, values.height_mm):
            parts.append("x".join(decimal(side) for side in (*self.nominal_size_mm, self.nominal_height_mm)))
        _, mm_per_unit, origin_uv, _ = with_table(values, self.texture.block, self.texture.surface)
        if self.nominal_mm_per_unit != mm_per_unit:
            parts.append("mm" + "x".join(decimal(factor) for factor in self.nominal_mm_per_unit))
        if self.origin_uv != origin_uv:
            parts.append("from" + "x".join(decimal(shift) for shift in self.origin_uv))
        if self.key_mm is not None:
            parts.append(f"key{decimal(self.key_mm)}")
        if isinstance(sampling, SampleGrid) and sampling != values.sampling:
            parts.append(f"grid{sampling.nx}x{sampling.ny}")
        if tolerance_mm is not None:
            parts.append(f"tol{decimal(tolerance_mm)}")
        if self.label and self.copy is None:
            parts.append("label")
        if self.copy is not None:
            parts.append(f"copy{self.copy:02d}")
        return "_".join(parts)

    @property
    def title(self) -> str:
        """The texture, preset and size in one line."""
        if self.outline is not None:
            return f"{self.texture.name}, preset {self.preset}, {self.outline}, {self.height_mm:g} mm high"
        x, y = self.size_mm
        return f"{self.texture.name}, preset {self.preset}, {x:g} x {y:g} x {self.height_mm:g} mm"

    def __str__(self) -> str:
        """A dimension report."""
        (u0, u1), (v0, v1) = self.domain
        in_mm = self.texture.surface.unit == "mm"
        x, y = ("x", "y") if in_mm else ("u", "v")
        shortest = [f"{2.0 * math.pi / k:.4g} mm" if k else "none" for k in self.surface.highest_frequency]
        lines = {
            "name": self.name,
            "z": self.texture.equation,
            "size": mm(*self.size_mm, self.height_mm),
            **({"outline": str(self.outline)} if self.outline is not None else {}),
            "relief": f"{mm(self.relief_mm)} from the lowest valley to the highest point",
            "base": f"{mm(self.base_mm)} below the lowest valley",
            "volume": f"{self.volume_mm3(self.datum_mm):.6g} mm^3",
            "mm per unit": ", ".join(f"{one:.6g}" for one in self.mm_per_unit)
            + (" (a texture in mm)" if in_mm else " of u, v, z"),
            "domain": f"{x} {u0:.6g} to {u1:.6g}, {y} {v0:.6g} to {v1:.6g}",
            "finest wave": f"{shortest[0]} along x, {shortest[1]} along y",
            "mesh": self.sampling_in_words,
            "key": mm(self.key_mm) + " at the corner (x, 0)" if self.key_mm is not None else "none",
            "label": " ".join(self.label_words) if self.label else "none",
        }
        return report(self.title, lines)

    @property
    def sampling_in_words(self) -> str:
        """How the mesh follows the formula."""
        if isinstance(self.sampling, Tolerance):
            return f"within {mm(self.sampling.mm)} of the formula"
        coarse = "; too coarse for the finest wave, so it draws another shape" if self.grid_aliases else ""
        return f"joins {self.sampling.nx} x {self.sampling.ny} samples{coarse}"


def extremes_on(surface: Surface, size_mm: tuple[float, float], region: LoopRegion | None) -> Extremes:
    """Return the lowest and the highest value of a surface in mm over a rectangle from (0, 0), or its part in a region.

    Args:
        surface: The surface.
        size_mm: The sides of the rectangle.
        region: The region inside of the rectangle; None for the whole rectangle.
    """
    x, y = size_mm
    whole = surface.extremes((0.0, x), (0.0, y))
    if region is None or np.all(region.distance(*np.transpose([whole.at_low, whole.at_high])) <= 0.0):
        return whole
    return surface.extremes((0.0, x), (0.0, y), region)


def _same(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return all(abs(a - b) <= 1e-9 * max(a, b) for a, b in zip(one, other, strict=True))
