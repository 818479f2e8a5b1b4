"""FreeCAD workbench: texture blocks, holders and jigs as parametric objects.

The functions below also work in macros and in ``freecadcmd``::

    import FreeCAD
    from freecad.tacbench import make_block, make_holder, make_jig

    document = FreeCAD.newDocument()
    block = make_block(document, Texture="texture-2", Key=3)
    holder = make_holder(document, block, Slots=2)
    jig = make_jig(document, holder)
    document.recompute()

FreeCAD has its own Python and its own CAD kernel, so the shapes are made by a second process in the Python environment
of tacbench-cad (:mod:`.worker`).
"""

from freecad.tacbench.objects import export_object, make_block, make_holder, make_jig, make_textured_face

__all__ = ["export_object", "make_block", "make_holder", "make_jig", "make_textured_face"]
