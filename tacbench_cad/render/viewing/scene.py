"""What the 3D page shows: parts with their meshes, where they lie in the assembly, and what is said of each.

The world of the page is the holder's frame. A block keeps its own frame and is brought there by a placement, so that
its formula can be drawn on it without a second mapping.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks import relief
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import Kind
from tacbench_cad.making.plan import LeftOut
from tacbench_cad.making.request import PARTS, Request, plan
from tacbench_cad.making.sources import Source
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N, PressGrid, contact_radius_mm
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.textures import catalogue
from tacbench_cad.util.errors import InputError, MissingToolError, nearest
from tacbench_cad.util.processes import why_not_importable
from tacbench_cad.util.text import decimal
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from housing.holder import Holder
    from housing.jig import Jig

Facts = tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class Press:
    """The press protocol on a block.

    Args:
        positions_mm: The 25 positions on the formula's surface, row by row, in the block frame; shape (25, 3).
        contacts: Force in N and radius in mm of the contact on a flat plate, one pair a force.
    """

    positions_mm: Floats
    contacts: tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True)
class Formula:
    """A block's surface ``z = datum + sum A sin(f x + g y + phase)``, and what is proved of the mesh against it.

    Args:
        equation: The texture's formula, for people.
        datum_mm: z of the formula's zero in the mesh.
        waves: Rows ``amplitude mm, f rad/mm, g rad/mm, phase rad``; shape (n, 4).
        range_mm: Lowest and highest z.
        bound_mm: No point of the mesh's top lies farther from the formula.
        scale_mm: Where the colours end: the bound of a mesh within a tolerance; of joined samples, whose bound is far
            above what there is, the largest distance found at the triangles' centres and sides.
    """

    equation: str
    datum_mm: float
    waves: Floats
    range_mm: tuple[float, float]
    bound_mm: float
    scale_mm: float


@dataclass(frozen=True, kw_only=True)
class Thing:
    """One part on the page.

    Args:
        name: Stem of its file names.
        kind: What it is.
        title: One line for people.
        mesh: A block in its own frame; a fixture in the holder's frame, as it is used.
        to_world: Homogeneous matrix from the mesh's frame to the world, shape (4, 4).
        set_number: Which assembly it belongs to; None for a part of no assembly.
        slot: A block's pocket in its holder, from 0.
        facts: What is said of it: pairs of a name and a value.
        formula: A block's formula.
        press: A block's press positions; None where they leave the block.
    """

    name: str
    kind: Kind
    title: str
    mesh: Mesh
    to_world: Floats
    set_number: int | None
    slot: int = 0
    facts: Facts
    formula: Formula | None = None
    press: Press | None = None


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything on a page, and what had to be left out.

    Args:
        things: The parts.
        left_out: What could not be built here.
    """

    things: tuple[Thing, ...]
    left_out: tuple[LeftOut, ...] = ()


def request_of(words: Sequence[str], options: Request) -> Request:
    """What the words after ``tacbench view`` mean.

    Args:
        words: Numbers or names of textures, TOML files, ``blocks``, ``holder``, ``jig``, ``coupon``; none for the
            whole set.
        options: Everything else.

    Raises:
        InputError: A word means nothing.
    """
    textures, parts = [], []
    known = {word for one in catalogue(options.preset) for word in (str(one.number), one.name)} | {"all"}
    for word in words:
        if word in PARTS:
            parts.append(word)
        elif word.lower() in known or word.lower().endswith(".toml") or "/" in word or Path(word).exists():
            textures.append(word)
        else:
            names = [*PARTS, *(one.name for one in catalogue(options.preset))]
            raise InputError("parts", word, f"{nearest(word, names)}; 1 to 6 and TOML files are allowed too")
    if not words:
        return replace(options, textures=("all",), parts=None)
    if textures:
        parts.append("blocks")
    return replace(options, textures=tuple(textures) or ("all",), parts=tuple(parts))


def scene_of(request: Request, progress: Callable[[str], None] = lambda message: None) -> Scene:
    """Build the meshes of a request's parts and put them where they belong.

    Args:
        request: The options; formats are of no account.
        progress: Told what is being built.

    Raises:
        InputError: An option is not allowed.
        MissingToolError: A fixture was asked for by name and the CAD packages are not there or do not load.
    """
    wanted = plan(replace(request, formats=("stl",)))
    if any(source.part.mesh_needs_cad for source in wanted.sources):
        progress("loading the CAD kernel")
        reason = why_not_importable(wanted.needs_kernel)
        if reason is not None:
            message = f"the CAD kernel does not load ({reason}); tacbench doctor shows the repair"
            if request.parts is not None:
                raise MissingToolError(message)
            wanted = wanted.without_kernel(message)
    sets = _sets_of(wanted.sources)
    things = []
    for i, source in enumerate(wanted.sources):
        progress(source.name)
        things.append(
            _block_thing(source, i, sets) if isinstance(source.maker, Block) else _fixture_thing(source, sets)
        )
    if not things:
        raise InputError("parts", None, "nothing can be shown: " + "; ".join(one.reason for one in wanted.left_out))
    return Scene(things=tuple(things), left_out=wanted.left_out)


