"""How the objects look in FreeCAD's window."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from freecad.tacbench.stateless import Stateless

ICONS = Path(__file__).with_name("icons")
#: FreeCAD's display meshes: the largest angle between neighbouring triangles, in degrees. Its default of 28.5 makes so
#: many triangles on a texture with fine waves that the window waits for minutes.
DISPLAY_ANGLE_DEG = 85.0


class View(Stateless):
    """The view provider of all objects."""

    def __init__(self, view: Any) -> None:
        view.AngularDeflection = DISPLAY_ANGLE_DEG
        view.Proxy = self

    def attach(self, view: Any) -> None:
        """Remember the object. FreeCAD calls this method when the object is made or its document is opened."""
        self._object = view.Object

    def getIcon(self) -> str:
        """Return the icon of the tree."""
        return str(ICONS / f"{type(self._object.Proxy).__name__}.svg")

    def claimChildren(self) -> list[Any]:
        """Return the objects that the tree shows below this one: the part of a textured face."""
        face = getattr(self._object, "Face", None)
        return [face[0]] if face else []
