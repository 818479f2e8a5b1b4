"""What one call of ``make`` makes: parts, each with its formats, assemblies of them, and what is left out and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tacbench_cad.making.sources import FIXTURE_MODULES, Source

if TYPE_CHECKING:
    from tacbench_cad.making.assembly import Assembly


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Something that is not made, and why.

    Args:
        what: What is left out.
        reason: Why, and how to get it.
    """

    what: str
    reason: str

    def as_dict(self) -> dict[str, str]:
        """For JSON."""
        return {"what": self.what, "reason": self.reason}


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The parts of one call, each with its formats, in the order in which they are listed.

    Args:
        sources: Blocks and fixtures.
        left_out: What is not made.
        assemblies: What is put together of them.
    """

    sources: tuple[Source, ...]
    left_out: tuple[LeftOut, ...] = ()
    assemblies: tuple[Assembly, ...] = ()

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
