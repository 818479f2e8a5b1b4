"""Identification of a part file from any program (``tacbench check-part``), and a report of all its faults.

The origin can be anywhere, and the block can be turned by quarter turns. A file of this package states its
blocks (see :mod:`tacbench_cad.checks.claim`) and must agree with them. Any other file is compared with all known
blocks, and the report names the nearest block. If a file contains several bodies (a plate or an assembly), each body is
checked separately.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks import meshcheck
from tacbench_cad.checks.body_shape import BodyShape, mesh_shape, solid_shape
from tacbench_cad.checks.candidates import SIDE_MM, Expectation, stretch_of
from tacbench_cad.checks.claim import claimed_blocks
from tacbench_cad.checks.complete import completeness_checks
from tacbench_cad.checks.match import GRID_MM, Candidate, Match, Residual, nearest
from tacbench_cad.checks.outline import outline_checks, outline_of
from tacbench_cad.checks.report import Check, Report
from tacbench_cad.formats import format_of
from tacbench_cad.formats.step import kernel_errors, with_kernel
from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.outlines import Outline
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.text import decimal, mm

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

    from tacbench_cad.checks.solidcheck import MeasuredSolid

#: The largest residual of a relief that is similar to the candidate, as a fraction of the standard deviation of the
#: relief's heights.
MAX_SIMILAR_FRACTION = 0.5
#: The same fraction, up to which the candidate and its placement are certain.
MAX_CERTAIN_FRACTION = 0.1
#: The smallest fraction of the footprint on which a relief is certain to be that of a texture.
MIN_COVERED = 0.1
#: The factor from the largest measured distance of a relief to the distance with which its volume is compared.
WITHIN_FACTOR = 2.0
#: The largest number of bodies in a file.
MAX_BODIES = 300
#: Other units of files in mm, and the longest side in mm up to which a file is probably in one of them.
UNITS_MM = {"inches": 25.4, "centimetres": 10.0, "metres": 1000.0}
MAX_OTHER_UNIT_MM = 5.0
#: The longest side of the blocks of both presets at scale 1, in mm.
PRESET_SIDE_MM = 30.0
#: The allowance for rounding by the solid and by the kernel, in addition to the tolerance, in mm.
ROUNDING_MM = 1e-5


def examine(
    path: Path,
    texture: Texture | str | Path | None = None,
    preset: str | None = None,
    scale: float | None = None,
    *,
    full: bool | None = None,
) -> Report:
    """Identify the part in a file, and report every fault.

    Args:
        path: An STL, 3MF or STEP file.
        texture: The expected texture: a texture, its number or name, or a TOML file; None for the nearest texture.
        preset: ``paper`` or ``released`` (the published surface on its sample grid); None for the nearest preset.
        scale: The expected scale; None for the scale that the file states, or to compute it from the sides.
        full: Whether the checks by pymeshlab are done. None does them if pymeshlab is installed.

    Returns:
        The report. A file that cannot be read has one failed check.

    Raises:
        InputError: The file does not exist, its format, the texture or the preset is unknown, or the file crashes the
            CAD kernel.
        MissingToolError: A package that the format or ``full`` needs is not installed.
    """
    expected = Expectation(texture=texture, preset=preset, scale=scale)
    try:
        if format_of(path).shape == "solid":
            report: Report = with_kernel(path, _examine_solid, path, expected)
            return report
        return _examine_mesh(path, expected, full)
    except CheckFailedError as error:
        return Report(path=path, checks=(Check(name="file", ok=False, detail=str(error).removeprefix(f"{path}: ")),))


@dataclass(frozen=True, kw_only=True)
class _Body:
    """A body in a file.

    Args:
        name: The name of the body in the file; empty if it has no name.
        checks: The checks that do not concern the texture.
        shape: The shape; None if this is not exactly one body.
    """

    name: str
    checks: list[Check]
    shape: BodyShape | None

    @property
    def is_block(self) -> bool:
        """Whether the body has a relief on its top."""
        return self.shape is not None and self.shape.is_block

    def examine(self, expected: Expectation) -> tuple[list[Check], float | None]:
        """Return all checks of the body, and its largest distance from the formula."""
        if self.shape is None:
            return self.checks, None
        checks, deviation = _identity(self.shape, expected)
        return [*self.checks, *checks], deviation


def _examine_bodies(
    bodies: Sequence[_Body], expected: Expectation, claims: dict[str, Block]
) -> tuple[list[Check], float | None]:
    """Return the checks of all bodies, and the largest deviation.

    If there are several bodies, the names of the checks begin with the name of the body. The expected texture, preset
    and scale then apply only to the blocks, because the other bodies can be fixtures.
    """
    if len(bodies) == 1:
        only = next(iter(claims.values())) if len(claims) == 1 else claims.get(bodies[0].name)
        return bodies[0].examine(replace(expected, claim=only))
    blocks = sum(body.is_block for body in bodies)
    detail = f"{len(bodies)}, {blocks} of them with a relief; each is checked separately"
    checks = [Check(name="bodies", ok=expected.is_open or blocks > 0, detail=detail)]
    deviations = []
    for number, body in enumerate(bodies, start=1):
        claim = claims.get(body.name)
        body_expected = replace(expected, claim=claim) if body.is_block else Expectation(claim=claim)
        body_checks, deviation = body.examine(body_expected)
        checks += [replace(check, name=f"{body.name or f'body {number}'}: {check.name}") for check in body_checks]
        deviations += [] if deviation is None else [deviation]
    return checks, max(deviations, default=None)


def _examine_mesh(path: Path, expected: Expectation, full: bool | None) -> Report:
    metadata: dict[str, str] | None = None
    if format_of(path).name == "3mf":
        from tacbench_cad.formats.threemf import read_untrusted

        parts, metadata = read_untrusted(path)
        mesh = Mesh.joined([body for _, body in parts])
    else:
        mesh = meshcheck.read_mesh(path)
        parts = [("", mesh)]
    _require_few_bodies(path, len(parts))
    edges = meshcheck.edges(mesh)
    checks = _mesh_checks(mesh, edges)
    bodies = [_mesh_body(name, body) for name, body in parts]
    body_checks, deviation = _examine_bodies(bodies, expected, claimed_blocks(path, metadata))
    closed = mesh if edges.ok else None if edges.open or edges.crowded else meshcheck.oriented(mesh)
    volume = None if closed is None else closed.volume_mm3
    return Report.of_mesh(
        path, mesh, [*checks, *body_checks, *_full([body for _, body in parts], full)], deviation, volume
    )


def _require_few_bodies(path: Path, count: int) -> None:
    if count > MAX_BODIES:
        raise CheckFailedError(
            f"{path}: has {count} bodies, but at most {MAX_BODIES} can be checked; split it into several files"
        )


def _mesh_body(name: str, mesh: Mesh) -> _Body:
    pieces, closed = meshcheck.bodies(mesh), meshcheck.edges(mesh).ok
    if pieces == 1:
        return _Body(name=name, checks=[], shape=mesh_shape(mesh, closed))
    detail = f"{pieces} separate bodies without names; save each body as a file and check these files"
    if closed and (hollows := meshcheck.hollows(mesh)):
        detail = f"{pieces} closed surfaces instead of 1, {hollows} of them inside out: the body has a hollow"
    return _Body(name=name, checks=[Check(name="bodies", ok=False, detail=detail)], shape=None)


def _mesh_checks(mesh: Mesh, edges: meshcheck.Edges) -> list[Check]:
    """Return the checks of a mesh that do not concern the texture."""
    checks = [
        Check(name="file", ok=True, detail="readable; all coordinates finite"),
        *meshcheck.edge_checks(edges),
        meshcheck.degenerate_check(mesh),
    ]
    if not edges.ok:
        return checks
    volume = mesh.volume_mm3
    low, high = mesh.bounds_mm
    if abs(volume) <= 1e-9 * float(np.prod(np.maximum(high - low, 1e-6))):
        return [*checks, Check(name="volume", ok=False, detail="the surface encloses no volume")]
    inside_out = "" if volume > 0.0 else "inside out: all triangles face inwards; "
    checks.append(Check(name="volume", ok=volume > 0.0, detail=f"{inside_out}{volume:.6g} mm^3"))
    status, genus = meshcheck.solidity(mesh)
    ok = status == "NoError"
    # Each further body reduces the genus by one.
    holes = f", {genus + meshcheck.bodies(mesh) - 1} through holes" if ok else ": not manifold"
    checks.append(Check(name="manifold", ok=ok, detail=f"manifold3d: {status}{holes}"))
    return checks


def _full(meshes: Sequence[Mesh], full: bool | None) -> list[Check]:
    if full is False:
        return []
    if full is None and importlib.util.find_spec("pymeshlab") is None:
        detail = 'not checked, because pymeshlab is not installed: pip install "tacbench-cad[cad]"'
        return [Check(name="self-intersection", ok=True, detail=detail)]
    return meshcheck.untrusted_full_checks(meshes)


def _examine_solid(path: Path, expected: Expectation) -> Report:
    """Check a STEP file; called by :func:`examine` in a child process."""
    with kernel_errors(path):
        return _report_of_solid(path, expected)


def _report_of_solid(path: Path, expected: Expectation) -> Report:
    from tacbench_cad.checks import solidcheck
    from tacbench_cad.formats.step import read_parts, read_step

    shape = read_step(path)
    parts = read_parts(path) if solidcheck.count(shape, "SOLID") > 1 else [("", shape)]
    _require_few_bodies(path, len(parts))
    measured = [solidcheck.measure(solid) for _, solid in parts]
    bodies = [_solid_body(name, solid, values) for (name, solid), values in zip(parts, measured, strict=True)]
    checks, deviation = _examine_bodies(bodies, expected, claimed_blocks(path))
    low = np.min([values.low_mm for values in measured], axis=0)
    high = np.max([values.high_mm for values in measured], axis=0)
    whole = solidcheck.MeasuredSolid(volume_mm3=sum(values.volume_mm3 for values in measured), low_mm=low, high_mm=high)
    return Report(
        path=path,
        checks=(Check(name="file", ok=True, detail="read by the kernel"), *checks),
        deviation_mm=deviation,
        volume_mm3=whole.volume_mm3,
        size_mm=whole.size_mm,
    )


def _solid_body(name: str, solid: TopoDS_Shape, measured: MeasuredSolid) -> _Body:
    from tacbench_cad.checks import solidcheck

    single = solidcheck.count(solid, "SOLID") == 1
    volume = measured.volume_mm3
    holes = f", {kernel.genus(solid)} through holes" if single else ""
    detail = f"{volume:.6g} mm^3{holes}" + ("" if volume > 0.0 else ": inside out or empty")
    checks = [*solidcheck.solid_checks(solid), Check(name="volume", ok=volume > 0.0, detail=detail)]
    return _Body(
        name=name,
        checks=checks,
        shape=solid_shape(solid, measured) if single else None,
    )


def _identity(shape: BodyShape, expected: Expectation) -> tuple[list[Check], float | None]:
    """Return the checks that compare a shape with the nearest block, and the largest distance from the formula."""
    match = nearest(shape, expected) if len(shape.points) else None
    if match is None or (not _has_texture(shape, match) and expected.is_open and expected.claimed is None):
        return [_no_texture(shape, match, required=not expected.is_open or expected.claimed is not None)], None
    if expected.is_open and expected.claimed is None and _is_unknown(shape, match):
        later = nearest(shape, replace(expected, later=True))
        unknown = f"not one of the known textures; {_near(match)}{_unit_hint(shape)}"
        if later is None or later.rms_mm >= match.rms_mm or _is_unknown(shape, later):
            return [Check(name="texture", ok=False, detail=unknown)], None
        match = later
    allowed = _allowed(match.candidate)
    residual = match.candidate.measure(shape, match.placement, near_mm=allowed)
    claimed = expected.claimed
    outline = outline_of(shape, match, claimed)
    checks = [
        _placement(shape, match),
        _size(shape, match, outline),
        *outline_checks(shape, match, claimed, outline, allowed),
        _relief(shape, match, residual, expected, allowed),
    ]
    if _relative_residual(shape, match) <= MAX_SIMILAR_FRACTION:
        within = min(allowed, WITHIN_FACTOR * residual.within_mm)
        checks += completeness_checks(shape, match, claimed, outline, within)
    return checks, residual.largest_mm


def _has_texture(shape: BodyShape, match: Match) -> bool:
    """Check whether the shape is a block, or the rest of a block of which a large piece is missing."""
    certain = shape.covered > MIN_COVERED and _relative_residual(shape, match) <= MAX_CERTAIN_FRACTION
    return shape.is_block or certain


def _no_texture(shape: BodyShape, match: Match | None, required: bool) -> Check:
    """Return the check of a part without a relief, or with a relief on a part whose size no block can have.

    A part without a relief is a fixture. This is a fault only if a texture is required.
    """
    size = mm(*shape.size_mm)
    if shape.is_block and match is None:
        detail = f"no texture has a block of {size}, but the part has a relief{_unit_hint(shape)}"
        return Check(name="texture", ok=False, detail=detail)
    near = "" if match is None else f"; {_near(match)}"
    return Check(name="texture", ok=not required, detail=f"none: a part of {size} without a relief on its top{near}")


def _unit_hint(shape: BodyShape) -> str:
    """Return a hint if the part is so small that its file is probably not in mm, or nothing."""
    longest = max(shape.size_mm)
    if longest > MAX_OTHER_UNIT_MM:
        return ""
    scales = {unit: longest * length_mm / PRESET_SIDE_MM for unit, length_mm in UNITS_MM.items()}
    likely = [
        unit for unit, scale in scales.items() if 0.2 < scale < 10.0 and abs(scale * 4.0 - round(scale * 4.0)) < 0.02
    ]
    units = " or ".join(f"{unit} (multiply it by {UNITS_MM[unit]:g})" for unit in likely or UNITS_MM)
    return f"; the longest side is {longest:.4g} mm, so the file is probably in {units}"


def _near(match: Match) -> str:
    return f"the nearest is {_name(match.candidate)}, at a distance of {match.rms_mm:.3g} mm rms"


def _name(candidate: Candidate) -> str:
    block = candidate.block
    grid = " on its sample grid" if candidate.on_grid else ""
    return f"{block.texture.name}, preset {block.preset}{grid}, scale {decimal(block.scale)}"


def _allowed(candidate: Candidate) -> float:
    """Return the largest allowed distance from a candidate, in mm."""
    sampling, own = candidate.block.sampling, candidate.block.surface.error
    if isinstance(sampling, Tolerance):
        return sampling.mm + own + ROUNDING_MM
    if candidate.as_solid:
        return Tolerance().mm + own + ROUNDING_MM
    return GRID_MM * max(1.0, candidate.block.scale)


def _placement(shape: BodyShape, match: Match) -> Check:
    corner = "at the origin" if max(map(abs, shape.origin_mm)) <= SIDE_MM else _at(shape.origin_mm)
    certain = _relative_residual(shape, match) <= MAX_CERTAIN_FRACTION
    quarters = match.placement.quarters if certain else 0
    turned = f", turned by {90 * quarters} degrees about z" if quarters else ""
    faults = []
    if shape.upside_down:
        faults.append("upside down: the relief faces down")
    if match.placement.mirrored and certain:
        faults.append("mirrored: the relief is the mirror image")
    detail = "; ".join([*faults, f"lower corner {corner}{turned}"])
    return Check(name="placement", ok=not faults, detail=detail)


def _relative_residual(shape: BodyShape, match: Match) -> float:
    """Return the rms residual as a fraction of the standard deviation of the relief's heights.

    It is 0 if the relief is that of the candidate, and about 1 if the two are not similar.
    """
    return match.rms_mm / max(float(shape.points[:, 2].std()), 1e-12)


def _is_unknown(shape: BodyShape, match: Match) -> bool:
    """Check whether the part is an unknown block: its relief is not similar, or it is similar but the size differs."""
    residual = _relative_residual(shape, match)
    return residual > MAX_SIMILAR_FRACTION or (residual > MAX_CERTAIN_FRACTION and not _size(shape, match).ok)


def _at(place: tuple[float, float, float]) -> str:
    return "at x {:.4g}, y {:.4g}, z {:.4g} mm".format(*place)


def _size(shape: BodyShape, match: Match, outline: Outline | None = None) -> Check:
    """Compare the sides and the height with those of the candidate, or of its outline."""
    block = match.candidate.block
    measured = (*match.placement.sides(shape.size_mm), shape.size_mm[2])
    sides = (*(block.size_mm if outline is None else outline.size_mm), block.height_mm)
    off = [value - expected for value, expected in zip(measured, sides, strict=True)]
    text = mm(*measured)
    # The height of a solid has the same tolerance as its distance from the formula.
    height_mm = max(SIDE_MM, _allowed(match.candidate)) if match.candidate.as_solid and shape.is_solid else SIDE_MM
    if max(map(abs, off[:2])) <= SIDE_MM and abs(off[2]) <= height_mm:
        return Check(name="size", ok=True, detail=text)
    factors = stretch_of(block, shape, match.placement)
    if max(factors) - min(factors) <= 1e-4:
        how = f"{(sum(factors) / 3.0):.5g} times as large as expected"
    else:
        differences = [
            f"{axis} by {value:+.4g} mm" for axis, value in zip("xyz", off, strict=True) if abs(value) > SIDE_MM
        ]
        how = "differs in " + ", ".join(differences)
    return Check(name="size", ok=False, detail=f"{text} instead of {mm(*sides)} ({how})")


def _relief(shape: BodyShape, match: Match, residual: Residual, expected: Expectation, allowed: float) -> Check:
    """Check the distance of the relief from the candidate."""
    candidate = match.candidate
    distance = f"at most {residual.largest_mm:.3g} mm, {residual.rms_mm:.3g} mm rms (allowed {allowed:.3g} mm)"
    similar = _relative_residual(shape, match) <= MAX_SIMILAR_FRACTION
    notes = []
    if residual.above_mm and similar:
        height = f"{abs(residual.above_mm):.3g} mm too {'high' if residual.above_mm > 0.0 else 'low'}"
        notes.append(f"; the relief is {height} above the underside, and was shifted back before the comparison")
    if max(abs(factor - 1.0) for factor in candidate.stretch) > 1e-4:
        notes.append("; the file was scaled to the expected size before the comparison")
    if residual.largest_mm <= allowed and not residual.above_mm:
        return Check(name="relief", ok=True, detail="".join([f"{_name(candidate)}: distance {distance}", *notes]))
    if not similar:
        notes.append("; the relief is not similar to this texture")
    detail = (
        f"the distance from {_name(candidate)} is {distance}; "
        f"it is largest {_at(residual.at_mm)} from the lower corner of the bounding box"
    )
    return Check(name="relief", ok=False, detail="".join([detail, *notes, _other(shape, match, expected)]))


def _other(shape: BodyShape, match: Match, expected: Expectation) -> str:
    """Name the nearest of all known blocks, if it is nearer than the expected block."""
    if expected.is_open and expected.claimed is None:
        return ""
    other = nearest(shape, Expectation())
    if other is None or other.rms_mm >= match.rms_mm or _name(other.candidate) == _name(match.candidate):
        return ""
    return f"; the nearest known block is {_name(other.candidate)} ({other.rms_mm:.3g} mm rms)"
