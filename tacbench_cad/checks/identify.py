"""``tacbench check-part``: what a file is, whoever made it, and everything that is wrong with it.

The origin may lie anywhere and the block may be turned by quarter turns. A file of ours says what it is (see
:mod:`tacbench_cad.checks.claim`) and is held to it; another is compared with all that is known, and the nearest named.
In a plate or an assembly, a 3MF of several objects or a STEP of several parts, each body is examined so by itself.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks import meshcheck
from tacbench_cad.checks.candidates import SIDE_MM, Expectation, stretch_of
from tacbench_cad.checks.claim import claimed_name
from tacbench_cad.checks.look import Look, look_at_mesh, look_at_solid
from tacbench_cad.checks.match import GRID_MM, Candidate, Match, Residual, nearest
from tacbench_cad.checks.report import Check, Report
from tacbench_cad.formats import format_of
from tacbench_cad.formats.step import kernel_errors, with_kernel
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.label import LABEL_DEPTH_MM
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.text import decimal, mm

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

    from tacbench_cad.checks.solidcheck import Measured

#: A residual above this fraction of the relief's own spread means that no texture was found, not that one is wrong.
UNLIKE = 0.5
#: Below this fraction the relief is surely that candidate's, in the placement found.
SURE = 0.1
#: Of a plate or an assembly at most so many bodies are examined.
MAX_BODIES = 300
#: The solid's own error, and the kernel's, on top of a tolerance, in mm.
ROUNDING_MM = 1e-5


def examine(
    path: Path,
    texture: Texture | str | None = None,
    preset: str | None = None,
    scale: float | None = None,
    *,
    full: bool | None = None,
) -> Report:
    """Look at a file and name what it is and every fault.

    Args:
        path: An STL, 3MF or STEP file.
        texture: What its relief shall be: a texture, its number or name, or a TOML file; None for the nearest.
        preset: ``paper`` or ``released`` (which means the published sample-grid surface); None for the nearest.
        scale: Its scale; None to take it from the file's name for itself, or from its sides.
        full: Add pymeshlab's checks; None adds them where it is installed.

    Returns:
        The report. What cannot be read as its format is a failed check, too.

    Raises:
        InputError: There is no such file, its format is not known, or texture or preset are not; or the file crashes
            the CAD kernel.
        MissingToolError: A package that the format, or ``full``, needs is not there.
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
    """One of the bodies in a file.

    Args:
        name: What the file calls it; empty where it has no name for it.
        checks: What has nothing to do with textures.
        look: Its shape; None where it is not one body after all.
    """

    name: str
    checks: list[Check]
    look: Look | None

    @property
    def is_block(self) -> bool:
        """Whether it has a relief over its top."""
        return self.look is not None and self.look.is_block

    def examine(self, expected: Expectation) -> tuple[list[Check], float | None]:
        """All its checks, and how far it is from its formula."""
        if self.look is None:
            return self.checks, None
        found, deviation = _identity(self.look, expected)
        return [*self.checks, *found], deviation


def _examine_bodies(
    bodies: Sequence[_Body], expected: Expectation, claim: str | None
) -> tuple[list[Check], float | None]:
    """The checks of a file's bodies, where there are several each under its name, and the largest deviation.

    Of several bodies the blocks are held to what is asked; the others may be fixtures.
    """
    if len(bodies) == 1:
        return bodies[0].examine(replace(expected, claim=claim))
    blocks = sum(body.is_block for body in bodies)
    detail = f"{len(bodies)}, {blocks} of them with a relief; each is examined by itself"
    checks = [Check(name="bodies", ok=expected.is_open or blocks > 0, detail=detail)]
    deviations = []
    for number, body in enumerate(bodies, start=1):
        # A file of ours calls each body by its part's name; what follows after a blank says where it is.
        own = body.name.partition(" ")[0] if claim is not None else None
        found, deviation = body.examine(replace(expected, claim=own) if body.is_block else Expectation(claim=own))
        checks += [replace(check, name=f"{body.name or f'body {number}'}: {check.name}") for check in found]
        deviations += [] if deviation is None else [deviation]
    return checks, max(deviations, default=None)