def _sets_of(sources: Sequence[Source]) -> list[Holder]:
    """The holders of the assemblies: those shown, and those on which a shown jig sits."""
    holders: list[Holder] = []
    for source in sources:
        holder = source.maker if source.part.kind == "holder" else getattr(source.maker, "holder", None)
        if holder is not None and holder not in holders:
            holders.append(holder)  # type: ignore[arg-type]
    return holders


def _block_thing(source: Source, number: int, sets: Sequence[Holder]) -> Thing:
    """A block in its own frame, placed in the holder that takes it."""
    block = source.maker
    assert isinstance(block, Block)
    mesh, body = source.part.mesh
    assert body.certificate is not None
    held = next((i for i, holder in enumerate(sets) if holder.block.outline == block.outline), None)
    to_world, slot = np.eye(4), 0
    if held is not None:
        places = sets[held].block_placements()
        slot = number % len(places)
        place = places[slot]
        to_world[:2, :2] = place.to_holder(np.eye(2)).T - np.array(place.origin_mm[:2])[:, None]
        to_world[:3, 3] = place.origin_mm
    low, high = block.extremes.low + block.datum_mm, block.extremes.high + block.datum_mm
    bound, sampling = body.certificate.distance_mm, block.sampling
    formula = Formula(
        equation=block.texture.equation,
        datum_mm=block.datum_mm,
        waves=block.surface.table,
        range_mm=(low, high),
        bound_mm=bound,
        scale_mm=bound if isinstance(sampling, Tolerance) else min(bound, _farthest_mm(block, mesh)),
    )
    facts: Facts = (
        ("texture", f"z = {block.texture.equation}"),
        ("size", _mm(*block.size_mm, block.height_mm)),
        ("relief", _mm(block.relief_mm)),
        ("base", _mm(block.base_mm)),
        ("mm per unit", " x ".join(f"{one:.6g}" for one in block.mm_per_unit)),
        (
            "mesh",
            f"within {decimal(sampling.mm)} mm of the formula"
            if isinstance(sampling, Tolerance)
            else f"{sampling.nx} x {sampling.ny} samples joined",
        ),
        ("triangles", f"{len(mesh.triangles):,}"),
        ("proved", f"nowhere farther than {1000.0 * bound:.4g} µm from the formula"),
    )
    if formula.scale_mm < bound:
        facts += (("found", f"{1000.0 * formula.scale_mm:.4g} µm at most, at the triangles' centres and sides"),)
    return Thing(
        name=source.name,
        kind="block",
        title=source.part.title,
        mesh=mesh,
        to_world=to_world,
        set_number=held,
        slot=slot,
        facts=facts,
        formula=formula,
        press=_press(block),
    )


def _farthest_mm(block: Block, mesh: Mesh) -> float:
    """Largest distance from the formula at the centres and the sides' middles of the top's triangles, in mm."""
    points = relief.points_on(mesh, relief.upward(mesh, mesh.doubled_normals), points=0)
    return relief.distance(points, block.surface, block.datum_mm).largest_mm


def _press(block: Block) -> Press | None:
    """The paper's positions on a block; None where the grid leaves it."""
    grid = PressGrid.paper(block.scale)
    try:
        grid.require_on(block)
    except InputError:
        return None
    x, y = grid.positions_mm.T
    contacts = tuple((force, contact_radius_mm(force)) for force in FORCES_N)
    return Press(positions_mm=np.column_stack([x, y, block.height_at(x, y)]), contacts=contacts)


def _fixture_thing(source: Source, sets: Sequence[Holder]) -> Thing:
    """A fixture in the holder's frame; its dimension report says its sizes."""
    maker, mesh = source.maker, source.part.mesh[0]
    number = None
    if source.part.kind == "holder":
        number = sets.index(maker)
    elif source.part.kind == "jig":
        jig: Jig = maker  # type: ignore[assignment]
        number, mesh = sets.index(jig.holder), mesh.moved(jig.from_print)
    rows = [line.strip().partition("  ") for line in str(maker).splitlines()[1:]]
    return Thing(
        name=source.name,
        kind=source.part.kind,
        title=source.part.title,
        mesh=mesh,
        to_world=np.eye(4),
        set_number=number,
        facts=tuple((name, value.strip()) for name, _, value in rows if name != "name"),
    )


def _mm(*values: float) -> str:
    return " x ".join(f"{round(value, 4):.6g}" for value in values) + " mm"
