"""Verification that a file contains the part for which it was written.

All values are read back from the file and never taken from memory. After a failed check, the later checks may be
meaningless; therefore the order is: file and finite numbers, edges, triangles, volume, manifold3d, bounding box,
distance from the formula.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks import meshcheck
from tacbench_cad.checks.assembly_check import verify_mesh_assembly, verify_solid_assembly
from tacbench_cad.checks.complete import completeness_checks
from tacbench_cad.checks.match import GRID_MM, PLACEMENTS, Candidate, Facets, Match
from tacbench_cad.checks.outline import outline_checks
from tacbench_cad.checks.report import Check, Report, genus_check, volume_check
from tacbench_cad.formats import format_of
from tacbench_cad.geometry import kernel, relief
from tacbench_cad.geometry.mesh import ExpectedGeometry, MeasuredRelief, Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.text import at_most, mm
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

    from tacbench_cad.checks.solidcheck import MeasuredSolid

__all__ = ["Check", "Report", "verify"]

#: The largest allowed difference of the kernel's volume from the closed form, as a fraction of the closed form.
SOLID_VOLUME_FRACTION = 1e-5
#: The same for the kernel's default volume, which CadQuery and build123d show.
DEFAULT_VOLUME_FRACTION = 1e-4
#: The largest allowed difference of the kernel's bounding box from the size of the part, in mm.
SOLID_BOX_MM = 1e-3
#: The relative rounding of a float32 value.
_FLOAT32 = 2.0**-23
#: The number of points on the textured faces of a part that is not a block.
FACE_POINTS = 20_000


def verify(part: PrintPart, path: Path, full: bool = False) -> Report:
    """Check a file that was written for a part.

    Args:
        part: The part that the file is expected to contain.
        path: The file. Its ending determines the format.
        full: Whether the checks of a mesh by pymeshlab, or of the kernel's default volume, are done as well.

    Returns:
        The report. :attr:`Report.ok` is True if all checks passed.

    Raises:
        InputError: The file does not exist, or its format is unknown.
        MissingToolError: A package that the format or ``full`` needs is not installed.
    """
    solid = format_of(path).shape == "solid"
    try:
        if part.placed:
            return verify_solid_assembly(part, path) if solid else verify_mesh_assembly(part, path)
        if solid:
            return _verify_solid(part, path, full)
        return _verify_mesh(part, path, meshcheck.read_mesh(path), full)
    except CheckFailedError as error:
        return Report(path=path, checks=(Check(name="file", ok=False, detail=str(error).removeprefix(f"{path}: ")),))


def _verify_mesh(part: PrintPart, path: Path, mesh: Mesh, full: bool) -> Report:
    _, expected = part.mesh
    edges = meshcheck.edges(mesh)
    checks = [
        Check(name="file", ok=True, detail="read back; all coordinates finite"),
        *meshcheck.edge_checks(edges),
        meshcheck.degenerate_check(mesh),
        _mesh_volume(mesh, expected),
    ]
    if edges.ok:
        checks += _manifold(mesh, part.genus)
    checks.append(_mesh_box(part, mesh, expected))
    deviation = None
    if expected.certificate is not None:
        relief_checks, deviation = _mesh_relief(part, mesh, expected)
        checks += relief_checks
    if expected.relief is not None:
        deviation, number = expected.relief.of_mesh(mesh)
        checks.append(_face_relief(expected.relief, deviation, number))
    if full:
        checks += meshcheck.full_checks(mesh)
    return Report.of_mesh(path, mesh, checks, deviation, mesh.volume_mm3)


def _mesh_volume(mesh: Mesh, expected: ExpectedGeometry) -> Check:
    """Compare the volume with the closed form. Rounding the points to float32 can change it by area x rounding."""
    area = float(np.linalg.norm(mesh.doubled_normals, axis=1).sum()) / 2.0
    allowed = expected.volume_slack_mm3 + area * _FLOAT32 * float(np.abs(mesh.vertices).max())
    return volume_check(mesh.volume_mm3, expected.volume_mm3, allowed)


def _manifold(mesh: Mesh, genus: int) -> list[Check]:
    status, holes = meshcheck.solidity(mesh)
    checks = [Check(name="manifold", ok=status == "NoError", detail=f"manifold3d: {status}")]
    return [*checks, genus_check(holes, genus)] if status == "NoError" else checks


def _mesh_box(part: PrintPart, mesh: Mesh, expected: ExpectedGeometry) -> Check:
    """Check the box up to the rounding of float32. The highest vertex of a block must be exactly at its height."""
    low, high = mesh.bounds_mm
    reach = float(np.abs(mesh.vertices).max())
    check = _box(low, high, part, 2.0 * _FLOAT32 * max(*part.size_mm, reach) + expected.size_slack_mm)
    top, height = float(high[2]), float(np.float32(part.size_mm[2]))
    if check.ok and part.block is not None and top != height:
        return Check(
            name="box", ok=False, detail=f"the highest point is at {top!r} mm instead of exactly {height!r} mm"
        )
    return check


def _solid_box(part: PrintPart, measured: MeasuredSolid, expected: ExpectedGeometry) -> Check:
    """Check the box. The height of a block has the same tolerance as the solid's distance from the formula."""
    certificate = expected.certificate
    upper_mm = SOLID_BOX_MM if certificate is None else max(SOLID_BOX_MM, certificate.vertical_mm)
    return _box(measured.low_mm, measured.high_mm, part, SOLID_BOX_MM, upper_mm)


