"""A texture at a size in millimetres: the one mapping between the formula's units and the printed part.

Block frame: origin at the lower corner of the underside, x and y along the sides, z up, underside at 0, highest point
at ``height_mm``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from numpy.typing import ArrayLike

from tacbench_cad.spec.extremes import Extremes, HalfPlane
from tacbench_cad.spec.label import LABEL_DEPTH_MM, Engraving, engrave
from tacbench_cad.spec.presets import PRESETS, VALUES, grid_of_same_step, with_table
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM, SampleGrid, Tolerance, highest_sample
from tacbench_cad.spec.textures import BlockTable, Texture
from tacbench_cad.spec.textures import texture as find_texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError, one_of, require_between
from tacbench_cad.util.text import decimal, mm, report
from tacbench_cad.util.types import Floats

#: Thickness that must be left below the lowest valley (and above the label's pockets), in mm.
MIN_BASE_MM = 0.8
#: Sides and heights outside of this range are taken for mistakes, in mm.
SIZE_RANGE_MM = (0.5, 2000.0)
#: The most copies of a block.
MAX_COPIES = 999
#: The key's default leg, in mm.
KEY_MM = 3.0


@dataclass(frozen=True, kw_only=True)
class Block:
    """A texture block. Build one with :meth:`of`, which knows the presets and the order of the options.

    Args:
        texture: The surface.
        preset: Name of the preset that it began from.
        nominal_size_mm: Sides x, y before the scale.
        nominal_height_mm: Height of the highest point before the scale.
        nominal_mm_per_unit: Millimetres per unit of u, v and height before the scale.
        sampling: How the mesh follows the formula.
        origin_uv: The point (u, v) at the block's corner.
        scale: Multiplies sides, height and mm per unit.
        key_mm: Leg of the chamfered corner at (x, 0), or None.
        label: Whether texture, preset, scale and copy are engraved in the underside.
        copy: Number of this copy, or None.
        step_tolerance_mm: Greatest vertical distance of the solid, and so of a STEP file, from the formula.

    Raises:
        InputError: A field is not allowed; the message has the field, its value and what is.
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

    @classmethod
    def of(
        cls,
        texture: Texture | str | int,
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
        step_tolerance_mm: float = STEP_TOLERANCE_MM,
        table: BlockTable | None = None,
    ) -> Block:
        """A block from a preset and changes to it, taken in the order preset, mm per unit, size, height, scale.

        Args:
            texture: A texture, or the number or name of one of the six.
            preset: ``paper`` or ``released``.
            mm_per_unit: New mapping: the sides stay, the domain follows.
            size_mm: New sides: the mapping stays, the domain follows.
            height_mm: New height: only the base changes.
            scale: Multiplies sides, height and mm per unit; the domain stays.
            sampling: Tolerance or sample grid of the mesh; ``"grid"`` for the preset's own grid (at other sides the
                grid with the same step); None for the preset's default.
            key_mm: Leg of the key, or None for no key.
            label: Engrave the underside.
            copy: Copy number, which implies the label.
            step_tolerance_mm: Greatest vertical distance of the solid, and so of a STEP file, from the formula.
            table: What the texture's own file says of its block: it comes in place of the preset's values.

        Raises:
            InputError: A value is not allowed.
        """
        one_of("preset", preset, PRESETS)
        surface = texture if isinstance(texture, Texture) else find_texture(texture, preset)
        values = VALUES[preset]
        start = with_table(values, table or BlockTable())
        if preset == "released" and sampling is None and (mm_per_unit or size_mm or height_mm or start[3]):
            raise InputError(
                "preset", preset, "with other sides, height or mm per unit it needs --grid or --tolerance as well"
            )
        size, unit, origin, _ = start
        size, unit = size_mm or size, mm_per_unit or unit
        height = height_mm if height_mm is not None else (table.height_mm if table else None) or values.height_mm
        chosen = sampling if sampling is not None else values.sampling
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
        if self.key_mm is not None:
            self._check_key(self.key_mm)
        self._check_base()

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
                f"a height of {need:g} mm would do",
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """Sides x, y in mm, as printed."""
        return (self.nominal_size_mm[0] * self.scale, self.nominal_size_mm[1] * self.scale)

    @property
    def height_mm(self) -> float:
        """Height of the highest point in mm, as printed."""
        return self.nominal_height_mm * self.scale

    @property
    def mm_per_unit(self) -> tuple[float, float, float]:
        """Millimetres per unit of u, v and height, as printed."""
        x, y, z = self.nominal_mm_per_unit
        return (x * self.scale, y * self.scale, z * self.scale)

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The part of the plane (u, v) that the block shows."""
        (x, y), (mx, my, _), (u, v) = self.nominal_size_mm, self.nominal_mm_per_unit, self.origin_uv
        return ((u, u + x / mx), (v, v + y / my))

    @cached_property
    def surface(self) -> WaveSum:
        """The formula in millimetres of the block frame, up to :attr:`datum_mm`: a wave sum over (x, y)."""
        x, y, z = self.mm_per_unit
        return self.texture.waves.mapped((x, y), z, self.origin_uv)

    @property
    def keep(self) -> HalfPlane | None:
        """The half-plane that the key leaves, ``x - y <= size x - key``; None without a key."""
        return None if self.key_mm is None else HalfPlane(1.0, -1.0, self.size_mm[0] - self.key_mm)

    @cached_property
    def extremes(self) -> Extremes:
        """Lowest and highest value of :attr:`surface` over the block's own top, in mm; the key's corner left out."""
        x, y = self.size_mm
        whole = self.surface.extremes((0.0, x), (0.0, y))
        keep = self.keep
        if keep is None:
            return whole
        assert self.key_mm is not None
        parts = [
            self.surface.extremes((0.0, x - self.key_mm), (0.0, y)),
            self.surface.extremes((x - self.key_mm, x), (self.key_mm, y)),
        ]
        if max(part.high for part in parts) < whole.high or min(part.low for part in parts) > whole.low:
            parts.append(self.surface.extremes((x - self.key_mm, x), (0.0, self.key_mm), keep))
        low, high = min(parts, key=lambda part: part.low), max(parts, key=lambda part: part.high)
        return Extremes(low.low, high.high, low.at_low, high.at_high, max(part.error for part in parts))

    @property
    def formula_datum_mm(self) -> float:
        """Height z of the formula's zero when the formula's highest point lies at :attr:`height_mm`, in mm."""
        return self.height_mm - self.extremes.high

    @cached_property
    def datum_mm(self) -> float:
        """Height z of the formula's zero in the mesh, in mm: on a sample grid its highest vertex is at the height."""
        return self.formula_datum_mm if isinstance(self.sampling, Tolerance) else self._grid_datum_mm(self.sampling)

    @cached_property
    def solid_datum_mm(self) -> float:
        """Height z of the formula's zero in the solid, in mm: the grid's for ``released``, else the formula's.

        The tolerance of the mesh does not change the solid: with one, ``released`` keeps the preset's own grid here,
        where that grid draws the formula's shape.
        """
        if self.preset != "released":
            return self.formula_datum_mm
        if isinstance(self.sampling, SampleGrid):
            return self.datum_mm
        own = grid_of_same_step(VALUES[self.preset], self.nominal_size_mm, self.nominal_mm_per_unit)
        return self.formula_datum_mm if self._aliases(own) else self._grid_datum_mm(own)

    def _grid_datum_mm(self, grid: SampleGrid) -> float:
        return self.height_mm - highest_sample(self.surface, grid.lines(self.size_mm), self.keep)

    @property
    def samples_mm(self) -> tuple[Floats, Floats]:
        """The sample grid's lines x (nx,) and y (ny,), in mm.

        Raises:
            InputError: The block has a tolerance and no grid.
        """
        if not isinstance(self.sampling, SampleGrid):
            raise InputError("sampling", None, "this block follows the formula within a tolerance, it has no grid")
        return self.sampling.lines(self.size_mm)

    @property
    def relief_mm(self) -> float:
        """Peak-to-peak height of the formula over the block's top, in mm."""
        return self.extremes.high - self.extremes.low

    @property
    def base_mm(self) -> float:
        """What is left below the formula's lowest valley, in mm."""
        return self.height_mm - self.relief_mm

    @property
    def grid_aliases(self) -> bool:
        """Whether the sample grid has fewer than two samples for the finest wave: it then draws another shape."""
        return isinstance(self.sampling, SampleGrid) and self._aliases(self.sampling)

    def _aliases(self, grid: SampleGrid) -> bool:
        (x, y), (f, g) = self.size_mm, self.surface.highest_frequency
        return f * x / (grid.nx - 1) > math.pi or g * y / (grid.ny - 1) > math.pi

    def height_at(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """The formula's height above the underside, with the mesh's datum.

        Args:
            x: Places along x in mm, from 0 at the block's corner.
            y: Places along y in mm; must broadcast with ``x``.

        Returns:
            z in mm, of the broadcast shape.
        """
        return self.datum_mm + self.surface(x, y)

    @cached_property
    def engraving(self) -> Engraving | None:
        """The label in the underside, or None."""
        if not self.label:
            return None
        return engrave(self.label_words, self.size_mm, self.key_mm or 0.0)

    @property
    def label_words(self) -> tuple[str, ...]:
        """What the label says: texture, preset, scale and copy."""
        first = f"T{self.texture.number}" if self.texture.number else self.texture.name.upper()
        copy = () if self.copy is None else (f"{self.copy:02d}",)
        return (first, self.preset.upper(), f"X{decimal(self.scale)}", *copy)

    @property
    def outline(self) -> tuple[tuple[float, float], float, float | None]:
        """Sides, height and key in mm: what a holder knows of a block. Blocks of one outline fit the same holder."""
        return (self.size_mm, self.height_mm, self.key_mm)

    @property
    def footprint_mm2(self) -> float:
        """Area of the underside's outline, in mm^2."""
        x, y = self.size_mm
        return x * y - (self.key_mm or 0.0) ** 2 / 2.0

    def volume_mm3(self, datum_mm: float) -> float:
        """Volume below the formula in closed form, key and label taken into account, in mm^3.

        Args:
            datum_mm: z of the formula's zero: :attr:`datum_mm` or :attr:`solid_datum_mm`.
        """
        x, y = self.size_mm
        relief = self.surface.integral((0.0, x), (0.0, y))
        if self.key_mm is not None:
            relief -= self.surface.integral_triangle([(x - self.key_mm, 0.0), (x, 0.0), (x, self.key_mm)])
        engraved = self.engraving.volume_mm3 if self.engraving else 0.0
        return datum_mm * self.footprint_mm2 + relief - engraved

    @property
    def name(self) -> str:
        """Texture, preset, scale, then only what is not the preset's default; the file names of STL and 3MF."""
        own = self.sampling
        return self._name(own.mm if isinstance(own, Tolerance) and own != VALUES[self.preset].sampling else None)

    @property
    def solid_name(self) -> str:
        """The same for the STEP file, which has a tolerance of its own."""
        own = self.step_tolerance_mm
        return self._name(own if own != STEP_TOLERANCE_MM else None)

    def _name(self, tolerance_mm: float | None) -> str:
        values, sampling = VALUES[self.preset], self.sampling
        parts = [self.texture.name, self.preset, f"x{decimal(self.scale)}"]
        if (*self.nominal_size_mm, self.nominal_height_mm) != (*values.size_mm, values.height_mm):
            parts.append("x".join(decimal(side) for side in (*self.nominal_size_mm, self.nominal_height_mm)))
        if self.nominal_mm_per_unit != values.mm_per_unit:
            parts.append("mm" + "x".join(decimal(factor) for factor in self.nominal_mm_per_unit))
        if self.origin_uv != (0.0, 0.0):
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
        """One line for people: texture, preset and sides."""
        x, y = self.size_mm
        return f"{self.texture.name}, preset {self.preset}, {x:g} x {y:g} x {self.height_mm:g} mm"

    def __str__(self) -> str:
        """A dimension report."""
        (u0, u1), (v0, v1) = self.domain
        shortest = [f"{2.0 * math.pi / k:.4g} mm" if k else "none" for k in self.surface.highest_frequency]
        lines = {
            "name": self.name,
            "z": self.texture.equation,
            "size": mm(*self.size_mm, self.height_mm),
            "relief": f"{mm(self.relief_mm)} from the lowest valley to the highest point",
            "base": f"{mm(self.base_mm)} below the lowest valley",
            "volume": f"{self.volume_mm3(self.datum_mm):.6g} mm^3",
            "mm per unit": ", ".join(f"{one:.6g}" for one in self.mm_per_unit) + " of u, v, z",
            "domain": f"u {u0:.6g} to {u1:.6g}, v {v0:.6g} to {v1:.6g}",
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
