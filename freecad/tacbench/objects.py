"""The parametric objects. Their properties are those of ``Block``, ``Holder`` and ``Jig``.

A document stores the name of this module and of the classes, so they must keep their names.
"""

from __future__ import annotations

from typing import Any

import FreeCAD

from freecad.tacbench import shapes
from freecad.tacbench.stateless import Stateless

LENGTH, NUMBER, TEXT = "App::PropertyLength", "App::PropertyFloat", "App::PropertyString"
UPS = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
CHOICE, WHOLE, SWITCH = "App::PropertyEnumeration", "App::PropertyIntegerConstraint", "App::PropertyBool"


class Parametric(Stateless):
    """What the three kinds of objects share. A subclass lists its properties and makes its request.

    Attributes:
        group: The heading of the properties in the tree.
        kind: The kind of the part, which gives its colour.
        properties: The type, the name, the first value and the description of each property.
        results: The same for the properties that FreeCAD only shows.
    """

    group = ""
    kind = ""
    properties: tuple[tuple[str, str, Any, str], ...] = ()
    results: tuple[tuple[str, str, Any, str], ...] = (
        (TEXT, "PartName", "", "Name of the part in file names"),
        ("App::PropertyVolume", "FormulaVolume", 0.0, "Volume by the formula"),
    )

    def __init__(self, obj: Any) -> None:
        obj.Proxy = self
        for kind, name, value, description in self.properties:
            obj.addProperty(kind, name, self.group, description)
            first = value() if callable(value) else value
            setattr(obj, name, first)
            if kind == CHOICE:  # the list is the choices; the value is one of them
                setattr(obj, name, first[0])
        for kind, name, _, description in self.results:
            obj.addProperty(kind, name, "Result", description)
            obj.setEditorMode(name, 1)  # shown, but not edited

    def request(self, obj: Any) -> dict[str, Any]:
        """Return what the worker needs to make the part."""
        raise NotImplementedError

    def execute(self, obj: Any) -> None:
        """Make the shape. FreeCAD calls this method when a property has changed."""
        shape, facts = shapes.shape_of(self.request(obj))
        obj.Shape = shape
        if "name" in facts:
            obj.PartName = facts["name"]
        obj.FormulaVolume = facts["volume_mm3"]
        self.finish(obj, facts)

    def finish(self, obj: Any, facts: dict[str, Any]) -> None:
        """Set what else follows from the facts."""


def number(length: Any) -> float:
    """Return a length in mm. FreeCAD computes in binary, so 1.18 mm may arrive as 1.1800000000000002."""
    return round(float(length.Value), 9)


def error_of(facts: dict[str, Any]) -> str:
    """Return the certificate of a surface in words."""
    return f"{1000.0 * facts['error_mm']:.3g} micrometres ({facts['evidence']})"


def set_number(length: Any) -> float | None:
    """Return a length in mm, or None for 0, which stands for the default."""
    return number(length) or None


class TextureBlock(Parametric):
    """A texture block, with the lower corner of its underside at the origin of its placement."""

    group = "Block"
    kind = "block"
    properties = (
        (
            CHOICE,
            "Texture",
            lambda: shapes.ask({"action": "catalogue"})["textures"],
            "Texture of the paper, or a later texture of its authors",
        ),
        ("App::PropertyFile", "TextureFile", "", "TOML file of a texture, which replaces the texture above"),
        (CHOICE, "Preset", ["paper", "released"], "Where sides, height and mm per unit come from"),
        (NUMBER, "Scale", 1.0, "Factor for sides, height and mm per unit"),
        (TEXT, "Outline", "", "disc, ring, hexagon, or with its size in mm: disc:30; empty for a rectangle"),
        (LENGTH, "SizeX", 0.0, "Side along x before scaling; 0 for the side of the preset or the file"),
        (LENGTH, "SizeY", 0.0, "Side along y before scaling; 0 for the side of the preset or the file"),
        (LENGTH, "Height", 0.0, "Height of the highest point before scaling; 0 for that of the preset or the file"),
        (LENGTH, "Key", 0.0, "Leg of the chamfered corner; 0 for a block without a key"),
        (SWITCH, "EngraveLabel", False, "Engrave texture, preset and scale in the underside"),
        (WHOLE, "Copy", (0, 0, 999, 1), "Number of the copy in the label; 0 for a label without a number"),
        (NUMBER, "ToleranceMicrometres", 1.0, "Largest distance of the surface from the formula, in micrometres"),
    )
    results = (
        *Parametric.results,
        (TEXT, "Equation", "", "Formula of the texture"),
        (TEXT, "Error", "", "Bound of the distance between surface and formula, proved or measured"),
        (LENGTH, "Relief", 0.0, "Height from the lowest valley to the highest point"),
    )

    def request(self, obj: Any) -> dict[str, Any]:
        """Return the arguments of ``Block.of``."""
        return {
            "block": {
                "texture": obj.Texture,
                "file": obj.TextureFile or None,
                "preset": obj.Preset,
                "scale": obj.Scale,
                "outline": obj.Outline or None,
                "size_mm": [set_number(obj.SizeX), set_number(obj.SizeY)],
                "height_mm": set_number(obj.Height),
                "key_mm": set_number(obj.Key),
                "label": obj.EngraveLabel,
                "copy": obj.Copy or None,
                "step_tolerance_mm": obj.ToleranceMicrometres / 1000.0,
            }
        }

    def finish(self, obj: Any, facts: dict[str, Any]) -> None:
        """Show the certificate of the surface."""
        obj.Equation = facts["equation"]
        obj.Error = error_of(facts)
        obj.Relief = facts["relief_mm"]


