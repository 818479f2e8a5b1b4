"""The blocks that a file may contain: the one that the user expects, the one that it claims, or all known ones."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tacbench_cad.checks.body_shape import BodyShape
from tacbench_cad.checks.match import Candidate, FoundPlacement
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.texture_files import find_textures
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError, one_of

#: The largest difference of the scales along x and y of a scaled block, as a fraction of the scale.
MAX_SCALE_DIFFERENCE = 2e-3
#: Round scales are the multiples of this number.
ROUND_SCALE = 0.25
#: A scale that differs from a round scale by at most this fraction counts as the round scale. The file then has a wrong
#: size.
ROUNDING_FRACTION = 0.04
#: The largest allowed difference of a side from its expected length, in mm.
SIDE_MM = 2e-3

_SAMPLINGS: dict[str, tuple[Tolerance | Literal["grid"], ...]] = {
    "paper": (Tolerance(), "grid"),
    "released": ("grid", Tolerance()),
}


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """What the file is expected to contain.

    Args:
        texture: A texture, its number or name, or the path of a TOML file; None for any texture.
        preset: ``paper`` or ``released``; None for any preset.
        scale: The scale; None to compute it from the sides.
        claim: The block that a file of this package claims to contain; None for other files.
        later: Whether the authors' later textures are meant if no texture is given, and not the six of the paper.
    """

    texture: Texture | str | Path | None = None
    preset: str | None = None
    scale: float | None = None
    claim: Block | None = None
    later: bool = False

    def __post_init__(self) -> None:
        if self.preset is not None:
            one_of("preset", self.preset, PRESETS)
        self.textures("paper")

    @property
    def is_open(self) -> bool:
        """Whether neither texture nor preset was given."""
        return self.texture is None and self.preset is None

    def textures(self, preset: str) -> tuple[Texture, ...]:
        """Return the possible textures of a preset."""
        return tuple(find_textures((self.texture or ("later" if self.later else "all"),), preset))

    @property
    def claimed(self) -> Block | None:
        """The block that the file claims to contain, with the user's texture and scale if they are given."""
        block = self.claim
        if block is None or self.preset not in (None, block.preset):
            return None
        texture = block.texture if self.texture is None else self.textures(block.preset)[0]
        try:
            return dataclasses.replace(block, texture=texture, scale=self.scale or block.scale)
        except InputError:
            return None

    def __call__(self, shape: BodyShape, placement: FoundPlacement) -> Iterator[Candidate]:
        """Yield the candidates for a placement, in order of preference.

        Args:
            shape: The shape. Its sides determine the scale if no scale is given.
            placement: The placement. Its turn determines which side is x.
        """
        claimed = self.claimed
        blocks = [claimed] if claimed is not None else list(self._blocks(placement.sides(shape.size_mm)))
        for block in blocks:
            yield Candidate(block, as_solid=shape.is_solid)
            stretch = stretch_of(block, shape, placement)
            if max(abs(factor - 1.0) for factor in stretch) > 1e-4:
                yield Candidate(block, as_solid=shape.is_solid, stretch=stretch)

    def _blocks(self, sides_mm: tuple[float, float]) -> Iterator[Block]:
        presets = PRESETS if self.preset is None else (self.preset,)
        for preset in presets:
            for texture in self.textures(preset):
                for sampling in _SAMPLINGS[preset]:
                    if preset == self.preset == "released" and sampling != "grid":
                        continue
                    try:
                        block = _known(texture, preset, sampling, 1.0)
                        scale = self.scale or scale_of(block, sides_mm)
                        yield _known(texture, preset, sampling, scale)
                    except InputError:
                        continue


@functools.lru_cache(maxsize=128)
def _known(texture: Texture, preset: str, sampling: Tolerance | Literal["grid"], scale: float) -> Block:
    """Return the block of a preset at a scale.

    The blocks are cached, because computing their extreme heights takes most of the time of a check.
    """
    return Block.of(texture, preset, sampling=sampling, scale=scale)


def stretch_of(block: Block, shape: BodyShape, placement: FoundPlacement) -> tuple[float, float, float]:
    """Return the sides x, y and z of a shape, as multiples of the sides of a block."""
    x, y = placement.sides(shape.size_mm)
    return (x / block.size_mm[0], y / block.size_mm[1], shape.size_mm[2] / block.height_mm)


def scale_of(block: Block, sides_mm: tuple[float, float]) -> float:
    """Compute the scale from the sides of a file; return 1 if the two sides do not give the same scale.

    A scale within 4 % of a multiple of 0.25 counts as this multiple. Such a small difference is more likely a mistake
    (or shrinkage) than intended, so the check reports it as a wrong size. The files of this package state their
    exact scale, and for other files the user can state any scale.
    """
    along_x, along_y = sides_mm[0] / block.nominal_size_mm[0], sides_mm[1] / block.nominal_size_mm[1]
    if abs(along_x - along_y) > MAX_SCALE_DIFFERENCE * along_x:
        return 1.0
    scale = (along_x + along_y) / 2.0
    rounded = round(scale / ROUND_SCALE) * ROUND_SCALE
    if rounded > 0.0 and abs(scale / rounded - 1.0) <= ROUNDING_FRACTION:
        return rounded
    return float(f"{scale:.4g}")