def _box(low: Floats, high: Floats, part: PrintPart, allowed: float, upper_mm: float | None = None) -> Check:
    """Compare the box with the expected one. The highest point can have another tolerance, ``upper_mm``."""
    corner = np.array(part.low_mm)
    off = np.concatenate([low - corner, high - corner - np.array(part.size_mm)])
    size = mm(*(high - low).tolist())
    limits = np.array([allowed] * 5 + [upper_mm or allowed])
    if bool(np.all(np.abs(off) <= limits)):
        where = "the origin" if not corner.any() else "x {:.4g}, y {:.4g}, z {:.4g} mm".format(*corner)
        return Check(name="box", ok=True, detail=f"{size}, lower corner at {where}")
    i = int(np.argmax(np.abs(off) - limits))
    name = f"{'lower' if i < 3 else 'upper'} {'xyz'[i % 3]}"
    return Check(name="box", ok=False, detail=f"{size}; {name} is off by {off[i]:+.4g} mm (allowed {limits[i]:.1e} mm)")


def _mesh_relief(part: PrintPart, mesh: Mesh, expected: ExpectedGeometry) -> tuple[list[Check], float | None]:
    """Check the distance from the formula and, with a sample grid, from the straight lines between the samples."""
    top = relief.upward(mesh, mesh.doubled_normals)
    points = relief.points_on(mesh, top)
    check, deviation = _relief(part, expected, points, rounding_mm=_FLOAT32 * max(part.size_mm))
    block = part.block
    if block is None or not isinstance(block.sampling, SampleGrid) or len(points) == 0:
        return [check], deviation
    above, slope = Facets(block)(points[:, 0], points[:, 1], points[:, 2] - block.datum_mm)
    off = np.abs(above) / np.sqrt(1.0 + slope**2)
    i, allowed = int(np.argmax(off)), GRID_MM * max(1.0, block.scale)
    ok = bool(off[i] <= allowed)
    where = "" if ok else " at x {:.4g}, y {:.4g}, z {:.4g} mm".format(*points[i])
    samples = f"{block.sampling.nx} x {block.sampling.ny} samples"
    detail = f"at most {off[i]:.2g} mm from the straight lines between the {samples}{where}"
    return [check, Check(name="samples", ok=ok, detail=detail)], deviation


def _relief(
    part: PrintPart, expected: ExpectedGeometry, points: Floats, rounding_mm: float
) -> tuple[Check, float | None]:
    """Compare the distance of points from the formula with the certificate."""
    assert part.block is not None and expected.certificate is not None and expected.datum_mm is not None
    if len(points) == 0:
        return Check(name="relief", ok=False, detail="no face points upwards"), None
    distance = relief.distance(points, part.block.surface, expected.datum_mm)
    allowed = expected.certificate.distance_mm
    ok = distance.largest_mm <= allowed + rounding_mm
    x, y, z = distance.at_mm
    where = "" if ok else f" (largest at x {x:.4g}, y {y:.4g}, z {z:.4g} mm)"
    measured = f"at most {distance.largest_mm:.3g} mm from the formula at {len(points)} points{where}"
    bound = f"{expected.certificate.evidence} limit"
    return Check(name="relief", ok=ok, detail=f"{measured}; {bound} {at_most(allowed, 3)} mm"), distance.largest_mm


