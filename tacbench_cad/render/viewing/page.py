"""The 3D page: one HTML file that loads nothing.

The drawing code comes from the package k3d (extra ``view``), which also packs the meshes; the page around them is
ours. A content security policy in the page forbids the browser every request.
"""

from __future__ import annotations

import base64
import html
import json
import os
import re
import zlib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import colour_of
from tacbench_cad.render.viewing.scene import Scene, SceneFormula, Thing
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import replacing
from tacbench_cad.util.packages import require

#: Colour and radius (mm) of the balls on the press positions.
_PRESS_COLOUR, _PRESS_MM = 0x1B1B1B, 0.22
#: Font declarations of k3d's labels. The page has no such labels, and the browser would look for the font files.
_FONTS = re.compile(r"@font-face\{(?:\$\{\w+\}|[^{}])*\}")
#: Level of compression: the strongest.
_LEVEL = 9


def write_page(scene: Scene, path: Path) -> None:
    """Write a scene as one HTML file.

    Args:
        scene: The content of the page.
        path: The file; its name ends in ``.html``.

    Raises:
        MissingToolError: k3d is not installed.
        InputError: The file's name or folder is not allowed.
    """
    require_page(path)
    with replacing(path) as temporary:
        temporary.write_text(page_of(scene), encoding="utf-8")


def require_page(path: Path) -> None:
    """Refuse a page that cannot be written, before anything is built.

    Args:
        path: The file of the page.

    Raises:
        MissingToolError: k3d is not installed.
        InputError: The name does not end in ``.html``, or the folder cannot take the file.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError("out", str(path), "must end in .html")
    require("the 3D page", "k3d")
    if path.is_dir():
        raise InputError("out", str(path), "is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError("out", str(path), f"there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise InputError("out", str(path), f"the folder {path.parent} is not writable")


def page_of(scene: Scene) -> str:
    """The text of the page. It needs k3d; :func:`require_page` reports if k3d is missing."""
    ours = resources.files("tacbench_cad.render.viewing")
    library = resources.files("k3d") / "static"
    pieces = {
        "TITLE": html.escape(_title(scene)),
        "STYLE": (ours / "page.css").read_text(encoding="utf-8"),
        "FACTS": _script_safe(json.dumps(_description(scene), allow_nan=False)),
        "LICENCES": html.escape(_licences()),
        "LIBRARY": _packed(_FONTS.sub("", (library / "standalone.js").read_text(encoding="utf-8")).encode()),
        "OBJECTS": base64.b64encode(_objects(scene)).decode("ascii"),
        "MESHES": _packed(b"".join(_differences(thing.mesh) for thing in scene.things)),
        "CODE": "".join((ours / name).read_text(encoding="utf-8") for name in ("colours.js", "page.js")),
    }
    page = (ours / "page.html").read_text(encoding="utf-8")
    before, *rest = page.split("[[")
    return before + "".join(pieces[name] + after for name, after in (part.split("]]", 1) for part in rest))


def _title(scene: Scene) -> str:
    names = [thing.name for thing in scene.things]
    return names[0] if len(names) == 1 else f"{len(names)} parts: {names[0]} to {names[-1]}"


def _script_safe(text: str) -> str:
    """Escape JSON so that no HTML parser reads markup in it: users choose the names of textures."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, _LEVEL)).decode("ascii")


def _differences(mesh: Mesh) -> bytes:
    """A mesh in a form that zlib compresses well: differences between neighbours in its tables.

    Each column of the vertices (the bits of float32) and of the triangles is replaced by its differences, as 32-bit
    integers that wrap around. The first bytes of all numbers come first, then all second bytes, and so on. Nothing is
    lost. On a regular grid the compressed result is a thirtieth of the size of the compressed plain tables.
    """
    bits = mesh.vertices.astype("<f4").view("<i4")
    columns = [*bits.T, *mesh.faces.astype("<i4").T]
    steps = np.concatenate([np.diff(column, prepend=np.zeros(1, "<i4")) for column in columns]).astype("<i4")
    return steps.view(np.uint8).reshape(-1, 4).T.tobytes()


