"""What a call of ``tacbench make`` means: which parts, in which formats, and what is left out and why."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tacbench_cad.formats import FORMATS
from tacbench_cad.making.choice import textures_of
from tacbench_cad.making.plan import LeftOut, Plan
from tacbench_cad.making.sources import FIXTURE_MODULES, Source
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError, MissingToolError, nearest
from tacbench_cad.util.packages import require, why_missing
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from housing.coupon import Coupon
    from housing.holder import Holder
    from housing.jig import Jig
    from tacbench_cad.making.assembly import Assembly

#: What ``--parts`` may name.
PARTS = ("blocks", "holder", "jig", "coupon")
#: What is made when ``--parts`` is not given: the print set itself. The coupon is made once, before it, on demand.
DEFAULT_PARTS = ("blocks", "holder", "jig")


@dataclass(frozen=True, kw_only=True)
class Request:
    """The options of ``make``. Lengths in mm; None stands for the default.

    Args:
        textures: Numbers or names of the six, paths of TOML files, ``all``, or textures of your own.
        preset: ``paper`` or ``released``.
        scale: Multiplies sides, height, mm per unit and press grid.
        size_mm: Sides x, y.
        height_mm: Height of the highest point.
        mm_per_unit: Mapping of u, v and height.
        sampling: How the meshes follow the formula; ``"grid"`` for the preset's own grid.
        formats: Names of :data:`tacbench_cad.formats.FORMATS`; None for all that the install can write.
        parts: Some of blocks, holder, jig, coupon; None for the first three as far as they can be made.
        copies: Number of copies of each block, each with its number in the label.
        label: Engrave the undersides.
        key_mm: Leg of the key.
        full: Add the slow checks.
        out: Output folder.
        fit: Clearance of the pockets: a name or mm per side.
        rim_mm: How far the holder's rim lies below the block's top.
        slots: Pockets of the holder.
        nozzle_mm: Nozzle width that the fixtures must be printable with.
        jig: ``"default"``, or ``"all"`` for a jig with 25 holes.
        step_tolerance_mm: How close the solids stay to the formula.
        assembly: Also write holder, blocks and jig put together.
    """

    textures: tuple[str | int | Texture, ...] = ("all",)
    preset: str = "paper"
    scale: float = 1.0
    size_mm: tuple[float, float] | None = None
    height_mm: float | None = None
    mm_per_unit: tuple[float, float, float] | None = None
    sampling: Tolerance | SampleGrid | Literal["grid"] | None = None
    formats: tuple[str, ...] | None = None
    parts: tuple[str, ...] | None = None
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
    """Work out what a request means. Nothing is written, and every refusal that needs no building happens here.

    Raises:
        InputError: An option is not allowed, or two parts would share a name.
        MissingToolError: Something asked for by name needs a package that is not installed.
    """
    left_out: list[LeftOut] = []
    step = request.step_tolerance_mm
    if step is not None and not (math.isfinite(step) and 0.0 < step <= 1.0):
        raise InputError("step tolerance", step, "must be above 0 and at most 1 mm")
    formats = _formats(request, left_out)
    parts = _parts(request, left_out)
    blocks = blocks_of(request)
    sources: list[Source] = []
    if "blocks" in parts:
        sources += _block_sources(request, blocks, formats, left_out)
    for maker in _fixtures(request, parts, blocks, left_out):
        sources.append(Source(maker, None, formats))
    _require_distinct(sources)
    assemblies = _assemblies(request, formats, sources, left_out) if request.assembly else ()
    return Plan(sources=tuple(sources), left_out=tuple(left_out), assemblies=assemblies)


def _assemblies(
    request: Request, formats: Sequence[str], sources: Sequence[Source], left_out: list[LeftOut]
) -> tuple[Assembly, ...]:
    """A holder each, with blocks of its geometry in its slots and its jig on it.

    The blocks go in from the first slot on, in the order of the textures, the first copy of each before any second.
    The rest is left out, and said to be.
    """
    from tacbench_cad.making.assembly import ASSEMBLY_FORMATS, Assembly

    require("assembly:", *FIXTURE_MODULES)
    wanted = tuple(name for name in formats if name in ASSEMBLY_FORMATS)
    if not wanted:
        raise InputError("formats", ",".join(formats), f"--assembly needs one of {', '.join(ASSEMBLY_FORMATS)}")
    from housing.holder import Holder
    from housing.jig import Jig

    makers = [one.maker for one in sources]
    made: list[Assembly] = []
    for holder in (one for one in makers if isinstance(one, Holder)):
        fitting = [one for one in makers if isinstance(one, Block) and one.outline == holder.block.outline]
        fitting.sort(key=lambda block: block.copy or 1)
        blocks, over = fitting[: holder.slots], fitting[holder.slots :]
        one = Assembly(
            holder=holder,
            blocks=tuple(blocks),
            jig=next((one for one in makers if isinstance(one, Jig) and one.holder == holder), None),
            step_tolerance_mm=request.step_tolerance_mm,
            formats=wanted,
        )
        if over:
            inside = ", ".join(block.texture.name for block in blocks)
            left_out.append(
                LeftOut(
                    what=f"{len(over)} of {len(fitting)} blocks in {one.name}",
                    reason=f"the holder has {counted(holder.slots, 'slot')}, for {inside}; --slots asks for more",
                )
            )
        without = [block.texture.name for block in one.blocks if block.grid_aliases]
        if without and "step" in wanted:
            left_out.append(LeftOut(what=f"{one.name}.step", reason=f"there is no solid of {', '.join(without)}"))
            one = replace(one, formats=tuple(name for name in wanted if name != "step"))
        if one.blocks and one.formats:
            made.append(one)
    if not made:
        raise InputError("assembly", None, "needs a holder and a block that goes into it among the parts made")
    return tuple(made)


def _chosen(option: str, given: Sequence[str], allowed: Iterable[str]) -> tuple[str, ...]:
    """The given words in the order of the allowed ones."""
    words = list(allowed)
    for word in given:
        if word not in words:
            raise InputError(option, word, nearest(word, words))
    if not given:
        raise InputError(option, "", "allowed: " + ", ".join(words))
    return tuple(word for word in words if word in given)


def _formats(request: Request, left_out: list[LeftOut]) -> tuple[str, ...]:
    if request.formats is not None:
        formats = _chosen("formats", request.formats, FORMATS)
        for name in formats:
            reason = FORMATS[name].why_missing()
            if reason:
                raise MissingToolError(f"formats = {name!r}: {reason}")
        return formats
    for name, one in FORMATS.items():
        reason = one.why_missing()
        if reason:
            left_out.append(LeftOut(what=name, reason=reason))
    return tuple(name for name, one in FORMATS.items() if not one.why_missing())


def _parts(request: Request, left_out: list[LeftOut]) -> tuple[str, ...]:
    reason = why_missing(*FIXTURE_MODULES)
    if request.parts is None:
        if reason is None:
            return DEFAULT_PARTS
        if request.jig is not None:
            raise MissingToolError(f"jig = {request.jig!r}: {reason}")
        left_out.append(LeftOut(what="holder, jig", reason=reason))
        return ("blocks",)
    parts = _chosen("parts", request.parts, PARTS)
    fixtures = [part for part in parts if part != "blocks"]
    if fixtures and reason:
        raise MissingToolError(f"parts = {', '.join(fixtures)!r}: {reason}")
    for option, value, users in (
        ("jig", request.jig, ("jig",)),
        ("fit", request.fit, ("holder", "jig")),
        ("rim", request.rim_mm, ("holder", "jig")),
        ("slots", request.slots, ("holder", "jig")),
        ("nozzle", request.nozzle_mm, ("holder", "jig", "coupon")),
    ):
        if value is not None and not set(users) & set(fixtures):
            raise InputError(option, value, f"belongs to {', '.join(users)}, not among the parts asked for")
    return parts


def blocks_of(request: Request) -> list[Block]:
    """The blocks without their copies; every refusal of a block happens here."""
    if request.copies is not None and not 1 <= request.copies <= 999:
        raise InputError("copies", request.copies, "must be from 1 to 999")
    found = textures_of(request.textures, request.preset)
    blocks: dict[str, Block] = {}
    # The highest reliefs first: a height that is refused is then refused with one that would do for all.
    for texture, table in sorted(found, key=lambda one: -one[0].waves.amplitude_sum):
        blocks[texture.name] = Block.of(
            texture,
            request.preset,
            mm_per_unit=request.mm_per_unit,
            size_mm=request.size_mm,
            height_mm=request.height_mm,
            scale=request.scale,
            sampling=request.sampling,
            key_mm=request.key_mm,
            label=request.label or request.copies is not None,
            table=table,
        )
    return [blocks[texture.name] for texture, _ in found]


def _copies(request: Request, block: Block) -> list[Block]:
    if request.copies is None:
        return [block]
    return [replace(block, copy=number) for number in range(1, request.copies + 1)]


def _block_sources(
    request: Request, blocks: Sequence[Block], formats: tuple[str, ...], left_out: list[LeftOut]
) -> list[Source]:
    sources = []
    for block in blocks:
        for one in _copies(request, block):
            _ = one.engraving  # refuses a label that does not fit
            source = Source(one, request.step_tolerance_mm, formats)
            reason = source.part.no_solid
            if "step" in formats and source.part.make_solid is None and reason:
                if formats == ("step",) and "all" not in request.textures:
                    raise InputError("formats", "step", f"{block.texture.name}: {reason}")
                left_out.append(LeftOut(what=f"{source.name}.step", reason=reason))
                source = Source(one, request.step_tolerance_mm, tuple(f for f in formats if f != "step"))
            if source.formats:
                sources.append(source)
    return sources


def _fixtures(
    request: Request, parts: Sequence[str], blocks: Sequence[Block], left_out: list[LeftOut]
) -> list[Holder | Jig | Coupon]:
    """The fixtures asked for: a holder and a jig for every geometry among the blocks, and one coupon.

    By default (without --parts and options of their own) a holder or jig that these blocks cannot have is left out
    with the numbers. Asked for, it is refused.
    """
    fixtures: list[Holder | Jig | Coupon] = []
    for block in _geometries(blocks):
        if block.key_mm is not None:
            _require_key(block, request)
        if not {"holder", "jig"} & set(parts):
            continue
        try:
            holder = _holder(request, block)
        except InputError as error:
            own = (request.fit, request.rim_mm, request.slots, request.nozzle_mm, request.key_mm, request.jig)
            if request.parts is not None or any(one is not None for one in own):
                raise
            left_out.append(LeftOut(what="holder, jig", reason=str(error)))
            continue
        if "holder" in parts:
            fixtures.append(holder)
        if "jig" in parts:
            try:
                fixtures.append(_jig(request, holder))
            except InputError as error:
                if request.jig is not None or request.parts is not None:
                    raise
                left_out.append(LeftOut(what="jig", reason=str(error)))
    if "coupon" in parts:
        fixtures.append(_coupon(request))
    return sorted(fixtures, key=lambda one: ("holder", "jig", "coupon").index(one.kind))


def _require_key(block: Block, request: Request) -> None:
    """Refuse a key so small that a block turned by half still goes into a pocket with the chosen fit."""
    from housing.fits import clearance_mm
    from housing.holder import least_key_mm

    fit = "slip" if request.fit is None else request.fit
    least = least_key_mm(block, fit)
    if block.key_mm is not None and block.key_mm <= least:
        raise InputError(
            "key",
            block.key_mm,
            f"a block turned by half would go in at a clearance of {clearance_mm(fit):g} mm per side; it must be above "
            f"{least:.4g} mm and at most {min(block.size_mm) / 3.0:.4g} mm",
        )


def _holder(request: Request, block: Block) -> Holder:
    """The holder for a block: in ``released`` the one that the authors printed, where nothing asks for another."""
    from housing.holder import Holder

    options = _given(fit=request.fit, rim_mm=request.rim_mm, slots=request.slots)
    nozzle = _given(nozzle_mm=request.nozzle_mm)
    if request.preset == "released" and not options:
        with contextlib.suppress(InputError):
            return Holder(block=block, preset="released", **nozzle)
    return Holder(block=block, **options, **nozzle)


def _jig(request: Request, holder: Holder) -> Jig:
    from housing.jig import Jig

    return Jig(holder=holder, **_given(marks=request.jig, nozzle_mm=request.nozzle_mm))


def _coupon(request: Request) -> Coupon:
    from housing.coupon import Coupon

    return Coupon(**_given(nozzle_mm=request.nozzle_mm))


def _given(**options: Any) -> dict[str, Any]:
    """The options that were given; the rest keep their own defaults."""
    return {name: value for name, value in options.items() if value is not None}


def _geometries(blocks: Sequence[Block]) -> list[Block]:
    """The first block of each distinct outline: to a fixture, textures of one size are the same."""
    distinct: dict[object, Block] = {}
    for block in blocks:
        distinct.setdefault(block.outline, block)
    return list(distinct.values())


def _require_distinct(sources: Sequence[Source]) -> None:
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise InputError("parts", name, "two parts of this call would share this name; make them in two calls")