def _examine_mesh(path: Path, expected: Expectation, full: bool | None) -> Report:
    metadata: dict[str, str] | None = None
    if format_of(path).name == "3mf":
        from tacbench_cad.formats.threemf import read_parts

        parts, metadata = read_parts(path)
        mesh = Mesh.joined([one for _, one in parts])
    else:
        mesh = meshcheck.read_mesh(path)
        parts = [("", mesh)]
    if len(parts) > MAX_BODIES:
        raise CheckFailedError(f"{path}: has {len(parts)} bodies; at most {MAX_BODIES} are examined")
    edges = meshcheck.edges(mesh)
    checks = _mesh_soundness(mesh, edges)
    bodies = [_mesh_body(name, one) for name, one in parts]
    found, deviation = _examine_bodies(bodies, expected, claimed_name(path, metadata))
    closed = mesh if edges.sound else None if edges.open or edges.crowded else meshcheck.oriented(mesh)
    volume = None if closed is None else closed.volume_mm3
    return Report.of_mesh(path, mesh, [*checks, *found, *_full(mesh, full)], deviation, volume)


def _mesh_body(name: str, mesh: Mesh) -> _Body:
    pieces = meshcheck.bodies(mesh)
    if pieces == 1:
        return _Body(name=name, checks=[], look=look_at_mesh(mesh))
    detail = f"{pieces} separate bodies without names; save each body as a file and check these files"
    return _Body(name=name, checks=[Check(name="bodies", ok=False, detail=detail)], look=None)


def _mesh_soundness(mesh: Mesh, edges: meshcheck.Edges) -> list[Check]:
    """Everything about a mesh that has nothing to do with textures."""
    checks = [
        Check(name="file", ok=True, detail="readable; all coordinates finite"),
        *meshcheck.edge_checks(edges),
        meshcheck.degenerate_check(mesh),
    ]
    if not edges.sound:
        return checks
    volume = mesh.volume_mm3
    low, high = mesh.bounds_mm
    if abs(volume) <= 1e-9 * float(np.prod(np.maximum(high - low, 1e-6))):
        return [*checks, Check(name="volume", ok=False, detail="the surface encloses no volume")]
    inside_out = "" if volume > 0.0 else "inside out: all triangles face inwards; "
    checks.append(Check(name="volume", ok=volume > 0.0, detail=f"{inside_out}{volume:.6g} mm^3"))
    status, genus = meshcheck.solidity(mesh)
    ok = status == "NoError"
    # The genus is one less for every further body.
    holes = f", {genus + meshcheck.bodies(mesh) - 1} through holes" if ok else ": not manifold"
    checks.append(Check(name="manifold", ok=ok, detail=f"manifold3d: {status}{holes}"))
    return checks


def _full(mesh: Mesh, full: bool | None) -> list[Check]:
    if full is False:
        return []
    if full is None and importlib.util.find_spec("pymeshlab") is None:
        detail = 'not checked, because pymeshlab is not installed: pip install "tacbench-cad[cad]"'
        return [Check(name="self-intersection", ok=True, detail=detail)]
    return meshcheck.foreign_full_checks(mesh)


def _examine_solid(path: Path, expected: Expectation) -> Report:
    """What :func:`examine` does with a STEP file, in a child process."""
    with kernel_errors(path):
        return _report_of_solid(path, expected)


def _report_of_solid(path: Path, expected: Expectation) -> Report:
    from tacbench_cad.checks import solidcheck
    from tacbench_cad.formats.step import read_parts, read_step

    shape = read_step(path)
    parts = read_parts(path) if solidcheck.count(shape, "SOLID") > 1 else [("", shape)]
    if len(parts) > MAX_BODIES:
        raise CheckFailedError(f"{path}: has {len(parts)} bodies; at most {MAX_BODIES} are examined")
    measured = [solidcheck.measure(one) for _, one in parts]
    bodies = [_solid_body(name, one, own) for (name, one), own in zip(parts, measured, strict=True)]
    found, deviation = _examine_bodies(bodies, expected, claimed_name(path))
    low, high = np.min([own.low_mm for own in measured], axis=0), np.max([own.high_mm for own in measured], axis=0)
    whole = solidcheck.Measured(volume_mm3=sum(own.volume_mm3 for own in measured), low_mm=low, high_mm=high)
    return Report(
        path=path,
        checks=(Check(name="file", ok=True, detail="read by the kernel"), *found),
        deviation_mm=deviation,
        volume_mm3=whole.volume_mm3,
        size_mm=whole.size_mm,
    )


