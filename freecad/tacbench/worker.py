"""Make shapes for FreeCAD. FreeCAD starts this script in the Python environment of tacbench-cad.

The script reads requests from the standard input and answers each on the standard output. A request and an answer are
one line of JSON each. The answer has the key ``error``, a message in one line, or the facts about the part. The shape
is written to the file ``brep`` of the request.
"""

import json
import sys
from pathlib import Path
from typing import Any

from housing import Holder, Jig
from tacbench_cad import Block, TacbenchError, catalogue, export, read_texture
from tacbench_cad.geometry.part import rgb_of


def block_of(options: dict[str, Any]) -> Block:
    """Return the block of a request.

    Args:
        options: The arguments of ``Block.of``. The key ``file`` names a TOML file that replaces the texture. A side of
            None stands for the side of the file or the preset.
    """
    texture, table = options.pop("texture"), None
    file, sides = options.pop("file"), options.pop("size_mm")
    if file is not None:
        source = read_texture(Path(file))
        texture, table = source.texture, source.block
    if any(side is not None for side in sides):
        default = Block.of(texture, options["preset"], table=table).nominal_size_mm
        options["size_mm"] = tuple(own if own is not None else other for own, other in zip(sides, default, strict=True))
    return Block.of(texture, **options, table=table)


def part_of(request: dict[str, Any]) -> Block | Holder | Jig:
    """Return the block, the holder or the jig of a request."""
    block = block_of(request["block"])
    if "holder" not in request:
        return block
    holder = Holder(block=block, **request["holder"])
    return Jig(holder=holder, **request["jig"]) if "jig" in request else holder


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Do what a request asks for, and return the facts about the part."""
    if request["action"] == "catalogue":
        kinds = ("block", "holder", "jig")
        return {"textures": [texture.name for texture in catalogue()], "rgb": {kind: rgb_of(kind) for kind in kinds}}
    part = part_of(request)
    if request["action"] == "export":
        report = export(part, request["file"])
        return {"report": str(report)}
    if not isinstance(part, Block):
        write_brep(part.solid_in_use(), request["brep"])
        slots = [place.matrix.ravel().tolist() for place in part.holder.block_placements()]
        return {"name": part.name, "size_mm": part.size_mm, "volume_mm3": part.volume_mm3, "slots": slots}
    from tacbench_cad.geometry.brep import solid_block

    solid, certificate = solid_block(part)
    write_brep(solid, request["brep"])
    return {
        "name": part.solid_name,
        "relief_mm": part.relief_mm,
        "volume_mm3": part.volume_mm3(part.solid_datum_mm),
        "error_mm": certificate.vertical_mm,
        "equation": part.texture.equation,
    }


def write_brep(shape: Any, path: str) -> None:
    """Write a shape in the oldest version of the format, which every FreeCAD can read."""
    from OCP.BRepTools import BRepTools
    from OCP.Message import Message_ProgressRange
    from OCP.TopTools import TopTools_FormatVersion

    version = TopTools_FormatVersion.TopTools_FormatVersion_VERSION_1
    if not BRepTools.Write_s(shape, path, False, False, version, Message_ProgressRange()):
        raise OSError(f"{path}: the shape could not be written")


def main() -> None:
    """Answer requests until the standard input is closed."""
    answers = sys.stdout
    sys.stdout = sys.stderr  # what libraries print must not mix with the answers
    for line in sys.stdin:
        try:
            result = answer(json.loads(line))
        except (TacbenchError, OSError) as error:
            result = {"error": str(error)}
        except Exception as error:  # a fault of the program must reach the user, too
            result = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(result), file=answers, flush=True)


if __name__ == "__main__":
    main()
