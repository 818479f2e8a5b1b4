"""A block as a part: its mesh, its solid, and the expected geometry of its files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tacbench_cad.geometry.block_mesh import full_mesh
from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.storage import surface_summary
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape


def block_part(block: Block) -> PrintPart:
    """Wrap a block as a part. The mesh and the solid are only built when they are needed."""
    from tacbench_cad.geometry.brep import solid_refusal

    def make_mesh() -> tuple[Mesh, ExpectedGeometry]:
        made = full_mesh(block)
        return made.mesh, ExpectedGeometry(
            volume_mm3=made.volume_mm3,
            volume_slack_mm3=made.volume_slack_mm3,
            size_slack_mm=made.certificate.outline_mm,
            certificate=made.certificate,
            datum_mm=block.datum_mm,
        )

    def make_solid() -> tuple[TopoDS_Shape, ExpectedGeometry]:
        from tacbench_cad.geometry.brep import solid_block

        shape, certificate = solid_block(block)
        expected = ExpectedGeometry(
            volume_mm3=block.volume_mm3(block.solid_datum_mm),
            volume_slack_mm3=block.footprint_mm2 * certificate.vertical_mm,
            certificate=certificate.plus(block.surface.error, block.surface.evidence),
            datum_mm=block.solid_datum_mm,
        )
        return shape, expected

    refusal = solid_refusal(block)
    x, y = block.size_mm
    return PrintPart(
        name=block.name,
        solid_name="" if block.solid_name == block.name else block.solid_name,
        kind="block",
        title=block.title,
        size_mm=(x, y, block.height_mm),
        genus=0 if block.outline is None else len(block.outline.loops) - 1,
        make_mesh=make_mesh,
        make_solid=make_solid if refusal is None else None,
        spec=block_spec(block),
        block=block,
        no_solid=refusal,
    )


def as_part(thing: Any) -> PrintPart:
    """Convert an object to a part. The mesh and the solid are only built when they are needed.

    Args:
        thing: A block, a :class:`~tacbench_cad.geometry.part.PrintPart`, or an object with a method ``part()`` that
            returns a part, for example a holder.

    Raises:
        InputError: The object is none of these.
    """
    if isinstance(thing, PrintPart):
        return thing
    if isinstance(thing, Block):
        return block_part(thing)
    if callable(make := getattr(thing, "part", None)) and isinstance(part := make(), PrintPart):
        return part
    raise InputError(
        "part", thing, "must be a Block, a Holder, a Jig, a Coupon, a Part, or have a method part() that returns one"
    )


def block_spec(block: Block) -> dict[str, Any]:
    """Return all input values of a block and the values derived from them, as plain JSON values with lengths in mm."""
    sampling = block.sampling
    extremes = block.extremes
    grid = PressGrid.paper(block.scale)
    return {
        "texture": block.texture.name,
        "equation": block.texture.equation,
        **surface_summary(block.texture.surface),
        "preset": block.preset,
        "scale": block.scale,
        "size_mm": list(block.size_mm),
        "height_mm": block.height_mm,
        "mm_per_unit": list(block.mm_per_unit),
        "domain": [list(ends) for ends in block.domain],
        "sampling": {"tolerance_mm": sampling.mm}
        if isinstance(sampling, Tolerance)
        else {"grid": [sampling.nx, sampling.ny], "aliases": block.grid_aliases},
        "key_mm": block.key_mm,
        **({} if block.outline is None else {"outline": block.outline.word}),
        "label": list(block.label_words) if block.label else None,
        "copy": block.copy,
        "relief_mm": block.relief_mm,
        "base_mm": block.base_mm,
        "datum_mm": block.datum_mm,
        "solid_datum_mm": block.solid_datum_mm,
        "formula_above_height_mm": block.datum_mm - block.formula_datum_mm,
        "extremes": {
            "low_mm": extremes.low,
            "high_mm": extremes.high,
            "at_low_mm": list(extremes.at_low),
            "at_high_mm": list(extremes.at_high),
            "error_mm": extremes.error,
        },
        "press_grid_mm": {"x": list(grid.x_mm), "y": list(grid.y_mm)},
    }
