"""The parts of one call of ``make`` and what each is built from, in a shape that can be handed to a child process."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from tacbench_cad.block import Block

if TYPE_CHECKING:
    from housing.coupon import Coupon
    from housing.holder import Holder
    from housing.jig import Jig
    from tacbench_cad.making.assembly import Assembly
    from tacbench_cad.part import Part

#: Modules without which there are no fixtures.
FIXTURE_MODULES = ("OCP", "build123d")


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Something that is not made, and why."""

    what: str
    reason: str

    def as_dict(self) -> dict[str, str]:
        """For JSON."""
        return {"what": self.what, "reason": self.reason}


@dataclass(frozen=True, eq=False)
class Source:
    """What a part is built from, and the formats to write it in. Apart from the part itself it can be pickled.

    Args:
        maker: A block or a fixture.
        step_tolerance_mm: How close a block's solid stays to the formula; None for the default.
        formats: In the order of :data:`tacbench_cad.export.FORMATS`.
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
        from tacbench_cad.block_part import block_part

        return (
            block_part(maker) if step_tolerance_mm is None else block_part(maker, step_tolerance_mm=step_tolerance_mm)
        )
    return maker.part()


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The parts of one call, each with its formats, in the order in which they are listed."""

    sources: tuple[Source, ...]
    left_out: tuple[LeftOut, ...] = field(default=())
    assemblies: tuple[Assembly, ...] = field(default=())

    @property
    def file_count(self) -> int:
        """How many files it means."""
        return sum(len(one.formats) for one in self.sources) + sum(len(one.formats) for one in self.assemblies)

    @property
    def needs_kernel(self) -> tuple[str, ...]:
        """Modules that must be importable for this plan."""
        if any(source.part.mesh_needs_cad for source in self.sources):
            return FIXTURE_MODULES
        return ("OCP",) if any("step" in source.formats for source in self.sources) else ()

    def without_kernel(self, reason: str) -> Plan:
        """The same without solids and fixtures, because the kernel cannot be loaded."""
        kept = [
            Source(source.maker, source.step_tolerance_mm, tuple(f for f in source.formats if f != "step"))
            for source in self.sources
            if not source.part.mesh_needs_cad
        ]
        gone = [s.part.kind for s in self.sources if s.part.mesh_needs_cad]
        what = ", ".join(dict.fromkeys(["step" if any("step" in s.formats for s in self.sources) else "", *gone]))
        left = LeftOut(what=what.strip(", "), reason=reason)
        return Plan(sources=tuple(s for s in kept if s.formats), left_out=(*self.left_out, left))