def _solid_body(name: str, shape: TopoDS_Shape, measured: Measured) -> _Body:
    from tacbench_cad.checks import solidcheck

    single = solidcheck.count(shape, "SOLID") == 1
    volume = measured.volume_mm3
    holes = f", {solidcheck.genus(shape)} through holes" if single else ""
    detail = f"{volume:.6g} mm^3{holes}" + ("" if volume > 0.0 else ": inside out or empty")
    checks = [*solidcheck.solid_checks(shape), Check(name="volume", ok=volume > 0.0, detail=detail)]
    return _Body(
        name=name,
        checks=checks,
        look=look_at_solid(shape, measured.low_mm, measured.high_mm) if single else None,
    )


def _identity(look: Look, expected: Expectation) -> tuple[list[Check], float | None]:
    """What the shape is, and how far it is from that."""
    match = nearest(look, expected) if len(look.points) else None
    if match is None or (not look.is_block and expected.is_open and expected.claimed is None):
        return [_no_texture(look, match, asked=not expected.is_open or expected.claimed is not None)], None
    if expected.is_open and expected.claimed is None and _is_unknown(look, match):
        return [Check(name="texture", ok=False, detail=f"not one of the six textures; {_near(match)}")], None
    allowed = _allowed(match.candidate)
    residual = match.candidate.measure(look, match.placement, near_mm=allowed)
    checks = [
        _placement(look, match),
        _size(look, match),
        *_corner(look, match, expected),
        *_sides(look, match),
        _relief(look, match, residual, expected, allowed),
    ]
    if look.engraved:
        checks.append(Check(name="label", ok=True, detail=f"pockets of {LABEL_DEPTH_MM:g} mm in the underside"))
    return checks, residual.largest_mm


def _no_texture(look: Look, match: Match | None, asked: bool) -> Check:
    """A fixture, which is no fault unless a texture was asked for; or a relief at a size that no block can have."""
    size = mm(*look.size_mm)
    if look.is_block and match is None:
        detail = f"a relief over {size}, but no texture has a block of this size; check that its unit is the millimetre"
        return Check(name="texture", ok=False, detail=detail)
    near = "" if match is None else f"; {_near(match)}"
    return Check(name="texture", ok=not asked, detail=f"none: a part of {size} without a relief over its top{near}")


def _near(match: Match) -> str:
    return f"the nearest is {_name(match.candidate)}, {match.rms_mm:.3g} mm rms from it"


def _name(candidate: Candidate) -> str:
    block = candidate.block
    grid = " on its sample grid" if candidate.on_grid else ""
    return f"{block.texture.name}, preset {block.preset}{grid}, scale {decimal(block.scale)}"


def _allowed(candidate: Candidate) -> float:
    """The residual that a candidate may have, in mm."""
    sampling = candidate.block.sampling
    if isinstance(sampling, Tolerance):
        return sampling.mm + ROUNDING_MM
    if candidate.as_solid:
        return Tolerance().mm + ROUNDING_MM
    return GRID_MM * max(1.0, candidate.block.scale)


def _placement(look: Look, match: Match) -> Check:
    corner = "at the origin" if max(map(abs, look.origin_mm)) <= SIDE_MM else _at(look.origin_mm)
    sure = _likeness(look, match) <= SURE
    quarters = match.placement.quarters if sure else 0
    turned = f", turned by {90 * quarters} degrees about z" if quarters else ""
    faults = []
    if look.upside_down:
        faults.append("upside down: the relief faces down")
    if match.placement.mirrored and sure:
        faults.append("mirrored: the relief is the mirror image")
    detail = "; ".join([*faults, f"lower corner {corner}{turned}"])
    return Check(name="placement", ok=not faults, detail=detail)


def _likeness(look: Look, match: Match) -> float:
    """The residual as a fraction of the relief's own spread: 0 is the candidate itself, 1 is no likeness at all."""
    return match.rms_mm / max(float(look.points[:, 2].std()), 1e-12)


def _is_unknown(look: Look, match: Match) -> bool:
    """Whether a relief is none of the known ones. One that is only alike, at another size, is none of them either."""
    likeness = _likeness(look, match)
    return likeness > UNLIKE or (likeness > SURE and not _size(look, match).ok)


def _at(place: tuple[float, float, float]) -> str:
    return "at x {:.4g}, y {:.4g}, z {:.4g} mm".format(*place)


