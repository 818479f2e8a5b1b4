"""What each part of a call of ``make`` is built from, in a shape that can be handed to a child process."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from tacbench_cad.spec.block import Block

if TYPE_CHECKING:
    from housing.coupon import Coupon
    from housing.holder import Holder
    from housing.jig import Jig
    from tacbench_cad.geometry.part import Part

#: Modules without which there are no fixtures.
FIXTURE_MODULES = ("OCP", "build123d")


@dataclass(frozen=True, eq=False)
class Source:
    """What a part is built from, and the formats to write it in. Apart from the part itself it can be pickled.

    Args:
        maker: A block or a fixture.
        step_tolerance_mm: How close a block's solid stays to the formula; None for the default.
        formats: In the order of :data:`tacbench_cad.formats.FORMATS`.
    """

    maker: Block | Holder | Jig | Coupon
    step_tolerance_mm: float | None
    formats: tuple[str, ...]

    @cached_property
    def part(self) -> Part:
        """The part, described but not yet built."""
        return part_of(self.maker, self.step_tolerance_mm)

    @property
    def name(self) -> str:
        """Stem of the file names."""
        return self.part.name

    @property
    def mesh_formats(self) -> tuple[str, ...]:
        """Its formats without those that hold a solid."""
        return tuple(name for name in self.formats if name != "step")

    @property
    def effort(self) -> float:
        """Larger for a block whose solid takes longer."""
        if not isinstance(self.maker, Block):
            return 0.0
        f, g = self.maker.texture.waves.highest_frequency
        return (1.0 + f) * (1.0 + g)


def part_of(maker: Block | Holder | Jig | Coupon, step_tolerance_mm: float | None) -> Part:
    """The part that a block or a fixture describes."""
    if isinstance(maker, Block):
        from tacbench_cad.geometry.block_part import block_part

        return (
            block_part(maker) if step_tolerance_mm is None else block_part(maker, step_tolerance_mm=step_tolerance_mm)
        )
    return maker.part()