def _licences() -> str:
    """The licences of the code in the page. Its authors ask for them in every copy."""
    from importlib.metadata import distribution

    named = (resources.files("k3d") / "static" / "standalone.js.LICENSE.txt").read_text(encoding="utf-8")
    own = distribution("k3d").read_text("licenses/LICENSE.txt") or ""
    return f"{own}\n{named}"


def _description(scene: Scene) -> dict[str, Any]:
    """The scene without its meshes, as plain values. Matrices are listed by columns, as WebGL reads them."""
    return {
        "version": __version__,
        "things": [_plain(number, thing) for number, thing in enumerate(scene.things)],
        "left_out": [{"what": what, "reason": reason} for what, reason in scene.left_out],
    }


def _plain(number: int, thing: Thing) -> dict[str, Any]:
    low, high = thing.mesh.bounds_mm
    press = thing.press
    return {
        "id": _mesh_id(number),
        "name": thing.name,
        "kind": thing.kind,
        "title": thing.title,
        "colour": f"#{colour_of(thing.kind):06x}",
        "set": thing.set_number,
        "slot": thing.slot,
        "counts": [len(thing.mesh.vertices), len(thing.mesh.faces)],
        "low": low.tolist(),
        "high": high.tolist(),
        "matrix": thing.to_world.T.ravel().tolist(),
        "facts": [list(pair) for pair in thing.facts],
        "formula": None if thing.formula is None else _plain_formula(thing.formula),
        "press": None
        if press is None
        else {
            "id": _press_id(number),
            "positions": np.round(press.positions_mm, 6).tolist(),
            "contacts": [[force, round(radius, 3)] for force, radius in press.contacts],
        },
    }


def _plain_formula(formula: SceneFormula) -> dict[str, Any]:
    # Frequencies and phases are in turns: a shader subtracts whole turns exactly; its sine is accurate near zero only.
    waves = None if formula.waves is None else formula.waves / np.array([1.0, *[2.0 * np.pi] * 3])
    return {
        "equation": formula.equation,
        "datum": formula.datum_mm,
        "waves": None if waves is None else waves.tolist(),
        "range": list(formula.range_mm),
        "scale": formula.scale_mm,
    }


def _mesh_id(number: int) -> int:
    return 2 * number + 1


def _press_id(number: int) -> int:
    return 2 * number + 2


def _objects(scene: Scene) -> bytes:
    """The k3d objects of meshes and press positions, without the meshes' tables, which the page fills in.

    Objects get their numbers here. k3d would number them by their places in memory, which differ from run to run.
    """
    import k3d

    plot = k3d.plot(
        grid_visible=False,
        camera_auto_fit=False,
        menu_visibility=False,
        fps_meter=False,
        axes_helper=0.0,
        background_color=0xF6F7F9,
        lighting=1.7,
        camera_fov=35.0,
        antialias=1,
        camera_mode="orbit",
        camera_up_axis="z",
        name="tacbench",
    )
    for number, thing in enumerate(scene.things):
        mesh = k3d.mesh(
            np.zeros((3, 3), np.float32),
            np.array([[0, 1, 2]], np.uint32),
            color=colour_of(thing.kind),
            flat_shading=True,
            side="double",
            roughness=0.75,
            model_matrix=thing.to_world.astype(np.float32),
            compression_level=0,
        )
        mesh.id = _mesh_id(number)
        plot += mesh
        if thing.press is not None:
            balls = k3d.points(
                thing.press.positions_mm.astype(np.float32),
                point_size=2.0 * _PRESS_MM,
                color=_PRESS_COLOUR,
                shader="3d",
                model_matrix=thing.to_world.astype(np.float32),
                compression_level=0,
            )
            balls.id = _press_id(number)
            plot += balls
    return bytes(plot.get_binary_snapshot(_LEVEL))
