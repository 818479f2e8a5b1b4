"""The blocks that a file may be: what the user says of it, else what its own name says, else all that are known."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tacbench_cad.checks.claim import claimed_block
from tacbench_cad.checks.look import Look
from tacbench_cad.checks.match import Candidate, Placement
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.textures import BlockTable, Texture, catalogue, read_texture
from tacbench_cad.spec.textures import texture as find_texture
from tacbench_cad.util.errors import InputError, one_of

#: Sides that give the same scale within this fraction are a scaled preset's.
SAME_SCALE = 2e-3
#: A scale this near to a plain one is taken for that, and the difference for a fault.
NEAR_PLAIN = 0.04
#: Plain scales are multiples of this.
PLAIN = 0.25
#: Within this, in mm, a side is as wanted.
SIDE_MM = 2e-3

_SAMPLINGS: dict[str, tuple[Tolerance | Literal["grid"], ...]] = {
    "paper": (Tolerance(), "grid"),
    "released": ("grid", Tolerance()),
}


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """What the file is expected to contain.

    Args:
        texture: A texture, its number or name, or the path of a TOML file; None for any.
        preset: ``paper`` or ``released``; None for any.
        scale: The scale; None to take it from the sides.
        claim: The name that the file itself bears, if any.
    """

    texture: Texture | str | None = None
    preset: str | None = None
    scale: float | None = None
    claim: str | None = None

    def __post_init__(self) -> None:
        if self.preset is not None:
            one_of("preset", self.preset, PRESETS)
        self.textures("paper")

    @property
    def is_open(self) -> bool:
        """Whether neither texture nor preset was given."""
        return self.texture is None and self.preset is None

    @property
    def _table(self) -> BlockTable | None:
        """What a texture's own file says of its block."""
        named = self.texture
        return read_texture(Path(named)).block if isinstance(named, str) and named.endswith(".toml") else None

    def textures(self, preset: str) -> tuple[Texture, ...]:
        """The textures that come into question in a preset."""
        if self.texture is None:
            return catalogue(preset)
        if isinstance(self.texture, Texture):
            return (self.texture,)
        if self.texture.endswith(".toml"):
            return (read_texture(Path(self.texture)).texture,)
        return (find_texture(self.texture, preset),)

    @property
    def claimed(self) -> Block | None:
        """The block of the file's own name, its texture and scale replaced where the user says another."""
        if self.claim is None:
            return None
        words = self.claim.split("_")
        preset = words[1] if len(words) > 1 else ""
        if preset not in PRESETS or self.preset not in (None, preset):
            return None
        texture = self.textures(preset)[0] if self.texture is not None else None
        block = claimed_block(self.claim, texture)
        if block is None or self.scale is None:
            return block
        try:
            return dataclasses.replace(block, scale=self.scale)
        except InputError:
            return None

    def __call__(self, look: Look, placement: Placement) -> Iterator[Candidate]:
        """The candidates in order of preference, for a placement.

        Args:
            look: The shape; its sides give the scale where none is said.
            placement: Its turn decides which side is x.
        """
        claimed = self.claimed
        blocks = [claimed] if claimed is not None else list(self._blocks(placement.sides(look.size_mm)))
        for block in blocks:
            yield Candidate(block, as_solid=look.is_solid)
            stretch = stretch_of(block, look, placement)
            if max(abs(one - 1.0) for one in stretch) > 1e-4:
                yield Candidate(block, as_solid=look.is_solid, stretch=stretch)

    def _blocks(self, sides_mm: tuple[float, float]) -> Iterator[Block]:
        presets = PRESETS if self.preset is None else (self.preset,)
        for preset in presets:
            for texture in self.textures(preset):
                for sampling in _SAMPLINGS[preset]:
                    if preset == self.preset == "released" and sampling != "grid":
                        continue
                    try:
                        block = _known(texture, preset, sampling, self._table, 1.0)
                        scale = self.scale or scale_of(block, sides_mm)
                        yield _known(texture, preset, sampling, self._table, scale)
                    except InputError:
                        continue


@functools.lru_cache(maxsize=128)
def _known(
    texture: Texture, preset: str, sampling: Tolerance | Literal["grid"], table: BlockTable | None, scale: float
) -> Block:
    """The block of a preset at a scale; kept, because proving its extremes takes most of an examination's time."""
    return Block.of(texture, preset, sampling=sampling, table=table, scale=scale)


def stretch_of(block: Block, look: Look, placement: Placement) -> tuple[float, float, float]:
    """What the sides of a file's box are of a block's."""
    x, y = placement.sides(look.size_mm)
    return (x / block.size_mm[0], y / block.size_mm[1], look.size_mm[2] / block.height_mm)


def scale_of(block: Block, sides_mm: tuple[float, float]) -> float:
    """The scale that a file's sides speak of; 1 where they are not those of a scaled preset.

    A scale within 4 % of a multiple of 0.25 counts as that multiple: a size that far off is more likely a mistake (or
    shrinkage) than a wish, and shall be named. A file of ours bears its scale in its name, and any scale can be given.
    """
    along_x, along_y = sides_mm[0] / block.nominal_size_mm[0], sides_mm[1] / block.nominal_size_mm[1]
    if abs(along_x - along_y) > SAME_SCALE * along_x:
        return 1.0
    found = (along_x + along_y) / 2.0
    plain = round(found / PLAIN) * PLAIN
    if plain > 0.0 and abs(found / plain - 1.0) <= NEAR_PLAIN:
        return plain
    return float(f"{found:.4g}")