class Holder(Parametric):
    """A holder for the block that it is linked to, or for several blocks of the same size."""

    group = "Holder"
    kind = "holder"
    properties = (
        ("App::PropertyLink", "Block", None, "Texture block that the holder is made for"),
        (CHOICE, "Preset", ["fitted", "released"], "A holder that fits the block, or the holder of the authors"),
        (CHOICE, "Fit", ["slip", "press", "loose"], "How tightly a block sits in its pocket"),
        (LENGTH, "Clearance", 0.0, "Clearance on each side of a block; 0 for that of the fit"),
        (LENGTH, "Rim", 1.18, "Height from the holder's top to the block's highest point"),
        (WHOLE, "Slots", (1, 1, 24, 1), "Number of pockets"),
        (LENGTH, "Floor", 1.65, "Thickness of the floor below the pockets"),
        (LENGTH, "Margin", 11.0, "Distance from the pockets to the edge of the plate"),
        (LENGTH, "Web", 8.0, "Distance between two pockets"),
        (LENGTH, "Nozzle", 0.4, "Width of the printer's nozzle, which sets the thinnest wall that is allowed"),
        (SWITCH, "FollowBlock", True, "Keep the first pocket around the block, wherever the block is moved"),
    )

    def request(self, obj: Any) -> dict[str, Any]:
        """Return the arguments of ``housing.Holder``."""
        if obj.Block is None:
            raise shapes.WorkerError(f"{obj.Label}: Block is empty. Choose the texture block of the holder.")
        return {
            **obj.Block.Proxy.request(obj.Block),
            "holder": {
                "preset": obj.Preset,
                "fit": set_number(obj.Clearance) or obj.Fit,
                "rim_mm": number(obj.Rim),
                "slots": obj.Slots,
                "floor_mm": number(obj.Floor),
                "margin_mm": number(obj.Margin),
                "web_mm": number(obj.Web),
                "nozzle_mm": number(obj.Nozzle),
            },
        }

    def finish(self, obj: Any, facts: dict[str, Any]) -> None:
        """Move the holder below its block."""
        if obj.FollowBlock:
            slot = FreeCAD.Placement(FreeCAD.Matrix(*facts["slots"][0]))
            obj.Placement = obj.Block.Placement.multiply(slot.inverse())


class Jig(Parametric):
    """A jig for marking the press positions, in its place of use on the holder that it is linked to."""

    group = "Jig"
    kind = "jig"
    properties = (
        ("App::PropertyLink", "Holder", None, "Holder that the jig rests on"),
        (CHOICE, "Marks", ["default", "all"], "Holes at corners and centre, or 25 small holes for resin printers"),
        (LENGTH, "Nozzle", 0.4, "Width of the printer's nozzle, which sets the thinnest wall that is allowed"),
        (SWITCH, "FollowHolder", True, "Keep the jig on its holder, wherever the holder is moved"),
    )

    def request(self, obj: Any) -> dict[str, Any]:
        """Return the arguments of ``housing.Jig``."""
        if obj.Holder is None:
            raise shapes.WorkerError(f"{obj.Label}: Holder is empty. Choose the holder of the jig.")
        own = {"marks": obj.Marks, "nozzle_mm": number(obj.Nozzle)}
        return {**obj.Holder.Proxy.request(obj.Holder), "jig": own}

    def finish(self, obj: Any, facts: dict[str, Any]) -> None:
        """Move the jig onto its holder."""
        if obj.FollowHolder:
            obj.Placement = obj.Holder.Placement