def _face_relief(expected: MeasuredRelief, deviation_mm: float, points: int) -> Check:
    """Check the distance of a file from the formula on the textured faces of a part that is not a block."""
    if not points:
        return Check(name="relief", ok=False, detail="no point is on a textured face")
    detail = f"{deviation_mm:.3g} mm from the formula at most, {points} points; allowed {expected.allowed_mm:.3g} mm"
    return Check(name="relief", ok=deviation_mm <= expected.allowed_mm, detail=detail)


def _verify_solid(part: PrintPart, path: Path, full: bool) -> Report:
    from tacbench_cad.checks import solidcheck
    from tacbench_cad.formats.step import read_step

    shape = read_step(path)
    _, expected = part.solid
    measured = solidcheck.measure(shape)
    allowed_mm3 = SOLID_VOLUME_FRACTION * expected.volume_mm3 + expected.volume_slack_mm3
    checks = [
        Check(name="file", ok=True, detail="read back by the kernel"),
        *solidcheck.solid_checks(shape),
        *_topology(shape, part),
        volume_check(measured.volume_mm3, expected.volume_mm3, allowed_mm3),
        _solid_box(part, measured, expected),
    ]
    deviation = None
    if expected.certificate is not None:
        points = solidcheck.points_on(solidcheck.curved(shape)[0])
        check, deviation = _relief(part, expected, points, rounding_mm=1e-6)
        checks += [check, *_nothing_cut(part, shape, measured, expected.certificate.distance_mm + 1e-6)]
    if expected.relief is not None:
        deviation, number = expected.relief.of_points(solidcheck.points_on(solidcheck.spline_faces(shape), FACE_POINTS))
        checks.append(_face_relief(expected.relief, deviation, number))
    if full:
        allowed_mm3 = DEFAULT_VOLUME_FRACTION * expected.volume_mm3 + expected.volume_slack_mm3
        checks.append(volume_check(kernel.volume_mm3(shape), expected.volume_mm3, allowed_mm3, "kernel volume"))
    return Report(
        path=path,
        checks=tuple(checks),
        deviation_mm=deviation,
        volume_mm3=measured.volume_mm3,
        size_mm=measured.size_mm,
    )


def _topology(shape: TopoDS_Shape, part: PrintPart) -> list[Check]:
    """Compare the through holes and the shells of a solid with those of a part."""
    from tacbench_cad.checks import solidcheck

    shells, expected = solidcheck.count(shape, "SHELL"), solidcheck.count(part.solid[0], "SHELL")
    hollow = Check(name="shells", ok=False, detail=f"{shells} instead of {expected}: the solid has a hollow")
    return [genus_check(kernel.genus(shape), part.genus), *([hollow] if shells != expected else [])]


def _nothing_cut(part: PrintPart, shape: TopoDS_Shape, measured: MeasuredSolid, allowed_mm: float) -> list[Check]:
    """Check that all faces of a solid are on the faces of the block, so that nothing is cut out of it."""
    from tacbench_cad.checks.body_shape import solid_shape

    block = part.block
    assert block is not None, "only blocks have a certificate"
    body, match = solid_shape(shape, measured, with_relief=False), Match(Candidate(block, True), PLACEMENTS[0], 0.0)
    checks = outline_checks(body, match, block, block.outline, allowed_mm)
    checks += completeness_checks(body, match, block, block.outline, allowed_mm)
    on_relief = match.candidate.contains(body.other_points, body, match.placement, allowed_mm)
    if not on_relief.all():
        x, y, z = body.other_points[int(np.argmin(on_relief))]
        where = f"for example at x {x:.4g}, y {y:.4g}, z {z:.4g} mm"
        checks.append(Check(name="faces", ok=False, detail=f"a face is not on the block ({where})"))
    return [check for check in checks if not check.ok]
