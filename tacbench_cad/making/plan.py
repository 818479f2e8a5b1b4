"""What one call of ``make`` makes: parts and assemblies, each with its formats, and what is left out and why."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.geometry.part import Part

#: Modules without which there are no fixtures.
FIXTURE_MODULES = ("OCP", "build123d")


def file_name(part: Part, format_name: str) -> str:
    """Name of a part's file in one format."""
    return f"{part.stem(FORMATS[format_name].shape)}{FORMATS[format_name].suffix}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """What a part is built from, and the formats to write it in.

    Args:
        thing: A block, a fixture, an assembly, or a part of the user's own.
        formats: In the order of :data:`tacbench_cad.formats.FORMATS`.
        foreign: Whether it is the user's own, which a child process may not be able to import.
    """

    thing: Any
    formats: tuple[str, ...]
    foreign: bool = False

    @cached_property
    def part(self) -> Part:
        """The part, described but not yet built."""
        return as_part(self.thing)

    @property
    def in_child(self) -> bool:
        """Whether all of it is made in a child process, because the CAD kernel makes its mesh as well."""
        return self.part.mesh_needs_cad and not self.foreign

    @property
    def slow_formats(self) -> tuple[str, ...]:
        """Its formats that are made in a child process."""
        if self.foreign:
            return ()
        return self.formats if self.in_child else tuple(name for name in self.formats if name == "step")

    @property
    def own_formats(self) -> tuple[str, ...]:
        """Its formats that this process can make."""
        return tuple(name for name in self.formats if name not in self.slow_formats)

    @property
    def files(self) -> dict[str, str]:
        """File names by format."""
        return {name: file_name(self.part, name) for name in self.formats}

    @property
    def effort(self) -> float:
        """Larger for a block whose solid takes longer."""
        if self.part.block is None:
            return 0.0
        f, g = self.part.block.texture.waves.highest_frequency
        return (1.0 + f) * (1.0 + g)

    def without_step(self) -> Source:
        """The same without STEP."""
        return replace(self, formats=tuple(name for name in self.formats if name != "step"))


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Something that is not made, and why.

    Args:
        what: What is left out.
        reason: Why, and how to get it.
    """

    what: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The parts of one call, each with its formats, in the order in which they are listed.

    Args:
        sources: Blocks, fixtures and parts of the user's own.
        left_out: What is not made.
        assemblies: What is put together of them.
    """

    sources: tuple[Source, ...]
    left_out: tuple[LeftOut, ...] = ()
    assemblies: tuple[Source, ...] = ()

    @property
    def file_count(self) -> int:
        """How many files it means."""
        return sum(len(source.formats) for source in (*self.sources, *self.assemblies))

    @property
    def needs_kernel(self) -> tuple[str, ...]:
        """Modules that must be importable in child processes for this plan."""
        if any(source.in_child for source in self.sources):
            return FIXTURE_MODULES
        return ("OCP",) if any(source.slow_formats for source in self.sources) else ()

    def without_kernel(self, reason: str) -> Plan:
        """The same without solids and fixtures, because the kernel cannot be loaded."""
        kept = [source if source.foreign else source.without_step() for source in self.sources if not source.in_child]
        gone = [source.part.kind for source in self.sources if source.in_child]
        steps = ["step"] if any("step" in source.formats for source in self.sources) else []
        left = LeftOut(what=", ".join(dict.fromkeys([*steps, *gone])), reason=reason)
        return Plan(sources=tuple(source for source in kept if source.formats), left_out=(*self.left_out, left))
