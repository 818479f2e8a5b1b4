"""The plan of a call of ``make``: parts and assemblies with their formats, and omissions with their reasons."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.geometry.part import PrintPart

#: The modules that fixtures need.
FIXTURE_MODULES = ("OCP",)


def file_name(part: PrintPart, format_name: str) -> str:
    """Return the name of a part's file in a format."""
    return f"{part.stem(FORMATS[format_name].shape)}{FORMATS[format_name].suffix}"


@dataclass(frozen=True, eq=False, kw_only=True)
class FileSource:
    """An object that becomes a part, and the file formats of the part.

    Args:
        thing: A block, a fixture, an assembly, or a part of the user.
        formats: The formats, in the order of :data:`tacbench_cad.formats.FORMATS`.
        foreign: Whether it is a part of the user. A child process may not be able to import such a part.
    """

    thing: Any
    formats: tuple[str, ...]
    foreign: bool = False

    @cached_property
    def part(self) -> PrintPart:
        """The part. Its geometry is built when it is needed."""
        return as_part(self.thing)

    @property
    def in_child(self) -> bool:
        """Whether a child process makes all files, because the mesh also needs the CAD kernel."""
        return self.part.mesh_needs_cad and not self.foreign

    @property
    def slow_formats(self) -> tuple[str, ...]:
        """The formats that a child process makes."""
        if self.foreign:
            return ()
        return self.formats if self.in_child else tuple(name for name in self.formats if name == "step")

    @property
    def own_formats(self) -> tuple[str, ...]:
        """The formats that this process makes."""
        return tuple(name for name in self.formats if name not in self.slow_formats)

    @property
    def files(self) -> dict[str, str]:
        """The file names by format."""
        return {name: file_name(self.part, name) for name in self.formats}

    @property
    def effort(self) -> float:
        """A number that is larger for blocks with slower solids."""
        if self.part.block is None:
            return 0.0
        f, g = self.part.block.texture.surface.highest_frequency
        return (1.0 + f) * (1.0 + g)

    def without_step(self) -> FileSource:
        """Return the source without the format STEP."""
        return replace(self, formats=tuple(name for name in self.formats if name != "step"))


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Files or parts that are left out.

    Args:
        what: The names of the files or parts.
        reason: The reason, and what to do about it.
    """

    what: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The parts of a call with their formats, in the order of the output.

    Args:
        sources: The blocks, the fixtures and the user's parts.
        left_out: The files and parts that are left out.
        assemblies: The assemblies of these parts.
    """

    sources: tuple[FileSource, ...]
    left_out: tuple[LeftOut, ...] = ()
    assemblies: tuple[FileSource, ...] = ()

    @property
    def file_count(self) -> int:
        """The number of files."""
        return sum(len(source.formats) for source in (*self.sources, *self.assemblies))

    @property
    def needs_kernel(self) -> tuple[str, ...]:
        """The modules that child processes must be able to import for this plan."""
        if any(source.in_child for source in self.sources):
            return FIXTURE_MODULES
        return ("OCP",) if any(source.slow_formats for source in self.sources) else ()

    def without_kernel(self, reason: str) -> Plan:
        """Return the plan without solids and fixtures, because the kernel cannot be loaded."""
        kept = [source if source.foreign else source.without_step() for source in self.sources if not source.in_child]
        gone = [source.part.kind for source in self.sources if source.in_child]
        steps = ["step"] if any("step" in source.formats for source in self.sources) else []
        left = LeftOut(what=", ".join(dict.fromkeys([*steps, *gone])), reason=reason)
        return Plan(sources=tuple(source for source in kept if source.formats), left_out=(*self.left_out, left))
