"""The options of ``tacbench make``, and the plan of parts, formats and omissions that follows from them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from housing.assembly import ASSEMBLY_FORMATS, assemblies_of
from housing.fits import require_key
from housing.fixture import Fixture
from housing.kinds import FIXTURES
from tacbench_cad.formats import FORMATS
from tacbench_cad.making.planning import FIXTURE_MODULES, FileSource, LeftOut, Plan
from tacbench_cad.spec.block import MAX_COPIES, Block
from tacbench_cad.spec.outlines import Outline
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.texture_files import find_textures
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError, MissingToolError, one_of, require_between
from tacbench_cad.util.packages import require, why_missing

#: The words that ``--parts`` accepts.
PARTS = ("blocks", *FIXTURES)


@dataclass(frozen=True, kw_only=True)
class Request:
    """The options of ``make``. Lengths in mm; None stands for the default.

    Args:
        textures: Numbers or names of the six textures, paths of TOML files, ``all``, or texture objects.
        preset: ``paper`` or ``released``.
        scale: The factor for sides, height, mm per unit and press grid.
        size_mm: The sides x, y of a block.
        outline: The outline of a block: an object or a word, see :meth:`tacbench_cad.spec.block.Block.of`; None for a
            rectangle.
        height_mm: The height of a block's highest point.
        mm_per_unit: The number of mm per unit of u, v and height.
        sampling: The tolerance or the grid of the meshes in STL and 3MF files; ``"grid"`` for the preset's own grid.
        formats: Names of :data:`tacbench_cad.formats.FORMATS`; None for all formats that can be written here.
        parts: Some of blocks, holder, jig, coupon, and parts of your own (anything that
            :func:`tacbench_cad.export` accepts); None for blocks, holder and jig if they can be made here.
        copies: The number of copies of each block. The label contains the number of the copy.
        label: Whether the undersides are engraved.
        key_mm: The leg of the key.
        full: Whether the slow checks are done as well.
        out: The output folder.
        fit: The clearance of the pockets: the name of a fit or mm per side.
        rim_mm: The height from the holder's rim to the block's highest point.
        slots: The number of pockets of the holder.
        nozzle_mm: The width of the nozzle for which the fixtures must be printable.
        jig: ``"default"``, or ``"all"`` for a jig with 25 holes.
        step_tolerance_mm: The largest vertical distance of the solids in STEP files from the formula.
        assembly: Whether holder, blocks and jig are also written together as one file.
    """

    textures: tuple[str | int | Path | Texture, ...] = ("all",)
    preset: str = "paper"
    scale: float = 1.0
    size_mm: tuple[float, float] | None = None
    outline: Outline | str | None = None
    height_mm: float | None = None
    mm_per_unit: tuple[float, float, float] | None = None
    sampling: Tolerance | SampleGrid | Literal["grid"] | None = None
    formats: tuple[str, ...] | None = None
    parts: tuple[Any, ...] | None = None
    copies: int | None = None
    label: bool = False
    key_mm: float | None = None
    full: bool = False
    out: Path = Path("stl_out")
    fit: str | float | None = None
    rim_mm: float | None = None
    slots: int | None = None
    nozzle_mm: float | None = None
    jig: str | None = None
    step_tolerance_mm: float | None = None
    assembly: bool = False


def plan(request: Request) -> Plan:
    """Make the plan of a request. Nothing is written. All errors that can be detected without building are raised here.

    Raises:
        InputError: An option is not allowed, or two parts would have the same name.
        MissingToolError: A format or part in the request needs a package that is not installed.
    """
    left_out: list[LeftOut] = []
    formats = _formats(request, left_out)
    kinds = _kinds(request, left_out)
    blocks = blocks_of(request)
    sources: list[FileSource] = []
    if "blocks" in kinds:
        sources += _block_sources(request, blocks, formats, left_out)
    sources += [FileSource(thing=fixture, formats=formats) for fixture in _fixtures(request, kinds, blocks, left_out)]
    own = [part for part in request.parts or () if not isinstance(part, str)]
    sources += [_without_missing(FileSource(thing=part, formats=formats, foreign=True), left_out) for part in own]
    _require_distinct(sources)
    assemblies = _assemblies(formats, sources, left_out) if request.assembly else ()
    return Plan(sources=tuple(sources), left_out=tuple(left_out), assemblies=assemblies)


def _assemblies(
    formats: Sequence[str], sources: Sequence[FileSource], left_out: list[LeftOut]
) -> tuple[FileSource, ...]:
    """Return an assembly for each holder."""
    require("assembly:", *FIXTURE_MODULES)
    written = tuple(name for name in formats if name in ASSEMBLY_FORMATS)
    if not written:
        raise InputError("formats", ",".join(formats), f"--assembly needs one of {', '.join(ASSEMBLY_FORMATS)}")
    assemblies, over = assemblies_of([source.thing for source in sources])
    left_out += [LeftOut(what=what, reason=reason) for what, reason in over]
    chosen = [_without_missing(FileSource(thing=assembly, formats=written), left_out) for assembly in assemblies]
    chosen = [source for source in chosen if source.formats]
    if not chosen:
        raise InputError("assembly", None, "needs a holder and a block that fits into it; add both to --parts")
    return tuple(chosen)


def _without_missing(source: FileSource, left_out: list[LeftOut]) -> FileSource:
    """Return the source, without STEP if its part has no solid."""
    if "step" not in source.formats or source.part.make_solid is not None:
        return source
    left_out.append(LeftOut(what=source.files["step"], reason=source.part.no_solid or "this part has no solid"))
    return source.without_step()


def _chosen(option: str, given: Sequence[str], allowed: Iterable[str]) -> tuple[str, ...]:
    """Return the given words in the order of the allowed words."""
    words = list(allowed)
    for word in given:
        one_of(option, word, words)
    if not given:
        raise InputError(option, "", "allowed: " + ", ".join(words))
    return tuple(word for word in words if word in given)


def _formats(request: Request, left_out: list[LeftOut]) -> tuple[str, ...]:
    missing = {name: reason for name, row in FORMATS.items() if (reason := row.why_missing())}
    if request.formats is None:
        left_out += [LeftOut(what=name, reason=reason) for name, reason in missing.items()]
        return tuple(name for name in FORMATS if name not in missing)
    formats = _chosen("formats", request.formats, FORMATS)
    for name in formats:
        if name in missing:
            raise MissingToolError(f"formats = {name!r}: {missing[name]}")
    return formats


def _kinds(request: Request, left_out: list[LeftOut]) -> tuple[str, ...]:
    """Return the words of :data:`PARTS` that the request contains."""
    reason = why_missing(*FIXTURE_MODULES)
    if request.parts is None:
        kinds = [kind for kind, fixture in FIXTURES.items() if fixture.by_default]
        if reason is None:
            return ("blocks", *kinds)
        for option, users in _users().items():
            if len(users) == 1 and getattr(request, option) is not None:
                raise MissingToolError(f"{option} = {getattr(request, option)!r}: {reason}")
        left_out.append(LeftOut(what=", ".join(kinds), reason=reason))
        return ("blocks",)
    words = [part for part in request.parts if isinstance(part, str)]
    parts = _chosen("parts", words, PARTS) if words or not request.parts else ()
    fixtures = [part for part in parts if part in FIXTURES]
    if fixtures and reason:
        raise MissingToolError(f"parts = {', '.join(fixtures)!r}: {reason}")
    for option, users in _users().items():
        value = getattr(request, option)
        if value is not None and not set(users) & set(fixtures):
            name = option.removesuffix("_mm")
            raise InputError(name, value, f"is an option of {', '.join(users)}, which --parts does not contain")
    return parts


def _users() -> dict[str, list[str]]:
    """Return the fixtures that use each option of fixtures."""
    options = dict.fromkeys(option for fixture in FIXTURES.values() for option in fixture.options)
    return {option: [kind for kind, fixture in FIXTURES.items() if option in fixture.options] for option in options}


def asks_for_cad(request: Request) -> bool:
    """Return whether the request names something that needs the CAD kernel, so that it must not be left out."""
    words = {part for part in request.parts or () if isinstance(part, str)}
    alone = any(len(users) == 1 and getattr(request, option) is not None for option, users in _users().items())
    return bool("step" in (request.formats or ()) or words - {"blocks"} or alone or request.assembly)


def blocks_of(request: Request) -> list[Block]:
    """Return the blocks without their copies.

    Raises:
        InputError: An option of the blocks is not allowed.
    """
    if request.copies is not None:
        require_between("copies", request.copies, 1, MAX_COPIES)
    textures = find_textures(request.textures, request.preset)
    blocks: dict[str, Block] = {}
    # The highest relief comes first, so that an error message suggests a height that is sufficient for all blocks.
    for texture in sorted(textures, key=lambda texture: -texture.surface.amplitude_sum):
        blocks[texture.name] = Block.of(
            texture,
            request.preset,
            mm_per_unit=request.mm_per_unit,
            size_mm=request.size_mm,
            outline=request.outline,
            height_mm=request.height_mm,
            scale=request.scale,
            sampling=request.sampling,
            key_mm=request.key_mm,
            label=request.label or request.copies is not None,
            step_tolerance_mm=request.step_tolerance_mm,
        )
    return [blocks[texture.name] for texture in textures]


def _block_sources(
    request: Request, blocks: Sequence[Block], formats: tuple[str, ...], left_out: list[LeftOut]
) -> list[FileSource]:
    sources = []
    for block in blocks:
        copies = [block] if request.copies is None else [replace(block, copy=i + 1) for i in range(request.copies)]
        for copy in copies:
            _ = copy.engraving  # raises InputError if the label does not fit
            source = FileSource(thing=copy, formats=formats)
            if formats == ("step",) and source.part.no_solid and "all" not in request.textures:
                raise InputError("formats", "step", f"{block.texture.name}: {source.part.no_solid}")
            source = _without_missing(source, left_out)
            if source.formats:
                sources.append(source)
    return sources


def _fixtures(
    request: Request, kinds: Sequence[str], blocks: Sequence[Block], left_out: list[LeftOut]
) -> list[Fixture]:
    """Return the fixtures of the request: one for each outline among the blocks, or one for all blocks.

    If a fixture cannot be made for these blocks, it is left out with the reason. If --parts or an option of the fixture
    requests it, the reason is raised as an error.
    """
    chosen = [fixture for kind, fixture in FIXTURES.items() if kind in kinds]
    options = {name: value for name in _users() if (value := getattr(request, name)) is not None}
    fixtures: list[Fixture] = []
    for block in _distinct(blocks):
        if block.key_mm is not None:
            require_key(block, "slip" if request.fit is None else request.fit)
        refused: dict[str, list[str]] = {}
        for kind in (fixture for fixture in chosen if fixture.for_each_outline):
            try:
                fixtures.append(kind.requested(block, options))
            except InputError as error:
                insists = any(getattr(request, option) is not None for option in kind.asked_by)
                if request.parts is not None or insists:
                    raise
                refused.setdefault(str(error), []).append(kind.kind)
        left_out += [LeftOut(what=", ".join(names), reason=reason) for reason, names in refused.items()]
    fixtures += [kind.requested(blocks[0], options) for kind in chosen if not kind.for_each_outline]
    return sorted(fixtures, key=lambda fixture: list(FIXTURES).index(fixture.kind))


def _distinct(blocks: Sequence[Block]) -> list[Block]:
    """Return the first block of each outline, because fixtures depend only on the outline."""
    distinct: dict[object, Block] = {}
    for block in blocks:
        distinct.setdefault(block.silhouette, block)
    return list(distinct.values())


def _require_distinct(sources: Sequence[FileSource]) -> None:
    names = [source.part.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise InputError("parts", name, "two parts would have this name; make them in two calls")
