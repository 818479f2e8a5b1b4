"""Adds the workbench to FreeCAD's window. FreeCAD imports this module when it starts."""

from __future__ import annotations

from pathlib import Path

import FreeCADGui

_FOLDER = Path(__file__).parent


class TacbenchWorkbench(FreeCADGui.Workbench):
    """The workbench in FreeCAD's list."""

    MenuText = "Tacbench"
    ToolTip = "Tactile texture blocks from formulas, with holder and jig"
    Icon = str(_FOLDER / "icons" / "TextureBlock.svg")

    def Initialize(self) -> None:
        """Add menu and toolbar. FreeCAD calls this method when the workbench is first chosen."""
        from freecad.tacbench.commands import register

        names = register()
        self.appendToolbar("Tacbench", names)
        self.appendMenu("Tacbench", names)

    def GetClassName(self) -> str:
        """Return the class by which FreeCAD runs a workbench in Python."""
        return "Gui::PythonWorkbench"


FreeCADGui.addIconPath(str(_FOLDER / "icons"))
FreeCADGui.addPreferencePage(str(_FOLDER / "preferences.ui"), "Tacbench")
FreeCADGui.addWorkbench(TacbenchWorkbench())
