"""Verification that the file of an assembly contains every part completely and in its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tacbench_cad.checks import meshcheck
from tacbench_cad.checks.report import Check, Report, genus_check, volume_check
from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.part import PrintPart, box_of
from tacbench_cad.util.types import Floats

#: The largest allowed distance of a solid, or of a corner of the whole bounding box, from its expected place, in mm.
PLACE_MM = 1e-3
#: The largest allowed difference of the kernel's volume from the closed form, as a fraction of the closed form.
_KERNEL_FRACTION = 1e-4


def verify_mesh_assembly(part: PrintPart, path: Path) -> Report:
    """Check the edges, the volume and the bounding box of all bodies together."""
    mesh, (_, expected) = meshcheck.read_mesh(path), part.mesh
    checks = [
        Check(name="file", ok=True, detail="read back; all coordinates finite"),
        *meshcheck.edge_checks(meshcheck.edges(mesh)),
        volume_check(mesh.volume_mm3, expected.volume_mm3, expected.volume_slack_mm3, "volume"),
        _box(np.concatenate(mesh.bounds_mm), np.concatenate(box_of(part.placed)), "box"),
    ]
    return Report.of_mesh(path, mesh, checks, None, mesh.volume_mm3)


def verify_solid_assembly(part: PrintPart, path: Path) -> Report:
    """Transform each solid back to its own frame, and check its validity, its volume and its bounding box."""
    from tacbench_cad.checks import solidcheck
    from tacbench_cad.formats import step

    solids = list(kernel.each(step.read_step(path), "SOLID"))
    complete = len(solids) == len(part.placed)
    detail = f"{len(solids)} of {len(part.placed)} solids"
    checks = [Check(name="parts", ok=complete, detail=detail)]
    total = 0.0
    for solid, (placed, matrix) in zip(solids, part.placed, strict=False):
        expected, name = placed.solid[1], placed.name_in("solid")
        back = solid.Moved(kernel.location(matrix).Inverted())
        measured = solidcheck.measure(back)
        total += measured.volume_mm3
        rows = [*solidcheck.solid_checks(back), genus_check(kernel.genus(back), placed.genus)]
        checks += [replace(check, name=f"{name}: {check.name}") for check in rows]
        allowed = _KERNEL_FRACTION * expected.volume_mm3 + expected.volume_slack_mm3
        checks.append(volume_check(measured.volume_mm3, expected.volume_mm3, allowed, f"{name}: volume"))
        corners = np.concatenate([measured.low_mm, measured.high_mm])
        place_mm = PLACE_MM if expected.certificate is None else max(PLACE_MM, expected.certificate.vertical_mm)
        checks.append(_box(corners, np.array([0.0, 0.0, 0.0, *placed.size_mm]), f"{name}: place", place_mm))
    return Report(path=path, checks=tuple(checks), volume_mm3=total, size_mm=part.size_mm)


def _box(measured: Floats, expected: Floats, name: str, allowed: float = PLACE_MM) -> Check:
    off = float(np.abs(measured - expected).max())
    return Check(name=name, ok=off <= allowed, detail=f"{off:.1e} mm from its place (allowed {allowed:g} mm)")
