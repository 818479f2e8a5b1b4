"""A texture on a part from a STEP file: read the solid, texture it, and write it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.checks.report import Report
from tacbench_cad.formats import format_of, step
from tacbench_cad.geometry.textured.height import around
from tacbench_cad.geometry.textured.textured_faces import TexturedFaces, face_at, faces_by
from tacbench_cad.geometry.texturing import texturing
from tacbench_cad.making.writing import export
from tacbench_cad.spec.sampling import TOLERANCE_MM
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import as_input, require_between
from tacbench_cad.util.text import at_most


@dataclass(frozen=True, kw_only=True)
class TexturedFile:
    """A part from a STEP file with a texture on its faces, written to a file that was read back and checked.

    Args:
        faces: The textured faces.
        report: The checks of the file.
    """

    faces: TexturedFaces
    report: Report

    @property
    def _evidence(self) -> str:
        return "proved" if all(result.is_proved for result in self.faces.results) else "measured"

    @property
    def _error_mm(self) -> float:
        return max(result.error_mm for result in self.faces.results)

    def as_dict(self) -> dict[str, Any]:
        """Return the values for the last face as plain JSON values.

        ``error_mm`` and ``evidence`` are those of the solid; ``deviation_mm`` was measured on the file.
        """
        result = self.faces.results[-1]
        region = max((region for region, _, _ in result.regions), key=lambda region: region.size_mm)
        radius = region.frame.radius_mm
        return {
            "region": "plane" if radius is None else "cylinder",
            "radius_mm": radius,
            "size_mm": list(region.size_mm),
            "depth_mm": self.faces.depth_mm,
            "texture": self.faces.texturing.texture.name,
            "triangles": self.report.triangles,
            "bodies": 1,
            "volume_mm3": self.report.volume_mm3,
            "expected_volume_mm3": self.faces.volume_mm3,
            "error_mm": self._error_mm,
            "evidence": self._evidence,
            "deviation_mm": self.report.deviation_mm,
            "mm_per_unit": list(result.mm_per_unit),
            "periods": result.periods,
        }

    def lines(self) -> list[str]:
        """Return a short description for people."""
        document = self.as_dict()
        names = []
        for result in self.faces.results:
            closing = around(result.texturing, result.mm_per_unit, result.periods)
            for region, _, _ in result.regions:
                radius = region.frame.radius_mm
                kind = "plane" if radius is None else f"cylinder of radius {radius:.5g} mm"
                names.append(
                    f"{document['texture']} on a {kind}, {region.size_mm[0]:.4g} x {region.size_mm[1]:.4g} mm, "
                    f"{document['depth_mm']:.4g} mm high{closing}"
                )
        volumes = f"volume {document['volume_mm3']:.7g} mm^3, expected {document['expected_volume_mm3']:.7g} mm^3"
        return [
            *names,
            f"solid at most {at_most(self._error_mm, 2)} mm from the formula ({self._evidence}); "
            f"file at most {at_most(document['deviation_mm'], 2)} mm at the checked points",
            f"closed, 1 body; {volumes}",
        ]


def texture_step_file(
    file: Path | str,
    out: Path | str,
    texture: Texture | str | int | Path,
    *,
    face: str | None = None,
    at: Sequence[float] | None = None,
    tolerance_mm: float | None = None,
    **settings: Any,
) -> TexturedFile:
    """Put a texture on faces of the part in a STEP file, and write the part to a file, which is read back and checked.

    The file keeps the coordinates of the part. This is :func:`tacbench_cad.textured_part` for a part in a file.

    Args:
        file: A STEP file with one solid.
        out: The new STEP, STL or 3MF file.
        texture: A texture, the number or name of one of the six, or a TOML file.
        face: A selector of CadQuery for the faces, such as ``">Z"``.
        at: A point on the face, in mm, if there is no selector.
        tolerance_mm: The largest distance of the file from the formula; None for 0.001 in a STEP file, and 0.01 in a
            mesh.
        **settings: The other settings of :class:`~tacbench_cad.geometry.texturing.Texturing`.

    Raises:
        InputError: The file cannot be read, the part is not one solid, no face is chosen, a face is neither planar nor
            cylindrical, or a setting is not allowed for it.
        CheckFailedError: The new file failed its checks. It is then not in the folder.
    """
    file, out = Path(file), Path(out)
    form = format_of(out)
    with as_input("file"):
        step.require_readable(file)
        shape = step.read_step(file)
    if tolerance_mm is not None and form.shape == "solid":
        settings["tolerance_mm"] = tolerance_mm
    faces = [item.wrapped for item in faces_by(shape, face)] if face else [face_at(shape, at or ())]
    mesh_tolerance_mm = TOLERANCE_MM if tolerance_mm is None else tolerance_mm
    require_between("tolerance_mm", mesh_tolerance_mm, 1e-5 if form.shape == "solid" else 1e-4, 1.0, " mm")
    made = TexturedFaces(shape, faces, texturing(texture, **settings), mesh_tolerance_mm, keeps_place=True)
    name = made.texturing.texture.name
    spec = {**settings, "texture": name, "depth_mm": made.depth_mm}
    part = made.part(part_name(out), "part", f"{out.stem} with {name}", spec)
    return TexturedFile(faces=made, report=export(part, out))


def part_name(path: Path) -> str:
    """Return a name for a part that is allowed in its files."""
    return re.sub(r"[^A-Za-z0-9 ._+-]", "_", path.stem).lstrip(" ._+-") or "part"
