"""One part, some formats: write each file, examine it as it lies on disk, and only then give it its name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad import __version__
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats import FORMATS, format_of
from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.part import ExpectedGeometry, Part
from tacbench_cad.making.manifest import Row
from tacbench_cad.making.sources import part_of
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.files import replacing, sha256

if TYPE_CHECKING:
    from housing.coupon import Coupon
    from housing.holder import Holder
    from housing.jig import Jig
    from tacbench_cad.checks.report import Report


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A file that was written, examined and found wrong, so that it was not put in place.

    Args:
        file: The name it would have had.
        faults: What is wrong with it.
    """

    file: str
    faults: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"file": self.file, "faults": list(self.faults)}


Made = Row | Failure


class _RejectedError(Exception):
    """Leaves the expected of :func:`tacbench_cad.util.files.replacing`, so that the file is not renamed."""


def file_name(part: Part, format_name: str) -> str:
    """Name of a part's file in one format."""
    return f"{part.name}{FORMATS[format_name].suffix}"


def export(part: Any, path: Path | str, *, full: bool = False) -> Report:
    """Write a part to a file, read the file back, check it, and only then give it its name.

    Args:
        part: A Block, a Holder, a Jig, a Coupon, a :class:`~tacbench_cad.Part`, or anything with a method ``part()``.
        path: The file. Its ending says the format: ``.stl``, ``.3mf`` or ``.step``.
        full: Add the slow checks: pymeshlab's of a mesh, the kernel's own volume and box of a solid.

    Returns:
        The report of the checks.

    Raises:
        InputError: The ending is not known, the folder cannot be written, or there is no solid of this part.
        MissingToolError: A package that the format needs is not there.
        CheckFailedError: The file was written wrong; it is not put in place.
    """
    path, thing = Path(path), as_part(part)
    with replacing(path) as temporary:
        format_of(path).write(thing, temporary)
        report = verify(thing, temporary, full=full)
        if not report.ok:
            faults = "; ".join(f"{check.name}: {check.detail}" for check in report.faults)
            raise CheckFailedError(f"{path}: {faults or 'nothing could be checked'}")
    return replace(report, path=path)


def make_files(part: Part, formats: tuple[str, ...], out: Path, full: bool) -> list[Made]:
    """Write a part in some formats.

    Args:
        part: The part.
        formats: Names of :data:`tacbench_cad.formats.FORMATS`.
        out: The output folder; it must exist.
        full: Add the slow checks.

    Returns:
        A manifest row for each file put in place, a failure for each that was not.

    Raises:
        InputError: The folder cannot be written or is full.
    """
    return [_make_file(part, name, out, full) for name in formats]


def make_in_child(
    orders: tuple[tuple[Block | Holder | Jig | Coupon, float | None, tuple[str, ...]], ...], out: Path, full: bool
) -> list[tuple[list[Made], Mesh | None]]:
    """The same in a child process, for some parts, from what each is built of.

    Args:
        orders: What a part is built from, how close its solid stays to the formula, and the formats.
        out: The output folder.
        full: Add the slow checks.

    Returns:
        For each part what was made, and a fixture's mesh for the pictures.
    """
    results = []
    for maker, step_tolerance_mm, formats in orders:
        part = part_of(maker, step_tolerance_mm)
        made = make_files(part, formats, out, full)
        results.append((made, part.mesh[0] if part.mesh_needs_cad else None))
    return results


def _make_file(part: Part, format_name: str, out: Path, full: bool) -> Made:
    path = out / file_name(part, format_name)
    try:
        with replacing(path) as temporary:
            FORMATS[format_name].write(part, temporary)
            report = verify(part, temporary, full=full)
            if not report.ok:
                raise _RejectedError
            hashed, size = sha256(temporary), temporary.stat().st_size
    except _RejectedError:
        faults = tuple(f"{check.name}: {check.detail}" for check in report.faults) or ("nothing could be checked",)
        return Failure(file=path.name, faults=faults)
    except CheckFailedError as error:
        return Failure(file=path.name, faults=(str(error),))
    return _row(part, format_name, report, hashed, size)


def _row(part: Part, format_name: str, report: Report, hashed: str, size: int) -> dict[str, Any]:
    """The manifest row of a file that passed."""
    expected = part.solid[1] if FORMATS[format_name].shape == "solid" else part.mesh[1]
    found = report.as_dict()
    row: dict[str, Any] = {
        "file": file_name(part, format_name),
        "part": part.name,
        "kind": part.kind,
        "format": format_name,
        "version": __version__,
        "sha256": hashed,
        "bytes": size,
        "triangles": report.triangles,
        "size_mm": found["size_mm"],
        "volume_mm3": report.volume_mm3,
        "closed_form_volume_mm3": expected.volume_mm3,
        "certificate": _certificate(expected),
        "deviation_mm": report.deviation_mm,
        "checks": found["checks"],
    }
    if part.least_wall_mm is not None:
        row["least_wall_mm"] = part.least_wall_mm
    if part.block is not None and isinstance(part.block.sampling, SampleGrid):
        row["grid_to_formula"] = _grid_to_formula(part, part.block)
    row["spec"] = dict(part.spec)
    return row


def _certificate(expected: ExpectedGeometry) -> dict[str, float] | None:
    proved = expected.certificate
    return None if proved is None else _bounds(proved)


def _bounds(proved: Certificate) -> dict[str, float]:
    return {"distance_mm": proved.distance_mm, "vertical_mm": proved.vertical_mm}


def _grid_to_formula(part: Part, block: Block) -> dict[str, Any]:
    """How far the straight lines between samples leave the formula, also for the solid, which follows the formula."""
    proved = part.mesh[1].certificate
    assert proved is not None, "a block's mesh has a certificate"
    return {
        **_bounds(proved),
        "formula_above_height_mm": block.datum_mm - block.formula_datum_mm,
        "aliases": block.grid_aliases,
    }
