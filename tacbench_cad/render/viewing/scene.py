"""The content of the 3D page: parts with their meshes, their places in the assembly, and facts about each part.

The coordinates of the page are those of the holder. The mesh of a block stays in the block's own frame and has a matrix
that places it, so that the formula can be drawn on it without another conversion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry import relief
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N, PressGrid, contact_radius_mm
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import at_most, report_rows
from tacbench_cad.util.types import Floats

Facts = tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class ScenePress:
    """The press protocol on a block.

    Args:
        positions_mm: The 25 positions on the formula's surface, row by row, in the block frame; shape (25, 3).
        contacts: Force in N and radius in mm of the contact on a flat plate, one pair for each force.
    """

    positions_mm: Floats
    contacts: tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True)
class SceneFormula:
    """A block's surface ``z = datum + sum A sin(f x + g y + phase)``, and a bound of the mesh's distance from it.

    Args:
        equation: The texture's formula in a readable form.
        datum_mm: z of the formula's zero in the mesh.
        waves: Rows ``amplitude mm, f rad/mm, g rad/mm, phase rad``; shape (n, 4). None if the surface is a spline.
        range_mm: Lowest and highest z.
        bound_mm: Proved bound of the distance between the mesh's top and the formula.
        scale_mm: Distance at the end of the colour scale. For a mesh within a tolerance this is the bound. The bound of
            joined samples is far too large, so for them it is the largest distance at the triangles' centres and sides.
    """

    equation: str
    datum_mm: float
    waves: Floats | None
    range_mm: tuple[float, float]
    bound_mm: float
    scale_mm: float


@dataclass(frozen=True, kw_only=True)
class Thing:
    """One part on the page.

    Args:
        name: Stem of its file names.
        kind: Kind of part, such as ``block`` or ``holder``.
        title: The part in one line.
        mesh: A block in its own frame; a fixture in the holder's frame, as it is used.
        to_world: Homogeneous matrix from the mesh's frame to the world, shape (4, 4).
        set_number: Number of its assembly; None for a part of no assembly.
        slot: A block's pocket in its holder, from 0.
        facts: Facts about it: pairs of a name and a value.
        formula: A block's formula.
        press: A block's press positions; None where they leave the block.
    """

    name: str
    kind: str
    title: str
    mesh: Mesh
    to_world: Floats
    set_number: int | None
    slot: int = 0
    facts: Facts
    formula: SceneFormula | None = None
    press: ScenePress | None = None


@dataclass(frozen=True, kw_only=True)
class Scene:
    """The content of a page, and the parts that were left out.

    Args:
        things: The parts.
        left_out: Parts that could not be built, each with the reason.
    """

    things: tuple[Thing, ...]
    left_out: Facts = ()


def block_thing(part: PrintPart, to_world: Floats, set_number: int | None, slot: int) -> Thing:
    """A block on the page, in its own frame, with its formula and its press positions.

    Args:
        part: The block's part.
        to_world: Homogeneous matrix from the block frame to the world, shape (4, 4).
        set_number: Number of its assembly; None if it belongs to none.
        slot: Its pocket in its holder, from 0.
    """
    block, (mesh, expected) = part.block, part.mesh
    assert block is not None and expected.certificate is not None
    low, high = block.extremes.low + block.datum_mm, block.extremes.high + block.datum_mm
    bound, sampling = expected.certificate.distance_mm, block.sampling
    formula = SceneFormula(
        equation=block.texture.equation,
        datum_mm=block.datum_mm,
        waves=block.surface.table if isinstance(block.surface, WaveSum) else None,
        range_mm=(low, high),
        bound_mm=bound,
        scale_mm=bound if isinstance(sampling, Tolerance) else min(bound, _farthest_mm(block, mesh)),
    )
    rows, evidence = report_rows(str(block)), expected.certificate.evidence
    facts: Facts = (
        *((name, rows[name]) for name in ("z", "size", "relief", "base", "mm per unit", "mesh")),
        ("triangles", f"{len(mesh.faces):,}"),
        (evidence, f"at most {at_most(1000.0 * bound, 4)} µm from the formula everywhere"),
    )
    if formula.scale_mm < bound:
        facts += (("measured", f"at most {1000.0 * formula.scale_mm:.4g} µm at the triangles' centres and sides"),)
    return Thing(
        name=part.name,
        kind="block",
        title=part.title,
        mesh=mesh,
        to_world=to_world,
        set_number=set_number,
        slot=slot,
        facts=facts,
        formula=formula,
        press=_press(block),
    )


def _farthest_mm(block: Block, mesh: Mesh) -> float:
    """Largest distance from the formula in mm, at the centres and at the sides' middles of the top's triangles."""
    points = relief.points_on(mesh, relief.upward(mesh, mesh.doubled_normals), points=0)
    return relief.distance(points, block.surface, block.datum_mm).largest_mm


def _press(block: Block) -> ScenePress | None:
    """The paper's press positions on a block; None if the press grid leaves the block."""
    grid = PressGrid.paper(block.scale)
    try:
        grid.require_on(block)
    except InputError:
        return None
    x, y = grid.positions_mm.T
    contacts = tuple((force, contact_radius_mm(force)) for force in FORCES_N)
    return ScenePress(positions_mm=np.column_stack([x, y, block.height_at(x, y)]), contacts=contacts)
