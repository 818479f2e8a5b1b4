"""The set put together: holder, blocks in its slots and jig, each where it is used, as one STEP and one 3MF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.checks.report import Check, Report
from tacbench_cad.formats import FORMATS, step, threemf
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import ExpectedGeometry, Part
from tacbench_cad.making.sources import part_of
from tacbench_cad.making.writing import Failure, Made
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.files import replacing, sha256
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

    from housing.holder import Holder
    from housing.jig import Jig
    from housing.placement import Placement

#: Formats that an assembly is written in.
ASSEMBLY_FORMATS = ("3mf", "step")
#: A solid must lie this near to its place, in mm.
PLACE_MM = 1e-3
#: A volume may differ by this share, beside what the part itself allows: a mesh's float32 coordinates, moved.
VOLUME_SHARE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """A holder with what belongs in it and on it. It can be pickled.

    Args:
        holder: The holder.
        blocks: A block for each slot, from the first on.
        jig: The jig, or None for none.
        step_tolerance_mm: How close the blocks' solids stay to the formula; None for the default.
        formats: Some of :data:`ASSEMBLY_FORMATS`.
    """

    holder: Holder
    blocks: tuple[Block, ...]
    jig: Jig | None = None
    step_tolerance_mm: float | None = None
    formats: tuple[str, ...] = ASSEMBLY_FORMATS

    @property
    def name(self) -> str:
        """Stem of the file names: ``assembly_paper_x1_slots6``."""
        return f"assembly_{self.holder.stem}"

    @property
    def title(self) -> str:
        """One line for people."""
        inside = ", ".join(block.texture.name for block in self.blocks)
        return f"Holder with {inside}" + (" and jig" if self.jig is not None else "")

    def placed(self) -> list[tuple[Part, Floats]]:
        """The parts, and the matrix (4, 4) from each one's own frame to the holder's, in mm."""
        parts: list[tuple[Part, Floats]] = [(self.holder.part(), np.eye(4))]
        for block, place in zip(self.blocks, self.holder.block_placements(), strict=False):
            parts.append((part_of(block, self.step_tolerance_mm), _matrix(place)))
        if self.jig is not None:
            parts.append((self.jig.part(), self.jig.from_print))
        return parts


def _matrix(place: Placement) -> Floats:
    """From the block frame to the holder frame."""
    matrix = np.eye(4)
    matrix[:2, :2] = (place.to_holder(np.eye(2)) - place.to_holder(np.zeros((1, 2)))).T
    matrix[:3, 3] = place.origin_mm
    return matrix


def make_assembly(one: Assembly, out: Path) -> list[Made]:
    """Write an assembly, examine each file as it lies on disk, and only then give it its name.

    Args:
        one: The assembly.
        out: The output folder; it must exist.

    Returns:
        A manifest row for each file put in place, a failure for each that was not.

    Raises:
        InputError: The folder cannot be written or is full, or a block has no solid.
        MissingToolError: The CAD kernel or lib3mf is not there.
    """
    placed = one.placed()
    return [_make(one, placed, name, out) for name in one.formats]


class _RejectedError(Exception):
    """Leaves the body of :func:`tacbench_cad.util.files.replacing`, so that the file is not renamed."""


def _make(one: Assembly, placed: list[tuple[Part, Floats]], format_name: str, out: Path) -> Made:
    path = out / f"{one.name}{FORMATS[format_name].suffix}"
    faults: tuple[str, ...] = ()
    try:
        with replacing(path) as temporary:
            if format_name == "step":
                step.write_assembly(placed, one.name, one.title, temporary)
                report = _check_step(placed, temporary)
            else:
                threemf.write_plate(_moved(placed), one.name, temporary, kind="assembly")
                report = _check_3mf(placed, temporary)
            if not report.ok:
                faults = tuple(f"{check.name}: {check.detail}" for check in report.faults)
                raise _RejectedError
            hashed, size = sha256(temporary), temporary.stat().st_size
    except _RejectedError:
        return Failure(file=path.name, faults=faults)
    except CheckFailedError as error:
        return Failure(file=path.name, faults=(str(error),))
    return {
        **report.as_dict(),
        "file": path.name,
        "part": one.name,
        "kind": "assembly",
        "format": format_name,
        "version": __version__,
        "sha256": hashed,
        "bytes": size,
        "closed_form_volume_mm3": sum(one.volume_mm3 for one in _expected(placed, format_name)),
        "certificate": None,
        "spec": {
            "frame": "holder",
            "parts": [{"name": part.name, "kind": part.kind, "to_holder": m.tolist()} for part, m in placed],
        },
    }


def _expected(placed: Sequence[tuple[Part, Floats]], format_name: str) -> list[ExpectedGeometry]:
    return [(part.solid if format_name == "step" else part.mesh)[1] for part, _ in placed]


def _moved(placed: Sequence[tuple[Part, Floats]]) -> list[tuple[Part, tuple[float, float]]]:
    """The parts with their meshes where they are used; each use is a part of its own."""
    moved = []
    for number, (part, matrix) in enumerate(placed):
        mesh, expected = part.mesh
        name = f"{part.name} in slot {number}" if part.kind == "block" else part.name
        moved.append((replace(part, name=name, make_mesh=partial(_given, mesh.moved(matrix), expected)), (0.0, 0.0)))
    return moved


def _given(mesh: Mesh, expected: ExpectedGeometry) -> tuple[Mesh, ExpectedGeometry]:
    return mesh, expected


def _box_mm(placed: Sequence[tuple[Part, Floats]]) -> tuple[Floats, Floats]:
    """Lower and upper corner of the whole, from the parts' sizes."""
    corners = np.array([m[:3, 3] + m[:3, :3] @ (np.array(part.size_mm) * end) for part, m in placed for end in (0, 1)])
    return corners.min(axis=0), corners.max(axis=0)