class TexturedFace(Parametric):
    """A part of the document with a texture on one of its faces. The part itself is hidden, but stays as it is."""

    group = "Texture"
    kind = "textured"
    properties = (
        ("App::PropertyLinkSub", "Face", None, "Plane or cylinder of a solid that carries the texture"),
        (
            CHOICE,
            "Texture",
            lambda: shapes.ask({"action": "catalogue"})["textures"],
            "Texture of the paper, or a later texture of its authors",
        ),
        ("App::PropertyFile", "TextureFile", "", "TOML file of a texture, which replaces the texture above"),
        (LENGTH, "Depth", 0.0, "Height from the lowest valley to the highest point; 0 for that of the file, or 1 mm"),
        (LENGTH, "Margin", 1.0, "Distance between the texture and the edges of the face"),
        (LENGTH, "Fade", 0.0, "Length over which the texture fades out towards its outline; 0 for no fade"),
        (CHOICE, "Up", ["default", *UPS], "Direction of the texture's x on a plane, or of its beginning on a cylinder"),
        (SWITCH, "Sunk", False, "Whether the texture lies below the face instead of above it"),
        (LENGTH, "Base", 0.2, "Distance of the texture from the face, which is the height of the walls around it"),
        (LENGTH, "UnitX", 0.0, "Length of one unit of u; 0 for that of the file or the preset paper"),
        (LENGTH, "UnitY", 0.0, "Length of one unit of v; 0 for that of the file or the preset paper"),
        (NUMBER, "ToleranceMicrometres", 1.0, "Largest distance of the surface from the formula, in micrometres"),
    )
    results = (
        *Parametric.results[1:],
        (TEXT, "Error", "", "Bound of the distance between surface and formula, proved or measured"),
    )

    def request(self, obj: Any) -> dict[str, Any]:
        """Return the shape of the part, the number of the face, and the settings of the texture."""
        part, names = obj.Face or (None, [])
        if part is None or len(names) != 1 or not names[0].startswith("Face"):
            raise shapes.WorkerError(f"{obj.Label}: Face must be one face of an object. Select a face and choose it.")
        shape = part.Shape.copy(True, False)  # without its mesh, which would change the request
        shape.Placement = FreeCAD.Placement()
        unit = [set_number(obj.UnitX), set_number(obj.UnitY)]
        if (unit[0] is None) != (unit[1] is None):
            raise shapes.WorkerError(f"{obj.Label}: UnitX and UnitY must both be 0 or both be set.")
        return {
            "part": shape.exportBrepToString(),
            "face": int(names[0][len("Face") :]),
            "texturing": {
                "texture": obj.Texture,
                "file": obj.TextureFile or None,
                "depth_mm": set_number(obj.Depth),
                "margin_mm": number(obj.Margin),
                "fade_mm": number(obj.Fade),
                "up": None if obj.Up == "default" else obj.Up,
                "sunk": obj.Sunk,
                "base_mm": number(obj.Base),
                "mm_per_unit": None if unit[0] is None else unit,
                "tolerance_mm": obj.ToleranceMicrometres / 1000.0,
            },
        }

    def finish(self, obj: Any, facts: dict[str, Any]) -> None:
        """Show the certificate of the surface, and lie where the part lies."""
        obj.Error = error_of(facts)
        obj.Placement = obj.Face[0].Placement


def make(document: Any, kind: type[Parametric], **properties: Any) -> Any:
    """Add an object to a document.

    Args:
        document: The document.
        kind: The class of the object.
        properties: Values of its properties.

    Returns:
        The object. Its shape is made by the next recompute.

    Raises:
        WorkerError: tacbench-cad cannot be started. The document stays as it was.
    """
    obj = document.addObject("Part::FeaturePython", kind.__name__)
    try:
        kind(obj)
        for name, value in properties.items():
            setattr(obj, name, value)
    except Exception:
        document.removeObject(obj.Name)
        raise
    if FreeCAD.GuiUp:
        from freecad.tacbench.views import View

        View(obj.ViewObject)
        for child in obj.ViewObject.Proxy.claimChildren():
            child.ViewObject.Visibility = False
        obj.ViewObject.ShapeColor = tuple(shapes.ask({"action": "catalogue"})["rgb"][kind.kind])
    return obj


def make_block(document: Any, **properties: Any) -> Any:
    """Add a texture block to a document."""
    return make(document, TextureBlock, **properties)


def make_holder(document: Any, block: Any, **properties: Any) -> Any:
    """Add a holder for a texture block to a document."""
    return make(document, Holder, Block=block, **properties)


def make_jig(document: Any, holder: Any, **properties: Any) -> Any:
    """Add a jig for a holder to a document."""
    return make(document, Jig, Holder=holder, **properties)


def make_textured_face(document: Any, part: Any, face: str, **properties: Any) -> Any:
    """Add a copy of a part with a texture on one of its faces to a document.

    Args:
        document: The document.
        part: The object whose shape is one solid.
        face: The name of the face, such as ``Face6``, as FreeCAD shows it.
        properties: Values of the properties.
    """
    return make(document, TexturedFace, Face=(part, [face]), **properties)


def export_object(obj: Any, path: str) -> str:
    """Write an object to a STEP, STL or 3MF file, and check the file.

    The mesh of a block is made from the formula, and its error is proved. For a part with a
    textured face, the error of the mesh is measured. FreeCAD's own export states no error.

    Args:
        obj: A texture block, a holder, a jig, or a part with a textured face.
        path: The file. Its ending determines the format.

    Returns:
        The report of the checks.

    Raises:
        WorkerError: The file cannot be written, or it does not pass the checks. Then it does not exist.
    """
    return shapes.ask({**obj.Proxy.request(obj), "action": "export", "file": str(path)})["report"]
