"""Make shapes for FreeCAD. FreeCAD starts this script in the Python environment of tacbench-cad.

The script reads requests from the standard input and answers each on the standard output. A request and an answer are
one line of JSON each. The answer has the key ``error``, a message in one line, or the facts about the part. The shape
is written to the file ``brep`` of the request.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from housing import Holder, Jig
from tacbench_cad import Block, InputError, TacbenchError, as_part, export, textured
from tacbench_cad.geometry.part import rgb_of
from tacbench_cad.spec.families import BUILT_IN_NAMES


def block_of(options: dict[str, Any]) -> Block:
    """Return the block of a request.

    Args:
        options: The arguments of ``Block.of``. The key ``file`` names a TOML file that replaces the texture. A side of
            None stands for the side of the file or the preset.
    """
    texture, sides = texture_of(options), options.pop("size_mm")
    if any(side is not None for side in sides):
        default = Block.of(texture, options["preset"]).nominal_size_mm
        options["size_mm"] = tuple(own if own is not None else other for own, other in zip(sides, default, strict=True))
    return Block.of(texture, **options)


def texture_of(options: dict[str, Any]) -> str | Path:
    """Take the texture or its file out of the options."""
    texture, file = options.pop("texture"), options.pop("file")
    return texture if file is None else Path(file)


def face_of(request: dict[str, Any]) -> tuple[Any, Any]:
    """Return the shape and the face of a request. FreeCAD counts faces from 1."""
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    shape, faces = read_brep(request["part"]), TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_FACE, faces)
    if not 1 <= request["face"] <= faces.Extent():
        raise InputError(
            "Face", f"Face{request['face']}", f"the part has Face1 to Face{faces.Extent()}; choose one of them"
        )
    return shape, TopoDS.Face_s(faces.FindKey(request["face"]))


def answer_for_face(request: dict[str, Any]) -> dict[str, Any]:
    """Put a texture on a face, and write the shape or export it."""
    options = request["texturing"]
    texture = texture_of(options)
    shape, face = face_of(request)
    if request["action"] == "export":
        part = textured(shape, face, texture, name=Path(request["file"]).stem, **options)
        return {"report": str(export(part, request["file"]))}
    result = textured(shape, face, texture, **options)
    write_brep(result.solid, request["brep"])
    return {
        "volume_mm3": result.volume_mm3,
        "error_mm": result.certificate.distance_mm,
        "evidence": result.certificate.evidence,
    }


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
        kinds = ("block", "holder", "jig", "textured")
        return {"textures": list(BUILT_IN_NAMES), "rgb": {kind: rgb_of(kind) for kind in kinds}}
    if "texturing" in request:
        return answer_for_face(request)
    part = part_of(request)
    if request["action"] == "export":
        return {"report": str(export(part, request["file"]))}
    if not isinstance(part, Block):
        write_brep(part.solid_in_use, request["brep"])
        slots = [place.matrix.ravel().tolist() for place in part.holder.block_placements()]
        return {"name": part.name, "size_mm": part.size_mm, "volume_mm3": part.volume_mm3, "slots": slots}
    solid, expected = as_part(part).solid
    write_brep(solid, request["brep"])
    return {
        "name": part.solid_name,
        "relief_mm": part.relief_mm,
        "volume_mm3": expected.volume_mm3,
        "error_mm": expected.certificate.vertical_mm,
        "evidence": expected.certificate.evidence,
        "equation": part.texture.equation,
    }


def read_brep(text: str) -> Any:
    """Read a shape that FreeCAD has written."""
    from OCP.BRep import BRep_Builder
    from OCP.BRepTools import BRepTools
    from OCP.Message import Message_ProgressRange
    from OCP.TopoDS import TopoDS_Shape

    shape = TopoDS_Shape()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.brep"
        path.write_text(text, encoding="utf-8")
        if not BRepTools.Read_s(shape, str(path), BRep_Builder(), Message_ProgressRange()):
            raise OSError("the shape of the part cannot be read")
    return shape


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
