"""An assembly and its file: every part in it, whole and at its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.checks import meshcheck
from tacbench_cad.checks.report import Check, Report
from tacbench_cad.geometry.part import Part, box_of
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

#: A solid, and a corner of the whole, must lie this near to its place, in mm.
PLACE_MM = 1e-3
#: The kernel's volume must come this near to the closed form, as a fraction of it.
_KERNEL_FRACTION = 1e-4


def verify_mesh_assembly(part: Part, path: Path) -> Report:
    """Closed, oriented, volume and box of all bodies together."""
    mesh, (_, expected) = meshcheck.read_mesh(path), part.mesh
    checks = [
        Check(name="file", ok=True, detail="read back; all coordinates finite"),
        *meshcheck.edge_checks(meshcheck.edges(mesh)),
        _volume(mesh.volume_mm3, expected.volume_mm3, expected.volume_slack_mm3, "volume"),
        _box(np.concatenate(mesh.bounds_mm), np.concatenate(box_of(part.placed)), "box"),
    ]
    return Report.of_mesh(path, mesh, checks, None, mesh.volume_mm3)


def verify_solid_assembly(part: Part, path: Path) -> Report:
    """Each solid, brought back to its own frame: valid, of its volume, and its lower corner at the origin."""
    from OCP.gp import gp_Trsf
    from OCP.TopLoc import TopLoc_Location

    from tacbench_cad.checks import solidcheck
    from tacbench_cad.checks.survey import survey
    from tacbench_cad.formats import step

    solids = _solids(step.read_step(path))
    complete = len(solids) == len(part.placed)
    checks = [Check(name="parts", ok=complete, detail=f"{len(solids)} solids, {len(part.placed)} are wanted")]
    total = 0.0
    for solid, (placed, matrix) in zip(solids, part.placed, strict=False):
        expected, name = placed.solid[1], placed.name_in("solid")
        place = gp_Trsf()
        place.SetValues(*matrix[:3].ravel().tolist())
        back = solid.Moved(TopLoc_Location(place.Inverted()))
        measured = survey(back).measured
        total += measured.volume_mm3
        checks += [replace(check, name=f"{name}: {check.name}") for check in solidcheck.solid_checks(back)]
        allowed = _KERNEL_FRACTION * expected.volume_mm3 + expected.volume_slack_mm3
        checks.append(_volume(measured.volume_mm3, expected.volume_mm3, allowed, f"{name}: volume"))
        corners = np.concatenate([measured.low_mm, measured.high_mm])
        at_most = PLACE_MM if expected.certificate is None else max(PLACE_MM, expected.certificate.vertical_mm)
        checks.append(_box(corners, np.array([0.0, 0.0, 0.0, *placed.size_mm]), f"{name}: place", at_most))
    return Report(path=path, checks=tuple(checks), volume_mm3=total, size_mm=part.size_mm)


def _solids(shape: TopoDS_Shape) -> list[Any]:
    """The solids in the order of the file, with their places."""
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer

    solids, explorer = [], TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_SOLID)
    while explorer.More():
        solids.append(explorer.Current())
        explorer.Next()
    return solids


def _volume(measured: float, expected: float, allowed: float, name: str) -> Check:
    off = measured - expected
    detail = f"{measured:.6f} mm^3, {off:+.2e} from the closed form (allowed {allowed:.1e})"
    return Check(name=name, ok=abs(off) <= allowed, detail=detail)


def _box(measured: Floats, expected: Floats, name: str, allowed: float = PLACE_MM) -> Check:
    off = float(np.abs(measured - expected).max())
    return Check(name=name, ok=off <= allowed, detail=f"{off:.1e} mm from its place (allowed {allowed:g})")
