"""``tacbench texture-part``: put a texture on a region of a user's part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tacbench_cad.cli import options, print_json, print_lines
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import at_most


@options.command("texture-part", "Print")
@options.argument("file", options.file("FILE"), "STL, 3MF or STEP file of any program, in mm.")
@options.option(
    "--at",
    options.coordinates("X,Y,Z"),
    "A point on the flat or cylindrical region that gets the texture, in mm.",
    options.PARTS,
)
@options.option(
    "--face",
    options.text("SELECTOR"),
    "Faces of a STEP file by a selector of CadQuery, such as >Z or %Cylinder.",
    options.PARTS,
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
    "--depth",
    options.MM,
    "Height of the texture from its lowest to its highest point. Default: as its file says in mm, or else 1.",
    options.SIZE,
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
    "Length of one unit of u and v of the formula, in mm. Default: as in its file, or else in the preset paper.",
    options.SIZE,
)
@options.option(
    "--scale", options.SCALE, "Millimetres for each unit of the file; 25.4 for inches.", options.SIZE, default="1"
)
@options.option(
    "--tolerance",
    options.MM,
    "Largest distance of the file from the formula. Default: 0.01, and 0.001 for a new STEP file.",
    options.ACCURACY,
)
@options.out(
    "FILE", "The new STL or 3MF file, or STEP file of a STEP file. Default: FILE_textured, in the same folder."
)
@options.json
def command(file: Path, out: Path | None, json: bool, **settings: Any) -> None:
    """Put a texture on a region of your own part.

    The part is a closed mesh or a STEP file with one solid, of any program. The region is named by one of its points.
    In a mesh, it consists of all connected triangles on the same plane or cylinder, within 0.005 mm. In a STEP file, it
    is a face, and can also be named by a selector. The rest of the part stays as it is. All lengths are in mm.

    The texture is raised above the region, or sunk into it with --sunk. Around a whole cylinder, it gets a whole number
    of periods. The result is checked: it must be closed, have as many bodies as before, and have the volume of the part
    plus the integral of the formula.

    Examples:
      tacbench texture-part pad.stl --at 20,15,5 --texture 2 --depth 0.5
      tacbench texture-part drum.stl --at 15,0,10 --texture 3 --up +X
      tacbench texture-part grip.3mf --at 0,0,12 --texture 4 --sunk --fade 2
      tacbench texture-part plate.step --face ">Z" --texture 2
    """
    from tacbench_cad.formats import format_of
    from tacbench_cad.making import export, part_name, textured

    lengths = {f"{name}_mm": settings.pop(name) for name in ("depth", "margin", "fade", "base")}
    at, face, texture, tolerance = (settings.pop(name) for name in ("at", "face", "texture", "tolerance"))
    target = file.with_stem(f"{file.stem}_textured") if out is None else out
    is_solid, shape = format_of(file).shape == "solid", format_of(target).shape
    if (at is None) == (face is None):
        raise InputError("--at, --face", None, "must be given one at a time: a point, or a selector for a STEP file")
    if face is not None and not is_solid:
        raise InputError("--face", face, "needs a STEP file; name the region of a mesh by --at X,Y,Z")
    if tolerance is not None:
        lengths["tolerance_mm" if shape == "solid" else "mesh_tolerance_mm"] = tolerance
    result = textured(file, at or face, texture, name=part_name(target), **lengths, **settings)
    report = export(result, target)
    if json:
        facts = {"triangles": report.triangles, "volume_mm3": report.volume_mm3, "deviation_mm": report.deviation_mm}
        print_json({"ok": True, "file": str(target), **result.as_dict(), **facts})
        return
    certificate, bodies = result.certificate, "1 body" if result.bodies == 1 else f"{result.bodies} bodies"
    print_lines(
        *result.lines(),
        f"{'solid' if is_solid else 'mesh'} at most {at_most(certificate.distance_mm, 2)} mm from the formula "
        f"({certificate.evidence}); file at most {at_most(report.deviation_mm or 0.0, 2)} mm at the checked points",
        f"closed, {bodies}; volume {report.volume_mm3:.7g} mm^3, expected {result.volume_mm3:.7g} mm^3",
        f"written: {target}",
    )