def _check_3mf(placed: Sequence[tuple[Part, Floats]], path: Path) -> Report:
    """Closed, oriented, volume and box of all objects together."""
    from tacbench_cad.checks import meshcheck

    mesh, _ = threemf.read_3mf(path)
    expected = _expected(placed, "3mf")
    wanted = sum(one.volume_mm3 for one in expected)
    allowed = VOLUME_SHARE * wanted + sum(one.volume_slack_mm3 for one in expected)
    low, high = mesh.bounds_mm
    checks = [
        Check(name="file", ok=True, detail="read back; all coordinates finite"),
        *meshcheck.edge_checks(meshcheck.edges(mesh)),
        _volume(mesh.volume_mm3, wanted, allowed, "volume"),
        _box(np.concatenate([low, high]), np.concatenate(_box_mm(placed)), "box"),
    ]
    return Report.of_mesh(path, mesh, checks, None, mesh.volume_mm3)


def _check_step(placed: Sequence[tuple[Part, Floats]], path: Path) -> Report:
    """Each solid, brought back to its own frame: valid, of its volume, and its lower corner at the origin."""
    from OCP.gp import gp_Trsf
    from OCP.TopLoc import TopLoc_Location

    from tacbench_cad.checks import solidcheck
    from tacbench_cad.checks.survey import survey

    solids = _solids(step.read_step(path))
    right = len(solids) == len(placed)
    checks = [Check(name="parts", ok=right, detail=f"{len(solids)} solids, {len(placed)} are wanted")]
    total = 0.0
    for solid, (part, matrix), expected in zip(solids, placed, _expected(placed, "step"), strict=False):
        place = gp_Trsf()
        place.SetValues(*matrix[:3].ravel().tolist())
        back = solid.Moved(TopLoc_Location(place.Inverted()))
        found = survey(back).measured
        total += found.volume_mm3
        for check in solidcheck.solid_checks(back):
            checks.append(replace(check, name=f"{part.name}: {check.name}"))
        allowed = 1e-4 * expected.volume_mm3 + expected.volume_slack_mm3
        checks.append(_volume(found.volume_mm3, expected.volume_mm3, allowed, f"{part.name}: volume"))
        corners = np.concatenate([found.low_mm, found.high_mm])
        checks.append(_box(corners, np.array([0.0, 0.0, 0.0, *part.size_mm]), f"{part.name}: place"))
    low, high = _box_mm(placed)
    size = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    return Report(path=path, checks=tuple(checks), volume_mm3=total, size_mm=size)


def _solids(shape: TopoDS_Shape) -> list[Any]:
    """The solids in the order of the file, with their places."""
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer

    found, explorer = [], TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_SOLID)
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def _volume(found: float, wanted: float, allowed: float, name: str) -> Check:
    off = found - wanted
    detail = f"{found:.6f} mm^3, {off:+.2e} from the closed form (allowed {allowed:.1e})"
    return Check(name=name, ok=abs(off) <= allowed, detail=detail)


def _box(found: Floats, wanted: Floats, name: str) -> Check:
    off = float(np.abs(found - wanted).max())
    return Check(name=name, ok=off <= PLACE_MM, detail=f"{off:.1e} mm from its place (allowed {PLACE_MM:g})")
