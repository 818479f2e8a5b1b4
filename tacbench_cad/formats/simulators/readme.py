"""The note of a texture's folder: what it is, its frame, units and scale, then a section for each target."""

from __future__ import annotations

from collections.abc import Iterable

from tacbench_cad import __version__
from tacbench_cad.formats.simulators.asset import SimulatorAsset
from tacbench_cad.spec.sampling import SampleGrid


def readme(asset: SimulatorAsset, sections: Iterable[tuple[str, str]]) -> str:
    """The text of README.md.

    Args:
        asset: The block.
        sections: Title and note of each target.
    """
    block = asset.block
    x, y = block.size_mm
    ux, uy, uz = block.mm_per_unit
    (u0, u1), (v0, v1) = block.domain
    lines = [
        f"# {asset.name}",
        "",
        f"A tactile texture block, preset {block.preset}, scale {block.scale:g}, by tacbench-cad {__version__}.",
        "",
        f"- Formula: z = {block.texture.equation}, over u = {u0:g} .. {u1:g} and v = {v0:g} .. {v1:g}.",
        f"- Scale: one unit of u, v, z is {ux:.6g}, {uy:.6g}, {uz:.6g} mm.",
        f"- Block: {x:g} x {y:g} x {block.height_mm:g} mm; relief {block.relief_mm:.4g} mm above a base of "
        f"{block.base_mm:.4g} mm.",
        "- Block frame: origin at the lower corner of the underside, x and y along the sides, z up, underside at "
        f"z = 0, highest point at {block.height_mm:g} mm. Every file uses this frame, in the units and with the up "
        "axis of its format, named below.",
        f"- Height in mm at (x, y) in mm: {block.datum_mm:.9g} + {uz:.6g} * formula({u0:g} + x / {ux:.9g}, "
        f"{v0:g} + y / {uy:.9g}).",
    ]
    if isinstance(block.sampling, SampleGrid):
        lines.append(
            f"- This preset joins {block.sampling.nx} x {block.sampling.ny} samples by straight lines, as the "
            f"published files do{'; they are too few for the finest waves' if block.grid_aliases else ''}. The errors "
            "below are those of that surface against the formula."
        )
    for title, note in sections:
        lines += ["", f"## {title}", "", note.rstrip("\n")]
    lines += ["", "`texture.json` holds the same for programs: the block, and each target's files with their SHA-256."]
    return "\n".join(lines) + "\n"
