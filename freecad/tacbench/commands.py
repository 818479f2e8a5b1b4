"""The buttons of the workbench."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtGui

from freecad.tacbench import objects
from freecad.tacbench.shapes import WorkerError
from freecad.tacbench.views import ICONS


def selected(kind: type[objects.Parametric]) -> Any:
    """Return the selected object of a kind, or None."""
    chosen = [obj for obj in FreeCADGui.Selection.getSelection() if isinstance(getattr(obj, "Proxy", None), kind)]
    return chosen[0] if len(chosen) == 1 else None


def selected_face() -> tuple[Any, str] | None:
    """Return the object and the name of the selected face, or None."""
    chosen = [(item.Object, name) for item in FreeCADGui.Selection.getSelectionEx() for name in item.SubElementNames]
    return chosen[0] if len(chosen) == 1 and chosen[0][1].startswith("Face") else None


class Command:
    """A button.

    Args:
        icon: The name of the icon.
        text: The text of the menu.
        tip: What the button does.
        selection: Returns the selected object that the button needs, or None, which disables the button.
        do: What happens. It receives the document and the selected object.
    """

    def __init__(
        self, icon: str, text: str, tip: str, selection: Callable[[], Any], do: Callable[[Any, Any], Any]
    ) -> None:
        self._icon, self._text, self._tip, self._selection, self._do = icon, text, tip, selection, do

    def GetResources(self) -> dict[str, str]:
        """Return what FreeCAD shows."""
        return {"Pixmap": str(ICONS / f"{self._icon}.svg"), "MenuText": self._text, "ToolTip": self._tip}

    def IsActive(self) -> bool:
        """Return whether the button is enabled."""
        return self._selection() is not None

    def Activated(self) -> None:
        """Do it as one step that can be undone."""
        document = FreeCAD.ActiveDocument or FreeCAD.newDocument()
        document.openTransaction(self._text)
        try:
            self._do(document, self._selection())
            document.recompute()
        except WorkerError as error:
            document.abortTransaction()
            QtGui.QMessageBox.warning(FreeCADGui.getMainWindow(), self._text, str(error))
        else:
            document.commitTransaction()


def add_block(document: Any, _: Any) -> None:
    """Add a block with a key, and show it."""
    objects.make_block(document, Key=3.0)
    document.recompute()
    FreeCADGui.SendMsgToActiveView("ViewFit")


def write_file(document: Any, obj: Any) -> None:
    """Ask for a file and write the object into it."""
    formats = "STEP (*.step);;STL (*.stl);;3MF (*.3mf)"
    path, _ = QtGui.QFileDialog.getSaveFileName(
        FreeCADGui.getMainWindow(), "Export", f"{getattr(obj, 'PartName', '') or obj.Label}.step", formats
    )
    if path:
        FreeCAD.Console.PrintMessage(objects.export_object(obj, path) + "\n")


def add_texture(document: Any, face: tuple[Any, str]) -> None:
    """Put a texture on a face."""
    objects.make_textured_face(document, *face)


COMMANDS = {
    "Tacbench_Block": Command("TextureBlock", "Texture block", "Add a texture block", lambda: True, add_block),
    "Tacbench_Holder": Command(
        "Holder",
        "Holder",
        "Add a holder for the selected block",
        lambda: selected(objects.TextureBlock),
        objects.make_holder,
    ),
    "Tacbench_Jig": Command(
        "Jig", "Jig", "Add a jig for the selected holder", lambda: selected(objects.Holder), objects.make_jig
    ),
    "Tacbench_Face": Command(
        "TexturedFace",
        "Texture on a face",
        "Put a texture on the selected face, which must be a plane or a cylinder",
        selected_face,
        add_texture,
    ),
    "Tacbench_Export": Command(
        "Export",
        "Export and check",
        "Write the selected object to a STEP, STL or 3MF file with a stated error, and check the file",
        lambda: selected(objects.Parametric),
        write_file,
    ),
}


def register() -> list[str]:
    """Add the commands to FreeCAD and return their names."""
    for name, command in COMMANDS.items():
        FreeCADGui.addCommand(name, command)
    return list(COMMANDS)
