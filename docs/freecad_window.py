"""Draw the pictures of the FreeCAD workbench in docs/freecad.md: windows of FreeCAD under Xvfb.

``python docs/freecad_window.py window.png parts`` draws block, holder and jig; with ``face`` instead of ``parts`` it
draws a plate with textures on two of its faces. The script needs FreeCAD, xvfb-run and a Python environment of
tacbench-cad, which runs it. FreeCAD gets a folder of its own for its settings, with a link to the workbench.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: The size of the window, in pixels.
WIDTH, HEIGHT = 1300, 800
MAX_SECONDS = 300

#: Settings of FreeCAD: it begins with our workbench, without its start page and its animations.
SETTINGS = """
import FreeCAD, os
at = FreeCAD.ParamGet
at("User parameter:BaseApp/Preferences/General").SetString("AutoloadModule", "TacbenchWorkbench")
at("User parameter:BaseApp/Preferences/Mod/Start").SetBool("ShowOnStartup", False)
at("User parameter:BaseApp/Preferences/View").SetBool("UseNavigationAnimations", False)
at("User parameter:BaseApp/Preferences/Mod/Tacbench").SetString("Python", os.environ["OUR_PYTHON"])
FreeCAD.saveParameter()
"""

#: What is done in the window: the buttons are used one after the other, each with what it needs selected.
SESSION = """
import os, traceback
import FreeCAD, FreeCADGui, Part
from PySide import QtCore, QtGui

def choose(obj):
    FreeCADGui.Selection.clearSelection()
    FreeCADGui.Selection.addSelection(obj)

def parts():
    for name in ("Block", "Holder", "Jig"):
        FreeCADGui.runCommand("Tacbench_" + name)
        choose(FreeCAD.ActiveDocument.Objects[-1])
    block, holder, jig = FreeCAD.ActiveDocument.Objects
    block.Texture = "texture-2"
    jig.FollowHolder, jig.Placement.Base.y = False, jig.Placement.Base.y + 65
    return block

def face():
    document = FreeCAD.newDocument()
    plate, bore = document.addObject("Part::Box", "Box"), document.addObject("Part::Cylinder", "Bore")
    plate.Length, plate.Width, plate.Height = 60, 40, 12
    bore.Radius, bore.Height, bore.Placement.Base = 11, 30, FreeCAD.Vector(40, 20, -5)
    cut = document.addObject("Part::Cut", "Plate")
    cut.Base, cut.Tool = plate, bore
    document.recompute()
    for texture, fits in (("texture-2", lambda face: face.CenterOfMass.z > 11.9),
                          ("texture-1", lambda face: isinstance(face.Surface, Part.Cylinder))):
        part = document.Objects[-1]
        (number,) = [i for i, face in enumerate(part.Shape.Faces, 1) if fits(face)][-1:]
        FreeCADGui.Selection.clearSelection()
        FreeCADGui.Selection.addSelection(part, "Face%d" % number)
        FreeCADGui.runCommand("Tacbench_Face")
        document.Objects[-1].Texture = texture
        document.recompute()
    document.Objects[-1].Depth = 0.8
    return document.Objects[-2]

def session():
    window = FreeCADGui.getMainWindow()
    FreeCADGui.activateWorkbench("TacbenchWorkbench")
    shown = {"parts": parts, "face": face}[os.environ["SCENE"]]()
    FreeCAD.ActiveDocument.recompute()
    for part in FreeCAD.ActiveDocument.Objects:
        if not part.isValid():
            raise RuntimeError(part.Name + ": " + part.getStatusString())
    choose(shown)
    for dock in window.findChildren(QtGui.QDockWidget):
        dock.setVisible(dock.objectName() in ("Combo View", "Model", "Tree view", "Property view"))
    for bar in window.findChildren(QtGui.QToolBar):
        bar.setVisible(bar.objectName() in ("Tacbench", "File", "Workbench"))
    window.resize(int(os.environ["WIDTH"]), int(os.environ["HEIGHT"]))
    window.resizeDocks([dock for dock in window.findChildren(QtGui.QDockWidget) if dock.isVisible()][:1], [360],
                       QtCore.Qt.Horizontal)
    for splitter in window.findChildren(QtGui.QSplitter):
        splitter.setSizes([120, 500])  # the tree above, the properties below
    view = FreeCADGui.activeDocument().activeView()
    view.viewIsometric()
    view.fitAll()
    FreeCADGui.Selection.clearSelection()
    FreeCADGui.updateGui()
    choose(shown)

def photograph():
    QtGui.QApplication.primaryScreen().grabWindow(0).save(os.environ["PICTURE"])
    os._exit(0)

def run(step):
    try:
        step()
    except Exception:
        traceback.print_exc()
        os._exit(1)

QtCore.QTimer.singleShot(2000, lambda: (run(session), QtCore.QTimer.singleShot(2000, lambda: run(photograph))))
"""


def main(picture: Path, scene: str) -> None:
    """Draw a picture of a scene: ``parts`` or ``face``."""
    window = shutil.which("freecad") or shutil.which("FreeCAD")
    console = shutil.which("freecadcmd") or shutil.which("FreeCADCmd")
    if window is None or console is None or shutil.which("xvfb-run") is None:
        sys.exit("FreeCAD or xvfb-run is not installed: apt-get install freecad xvfb xauth")
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        (home / "Mod").mkdir()
        (home / "Mod" / "tacbench-cad").symlink_to(ROOT)
        for name, text in (("settings.py", SETTINGS), ("session.py", SESSION)):
            (home / name).write_text(text, encoding="utf-8")
        variables = os.environ | {
            "FREECAD_USER_HOME": str(home),
            "OUR_PYTHON": sys.executable,
            "PICTURE": str(picture.resolve()),
            "SCENE": scene,
            "WIDTH": str(WIDTH),
            "HEIGHT": str(HEIGHT),
            "QTWEBENGINE_DISABLE_SANDBOX": "1",
        }
        screen = ["xvfb-run", "-a", "-s", f"-screen 0 {WIDTH}x{HEIGHT}x24"]
        for command in ([console, home / "settings.py"], [*screen, window, home / "session.py"]):
            subprocess.run(command, env=variables, stdin=subprocess.DEVNULL, check=True, timeout=MAX_SECONDS)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
