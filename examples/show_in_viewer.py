"""Show a block in its holder, and the jig beside it, in CQ-editor or in OCP CAD Viewer.

In CQ-editor, open this file and render it. For OCP CAD Viewer in VS Code, run it while the viewer is open. Without VS
Code, the package ``ocp_viewer`` shows the parts in the browser: start ``python -m ocp_viewer`` first.
"""

import cadquery as cq

from housing import Holder, Jig
from housing.cq import assembled, solid
from tacbench_cad import Block

GAP_MM = 10.0

block = Block.of(2, key_mm=3.0)
holder = Holder(block=block)
jig = Jig(holder=holder)

together = assembled(holder)
beside = cq.Location((holder.size_mm[0] + GAP_MM, 0.0, 0.0))
result = cq.Assembly(name="print set").add(together).add(solid(jig), name=jig.name, loc=beside, color=cq.Color("teal"))

if "show_object" in globals():  # CQ-editor defines this function
    show_object(result, name=result.name)  # noqa: F821
else:
    from ocp_vscode import show

    show(result, names=[result.name], angular_tolerance=0.5)
