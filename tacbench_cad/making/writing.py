"""Writing of a part to a file that is read back and checked before it gets its final name."""

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
from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.making.manifest import Row
from tacbench_cad.making.planning import file_name
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.spec.storage import block_values
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.files import replacing, sha256


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A file that failed its checks and is therefore not in the folder.

    Args:
        file: The name of the file.
        faults: The failed checks.
    """

    file: str
    faults: tuple[str, ...]


Outcome = Row | Failure


class _RejectedError(CheckFailedError):
    """A file failed its checks."""

    def __init__(self, path: Path, faults: tuple[str, ...]) -> None:
        self.faults = faults
        super().__init__(f"{path}: {'; '.join(faults)}")


def export(part: Any, path: Path | str, *, full: bool = False) -> Report:
    """Write a part to a file, read the file back and check it. The file gets its name only if it passes all checks.

    Args:
        part: A Block, a Holder, a Jig, a Coupon, an Assembly, a :class:`~tacbench_cad.PrintPart`, or any object with a
            method ``part()`` that returns a Part.
        path: The file. Its ending determines the format: ``.stl``, ``.3mf`` or ``.step``.
        full: Whether slow checks are done as well: the checks of a mesh by pymeshlab, and the kernel's own volume and
            bounding box of a solid.

    Returns:
        The report of the checks.

    Raises:
        InputError: The ending is unknown, the folder cannot be written, or no solid of this part can be made.
        MissingToolError: A package that the format needs is not installed.
        CheckFailedError: The file failed its checks. It is not in the folder.
    """
    path, part = Path(path), as_part(part)
    with replacing(path) as temporary:
        format_of(path).write(part, temporary)
        report = verify(part, temporary, full=full)
        if not report.ok:
            faults = tuple(f"{check.name}: {check.detail}" for check in report.faults)
            raise _RejectedError(path, faults or ("the file could not be checked",))
    return replace(report, path=path)


def make_files(part: PrintPart, formats: Sequence[str], out: Path, full: bool) -> list[Outcome]:
    """Export a part in some formats.

    Args:
        part: The part.
        formats: Names of :data:`tacbench_cad.formats.FORMATS`.
        out: The output folder, which must exist.
        full: Whether slow checks are done as well.

    Returns:
        A manifest row for each file that passed its checks, and a failure for each other file.

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
    """Export some parts in a child process.

    Args:
        orders: For each part, the object that becomes the part, and the formats.
        out: The output folder.
        full: Whether slow checks are done as well.

    Returns:
        For each part the rows and failures, and the mesh for the pictures if the CAD kernel made the mesh.
    """
    results = []
    for thing, formats in orders:
        part = as_part(thing)
        outcomes = make_files(part, formats, out, full)
        results.append((outcomes, part.mesh[0] if part.mesh_needs_cad and not part.placed else None))
    return results


def _row(part: PrintPart, format_name: str, report: Report) -> Row:
    """Return the manifest row of a file that passed its checks."""
    shape = FORMATS[format_name].shape
    _, expected = part.solid if shape == "solid" else part.mesh
    checked = report.as_dict()
    row: dict[str, Any] = {
        "file": report.path.name,
        "part": part.name_in(shape),
        "kind": part.kind,
        "format": format_name,
        "version": __version__,
        "sha256": sha256(report.path),
        "bytes": report.path.stat().st_size,
        "triangles": report.triangles,
        "size_mm": checked["size_mm"],
        "volume_mm3": report.volume_mm3,
        "closed_form_volume_mm3": expected.volume_mm3,
        "certificate": None if expected.certificate is None else _certificate(expected.certificate),
        "deviation_mm": report.deviation_mm,
        "checks": checked["checks"],
    }
    if part.min_wall_mm is not None:
        row["least_wall_mm"] = part.min_wall_mm
    if part.block is not None and isinstance(part.block.sampling, SampleGrid):
        # The distance between the formula and the lines between samples. It is also stated for solids, which follow the
        # formula.
        proved = part.mesh[1].certificate
        assert proved is not None, "a block's mesh has a certificate"
        row["grid_to_formula"] = {
            **asdict(proved),
            "formula_above_height_mm": part.block.datum_mm - part.block.formula_datum_mm,
            "aliases": part.block.grid_aliases,
        }
    row["spec"] = dict(part.spec)
    if part.block is not None:
        row["block"] = block_values(part.block)
    # In schema 1 of the manifest, the rows of assemblies begin with the values of the report.
    return {**checked, **row} if part.placed else row


def _certificate(certificate: Certificate) -> dict[str, Any]:
    """Return the bounds. The distance of the outline is only stated if chords replace circles."""
    return {name: value for name, value in asdict(certificate).items() if name != "outline_mm" or value}
