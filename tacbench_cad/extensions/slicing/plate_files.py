"""The files of plates: a checked 3MF, a layout, and a print record that the user fills in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.slicing.plates import Plate, write_layout
from tacbench_cad.formats import threemf
from tacbench_cad.geometry import PrintPart, as_part
from tacbench_cad.lab.runs import form
from tacbench_cad.spec import read_texture
from tacbench_cad.util.errors import CheckFailedError, InputError, MissingToolError
from tacbench_cad.util.files import locked, replacing, write_text
from tacbench_cad.util.untrusted import read_bytes

#: The largest distance of a vertex from its place in the file, caused by single precision, in mm.
_PLACE_MM = 1e-4


@dataclass(frozen=True, kw_only=True)
class PlateFiles:
    """The paths of a plate's files.

    Args:
        model: The 3MF file.
        layout: The CSV file that ``tacbench acquire`` reads.
        record: The print record, which the user fills in.
        picture: The picture of the layout.
    """

    model: Path
    layout: Path
    record: Path
    picture: Path

    @classmethod
    def of(cls, plate: Plate, filament: str, folder: Path) -> PlateFiles:
        """Return the paths of a plate's files: ``bambu-p1p_petg_plate02.3mf`` and so on."""
        printer, _, number = plate.name.rpartition("_")
        stem = f"{printer}_{filament}_{number}"
        return cls(
            model=folder / f"{stem}.3mf",
            layout=folder / f"{stem}.csv",
            record=folder / f"{stem}_print.toml",
            picture=folder / f"{stem}.png",
        )

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files that :func:`write_plates` writes."""
        return (self.model, self.layout, self.record)


def write_plates(
    plates: Sequence[Plate],
    filament: str,
    out: Path,
    texture_files: Sequence[Path] = (),
    printed: Mapping[str, tuple[str, Path]] | None = None,
) -> list[PlateFiles]:
    """Write the 3MF, the layout and the print record of each plate.

    An existing print record is not overwritten, because somebody may have filled it in.

    Args:
        plates: The plates.
        filament: The name of the filament.
        out: The folder. It is created if it does not exist.
        texture_files: Users' texture files. They are copied into the folder, because the layouts refer to them.
        printed: For blocks that differ from what their prints are expected to equal, by the names of their textures:
            the texture of the print, and the texture file of the block. These files are copied to the folder ``files``.

    Raises:
        MissingToolError: lib3mf is not installed.
        InputError: The folder cannot be written, another process writes to it, it contains further plates for this
            printer and filament, or two texture files have the same name.
        CheckFailedError: A 3MF file differs from the plate when it is read back.
    """
    if (reason := threemf.why_missing()) is not None:
        raise MissingToolError(f"3MF: {reason}")
    names = {read_texture(path).name: path.name for path in texture_files}
    if len(set(names.values())) < len(texture_files):
        raise InputError(
            "texture", [path.name for path in texture_files], "two files have the same name; rename one of them"
        )
    all_files = [PlateFiles.of(plate, filament, out) for plate in plates]
    with locked(out):
        _require_no_others(all_files, f"{plates[0].printer.name}_{filament}_plate", out)
        copies = {out / path.name: path for path in texture_files}
        others = {name: (texture, f"files/{path.name}") for name, (texture, path) in (printed or {}).items()}
        copies |= {out / others[name][1]: path for name, (_, path) in (printed or {}).items()}
        for copy, path in copies.items():
            copy.parent.mkdir(exist_ok=True)
            write_text(copy, read_bytes(path, "texture", "toml").decode())
        for plate, files in zip(plates, all_files, strict=True):
            _write_model(plate, files.model.stem, files.model)
            write_layout(plate, filament, files.layout, names, others)
            if not files.record.exists():
                with replacing(files.record) as temporary:
                    temporary.write_text(_record(plate, filament, files), encoding="utf-8")
    return all_files


def _require_no_others(all_files: Sequence[PlateFiles], stem: str, out: Path) -> None:
    """Check that a folder contains no further plates for this printer and filament.

    Such plates come from an earlier request with more copies. A user who slices all files would print too many blocks.
    The program does not remove them, because they may already have been printed and pressed.
    """
    known = {path for files in all_files for path in (files.model, files.layout)}
    others = sorted(
        path.name for end in (".3mf", ".csv") for path in out.glob(f"{stem}[0-9]*{end}") if path not in known
    )
    if others:
        raise InputError(
            "output folder",
            str(out),
            f"contains plates of an earlier request with more copies: {', '.join(others)}; move them away or choose "
            "another folder",
        )


def _write_model(plate: Plate, name: str, path: Path) -> None:
    placed: list[tuple[PrintPart, tuple[float, float]]] = [
        (as_part(placed.block), (placed.x_mm, placed.y_mm)) for placed in plate.blocks
    ]
    with replacing(path) as temporary:
        threemf.write_plate(placed, name, temporary)
        _require_as_meant(placed, temporary)


def _require_as_meant(placed: Sequence[tuple[PrintPart, tuple[float, float]]], path: Path) -> None:
    """Read the file back, and check the places of all vertices and the number of triangles."""
    mesh, _ = threemf.read_3mf(path)
    expected = [np.add(part.mesh[0].vertices, (*place, 0.0)) for part, place in placed]
    triangles = sum(len(part.mesh[0].faces) for part, _ in placed)
    vertices = np.concatenate(expected)
    if mesh.vertices.shape != vertices.shape or len(mesh.faces) != triangles:
        raise CheckFailedError(f"{path.name}: the triangles in the file differ from those of the plate")
    if float(np.abs(mesh.vertices - vertices).max()) > _PLACE_MM:
        raise CheckFailedError(f"{path.name}: a block in the file is not in its place on the plate")


def _record(plate: Plate, filament: str, files: PlateFiles) -> str:
    """Return an empty print record for all blocks of a plate."""
    about = (
        f"Record of plate {plate.number} on {plate.printer.name}: {len(plate.blocks)} blocks, "
        f"with places and labels in {files.layout.name}.\n"
        "Copy it into each block's run folder as print.toml, and add the scores and photos of that block."
    )
    return form(about, printer=plate.printer.name, filament=filament)
