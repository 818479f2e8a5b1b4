"""From a part to a file: write it, read it back, check it, and only then give it its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.checks.report import Report
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats import FORMATS, format_of
from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import Part
from tacbench_cad.making.manifest import Row
from tacbench_cad.making.plan import file_name
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.files import replacing, sha256


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A file that was written, examined and found wrong, so that it was not put in place.

    Args:
        file: The name it would have had.
        faults: What is wrong with it.
    """

    file: str
    faults: tuple[str, ...]


Outcome = Row | Failure


class _RejectedError(CheckFailedError):
    """A file that was examined and found wrong."""

    def __init__(self, path: Path, faults: tuple[str, ...]) -> None:
        self.faults = faults
        super().__init__(f"{path}: {'; '.join(faults)}")


def export(part: Any, path: Path | str, *, full: bool = False) -> Report:
    """Write a part to a file, read the file back, check it, and only then give it its name.

    Args:
        part: A Block, a Holder, a Jig, a Coupon, an Assembly, a :class:`~tacbench_cad.Part`, or anything else with a
            method ``part()`` that returns one.
        path: The file. Its ending says the format: ``.stl``, ``.3mf`` or ``.step``.
        full: Add the slow checks: pymeshlab's of a mesh, the kernel's own volume and box of a solid.

    Returns:
        The report of the checks.

    Raises:
        InputError: The ending is not known, the folder cannot be written, or there is no solid of this part.
        MissingToolError: A package that the format needs is not there.
        CheckFailedError: The file was written wrong; it is not put in place.
    """
    path, part = Path(path), as_part(part)
    with replacing(path) as temporary:
        format_of(path).write(part, temporary)
        report = verify(part, temporary, full=full)
        if not report.ok:
            faults = tuple(f"{check.name}: {check.detail}" for check in report.faults)
            raise _RejectedError(path, faults or ("nothing could be checked",))
    return replace(report, path=path)


def make_files(part: Part, formats: Sequence[str], out: Path, full: bool) -> list[Outcome]:
    """Export a part in some formats, each under its own name.

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
    outcomes: list[Outcome] = []
    for name in formats:
        path = out / file_name(part, name)
        try:
            outcomes.append(_row(part, name, export(part, path, full=full)))
        except CheckFailedError as error:
            outcomes.append(Failure(file=path.name, faults=getattr(error, "faults", (str(error),))))
    return outcomes


def make_in_child(
    orders: tuple[tuple[Any, tuple[str, ...]], ...], out: Path, full: bool
) -> list[tuple[list[Outcome], Mesh | None]]:
    """The same in a child process, for some parts.

    Args:
        orders: What a part is built from, and the formats.
        out: The output folder.
        full: Add the slow checks.

    Returns:
        For each part what was made, and the mesh for the pictures where the CAD kernel made it.
    """
    results = []
    for thing, formats in orders:
        part = as_part(thing)
        outcomes = make_files(part, formats, out, full)
        results.append((outcomes, part.mesh[0] if part.mesh_needs_cad and not part.placed else None))
    return results


def _row(part: Part, format_name: str, report: Report) -> Row:
    """The manifest row of a file that passed."""
    shape = FORMATS[format_name].shape
    _, expected = part.solid if shape == "solid" else part.mesh
    found = report.as_dict()
    row: dict[str, Any] = {
        "file": report.path.name,
        "part": part.name_in(shape),
        "kind": part.kind,
        "format": format_name,
        "version": __version__,
        "sha256": sha256(report.path),
        "bytes": report.path.stat().st_size,
        "triangles": report.triangles,
        "size_mm": found["size_mm"],
        "volume_mm3": report.volume_mm3,
        "closed_form_volume_mm3": expected.volume_mm3,
        "certificate": None if expected.certificate is None else asdict(expected.certificate),
        "deviation_mm": report.deviation_mm,
        "checks": found["checks"],
    }
    if part.min_wall_mm is not None:
        row["least_wall_mm"] = part.min_wall_mm
    if part.block is not None and isinstance(part.block.sampling, SampleGrid):
        # How far the lines between samples leave the formula; said of the solid too, which follows the formula.
        proved = part.mesh[1].certificate
        assert proved is not None, "a block's mesh has a certificate"
        row["grid_to_formula"] = {
            **asdict(proved),
            "formula_above_height_mm": part.block.datum_mm - part.block.formula_datum_mm,
            "aliases": part.block.grid_aliases,
        }
    row["spec"] = dict(part.spec)
    # The rows of assemblies begin with the report: schema 1 of the manifest had them so.
    return {**found, **row} if part.placed else row
