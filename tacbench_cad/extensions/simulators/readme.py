"""The README of a texture's folder: the texture, its frame, units and scale, and a section for each target."""

from __future__ import annotations

from collections.abc import Iterable

from tacbench_cad import __version__
from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.spec import SampleGrid


def readme(asset: SimulatorAsset, sections: Iterable[tuple[str, str]]) -> str:
    """Return the text of README.md.

    Args:
        asset: The block.
        sections: The title and the note of each target.
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
        f"- Formula: z = {block.texture.equation}, for u from {u0:g} to {u1:g} and v from {v0:g} to {v1:g}.",
        f"- Scale: one unit of u, v and z is {ux:.6g}, {uy:.6g} and {uz:.6g} mm.",
        f"- Block: {x:g} x {y:g} x {block.height_mm:g} mm. The relief is {block.relief_mm:.4g} mm high, and the base "
        f"below it {block.base_mm:.4g} mm.",
        "- Block frame: the origin is at the lower corner of the underside, x and y run along the sides, and z points "
        f"up. The underside is at z = 0, the highest point at {block.height_mm:g} mm.",
        "- Every file uses the block frame. The units and the up axis depend on the format and are named below.",
        f"- Height in mm at (x, y) in mm: {block.datum_mm:.9g} + {uz:.6g} * formula({u0:g} + x / {ux:.9g}, "
        f"{v0:g} + y / {uy:.9g}).",
    ]
    if isinstance(block.sampling, SampleGrid):
        lines.append(
            f"- This preset joins {block.sampling.nx} x {block.sampling.ny} samples by straight lines, as the "
            f"published files do.{' These are too few samples for the finest waves.' if block.grid_aliases else ''} "
            "The errors below are the differences between that surface and the formula."
        )
    for title, note in sections:
        lines += ["", f"## {title}", "", note.rstrip("\n")]
    lines += ["", "`texture.json` has the same information for programs, and the SHA-256 checksum of each file."]
    return "\n".join(lines) + "\n"