def _size(look: Look, match: Match) -> Check:
    """Sides and height against the candidate's."""
    block = match.candidate.block
    found = (*match.placement.sides(look.size_mm), look.size_mm[2])
    sides = (*block.size_mm, block.height_mm)
    off = [one - want for one, want in zip(found, sides, strict=True)]
    text = mm(*found)
    # The highest point of a solid is as near to the height as the solid is to the formula.
    height_mm = max(SIDE_MM, _allowed(match.candidate)) if match.candidate.as_solid and look.is_solid else SIDE_MM
    if max(map(abs, off[:2])) <= SIDE_MM and abs(off[2]) <= height_mm:
        return Check(name="size", ok=True, detail=text)
    fractions = stretch_of(block, look, match.placement)
    if max(fractions) - min(fractions) <= 1e-4:
        how = f"{(sum(fractions) / 3.0):.5g} times as large as expected"
    else:
        how = ", ".join(f"{name} by {one:+.4g} mm" for name, one in zip("xyz", off, strict=True) if abs(one) > SIDE_MM)
    return Check(name="size", ok=False, detail=f"wrong size: {text} instead of {mm(*sides)} ({how})")


def _corner(look: Look, match: Match, expected: Expectation) -> list[Check]:
    """The key: a cut corner at (X, 0) of the block."""
    cut = look.cut_corners
    claimed = expected.claimed
    asked = None if claimed is None else claimed.key_mm
    if not cut:
        return (
            [] if asked is None else [Check(name="key", ok=False, detail=f"missing; a key of {asked:g} mm is expected")]
        )
    if len(cut) > 1:
        return [Check(name="key", ok=False, detail=f"{len(cut)} corners of the underside are cut off; a key is one")]
    i, j, leg = cut[0]
    corner = np.array([[i * look.size_mm[0], j * look.size_mm[1]]])
    x, y = (float(one[0]) for one in match.placement.to_block(corner, look.size_mm))
    width = match.placement.sides(look.size_mm)[0]
    right = abs(x - width) < SIDE_MM and abs(y) < SIDE_MM
    where = "at the corner (X, 0)" if right else f"at the corner ({x:.4g}, {y:.4g}) mm; it belongs to (X, 0)"
    as_asked = claimed is None or (asked is not None and abs(leg - asked) <= SIDE_MM)
    want = "" if as_asked else f"; {'no key' if asked is None else f'{asked:g} mm'} is expected"
    return [Check(name="key", ok=right and as_asked, detail=f"{leg:.4g} mm {where}{want}")]


def _sides(look: Look, match: Match) -> list[Check]:
    """Walls stand on the sides of the box or on the cut of the key."""
    off = look.off_sides_mm
    for i, j, leg in look.cut_corners:
        from_x = np.abs(off[:, 0] - i * look.size_mm[0])
        from_y = np.abs(off[:, 1] - j * look.size_mm[1])
        off = off[np.abs(from_x + from_y - leg) > SIDE_MM]
    if len(off) == 0:
        return []
    x, y = off[0].tolist()
    detail = f"{len(off)} corners of walls stand away from the sides (one at x {x:.4g}, y {y:.4g} mm of the box)"
    return [Check(name="sides", ok=False, detail=detail)]


def _relief(look: Look, match: Match, residual: Residual, expected: Expectation, allowed: float) -> Check:
    candidate = match.candidate
    name, numbers = _name(candidate), f"{residual.largest_mm:.3g} mm at most, {residual.rms_mm:.3g} mm rms"
    unlike = _likeness(look, match) > UNLIKE
    if residual.above_mm and not unlike:
        height = f"stands {abs(residual.above_mm):.3g} mm too {'high' if residual.above_mm > 0.0 else 'low'}"
        numbers = f"{numbers}, once shifted back: it {height} above the underside"
    if max(abs(one - 1.0) for one in candidate.stretch) > 1e-4:
        numbers = f"{numbers}, once brought back to the wanted size"
    if residual.largest_mm <= allowed and not residual.above_mm:
        return Check(name="relief", ok=True, detail=f"{name}: {numbers} (allowed {allowed:.3g})")
    detail = f"wrong relief: {name} is {numbers} away (allowed {allowed:.3g}), worst {_at(residual.at_mm)} of the box"
    if unlike:
        detail = f"{detail}; the relief is not similar to this texture"
    other = _other(look, match, expected)
    return Check(name="relief", ok=False, detail=detail + other)


def _other(look: Look, match: Match, expected: Expectation) -> str:
    """What the surface is nearest to when nothing is asked of it, if that is something else."""
    if expected.is_open and expected.claimed is None:
        return ""
    found = nearest(look, Expectation())
    if found is None or found.rms_mm >= match.rms_mm or _name(found.candidate) == _name(match.candidate):
        return ""
    return f"; the nearest known is {_name(found.candidate)} ({found.rms_mm:.3g} mm rms)"
