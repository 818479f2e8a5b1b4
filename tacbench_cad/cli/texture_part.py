"""``tacbench texture-part``: put a texture on a region of a user's part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json, print_lines


@options.command("texture-part")
@options.argument("file", options.file("FILE"), "STL or 3MF file of any program, in mm.")
@options.option(
    "--at",
    options.coordinates("X,Y,Z"),
    "A point on the flat or cylindrical region that gets the texture, in mm.",
    options.PARTS,
    required=True,
)
@options.option(
    "--texture", options.TEXTURE, "Texture: 1 to 6, another name or a TOML file.", options.PARTS, required=True
)
@options.option(
    "--up",
    options.text("DIR", "+X", "-X", "+Y", "-Y", "+Z", "-Z"),
    "Direction of the texture's x on a plane, or of its beginning on a cylinder: +X to -Z. Default: +X.",
    options.PARTS,
)
@options.flag("--sunk", "Put the texture below the face, not above it.", options.PARTS)
@options.option(
    "--depth", options.MM, "Height of the texture from its lowest to its highest point.", options.SIZE, default="1"
)
@options.option(
    "--margin", options.MM, "Distance of the texture from the edges of the region.", options.SIZE, default="1"
)
@options.option("--fade", options.MM, "Length over which the texture fades out.", options.SIZE, default="0")
@options.option(
    "--base",
    options.MM,
    "Distance of the texture from the face, which makes walls around it.",
    options.SIZE,
    default="0.2",
)
@options.option(
    "--mm-per-unit",
    options.coordinates("X,Y"),
    "Length of one unit of u and v of the formula, in mm. Default: as in the preset paper.",
    options.SIZE,
)
@options.option(
    "--scale", options.SCALE, "Millimetres for each unit of the file; 25.4 for inches.", options.SIZE, default="1"
)
@options.option(
    "--tolerance", options.MM, "Largest distance of the mesh from the formula.", options.ACCURACY, default="0.01"
)
@options.out("FILE", "The new STL or 3MF file. Default: FILE_textured, in the same folder.")
@options.json
def command(file: Path, out: Path | None, json: bool, **settings: Any) -> None:
    """Put a texture on a region of your own part.

    The part is a closed mesh of any program. The region is named by one of its points. It consists of all connected
    triangles on the same plane or cylinder, within 0.005 mm. The rest of the part stays as it is. All lengths are in
    mm.

    The texture is raised above the region, or sunk into it with --sunk. Around a whole cylinder, it gets a whole number
    of periods. The result is checked: it must be closed, have as many bodies as before, and have the volume of the part
    plus the integral of the formula.

    Examples:
      tacbench texture-part pad.stl --at 20,15,5 --texture 2 --depth 0.5
      tacbench texture-part drum.stl --at 15,0,10 --texture 3 --up +X
      tacbench texture-part grip.3mf --at 0,0,12 --texture 4 --sunk --fade 2
    """
    from tacbench_cad.making.texturing import textured_mesh, write_textured_mesh

    lengths = {f"{name}_mm": settings.pop(name) for name in ("depth", "margin", "fade", "base", "tolerance")}
    at, texture, scale = settings.pop("at"), settings.pop("texture"), settings.pop("scale")
    result = textured_mesh(file, at, texture, scale=scale, **lengths, **settings)
    target = file.with_stem(f"{file.stem}_textured") if out is None else out
    write_textured_mesh(result, target)
    if json:
        print_json({"ok": True, "file": str(target), **result.as_dict()})
        return
    print_lines(*result.lines(), f"written: {target}")
