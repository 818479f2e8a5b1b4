"""The report of a file: a list of named checks with their numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.util.text import report


@dataclass(frozen=True, kw_only=True)
class Check:
    """The result of a check.

    Args:
        name: The name of the check, one to three words.
        ok: Whether the check passed.
        detail: A description of the result, with numbers.
    """

    name: str
    ok: bool
    detail: str


def volume_check(measured_mm3: float, expected_mm3: float, allowed_mm3: float, name: str = "volume") -> Check:
    """Return the check that compares a volume with the closed form."""
    off = measured_mm3 - expected_mm3
    inside_out = "" if measured_mm3 > 0.0 else "inside out: "
    detail = f"{inside_out}{measured_mm3:.6f} mm^3, {off:+.2e} from the closed form (allowed {allowed_mm3:.1e})"
    return Check(name=name, ok=measured_mm3 > 0.0 and abs(off) <= allowed_mm3, detail=detail)


def genus_check(holes: int, expected: int) -> Check:
    """Return the check of the number of through holes."""
    detail = f"{holes} through holes" + ("" if holes == expected else f" instead of {expected}")
    return Check(name="genus", ok=holes == expected, detail=detail)


@dataclass(frozen=True, kw_only=True)
class Report:
    """The results of all checks of a file.

    Args:
        path: The file.
        checks: The checks in their order. Checks that would be meaningless after a failure are left out.
        deviation_mm: The largest measured distance of the top from the formula; None for a part without a formula.
        triangles: The number of triangles; None for a solid.
        volume_mm3: The enclosed volume; None if the file could not be read, or if the surface encloses no volume.
        size_mm: The bounding box x, y, z; None if the file could not be read.
    """

    path: Path
    checks: tuple[Check, ...]
    deviation_mm: float | None = None
    triangles: int | None = None
    volume_mm3: float | None = None
    size_mm: tuple[float, float, float] | None = None

    @classmethod
    def of_mesh(
        cls, path: Path, mesh: Mesh, checks: Iterable[Check], deviation_mm: float | None, volume_mm3: float | None
    ) -> Report:
        """Make the report of a file that contains a mesh."""
        low, high = mesh.bounds_mm
        x, y, z = (high - low).tolist()
        return cls(
            path=path,
            checks=tuple(checks),
            deviation_mm=deviation_mm,
            triangles=len(mesh.faces),
            volume_mm3=volume_mm3,
            size_mm=(x, y, z),
        )

    @property
    def ok(self) -> bool:
        """Whether there is at least one check and all checks passed."""
        return bool(self.checks) and all(check.ok for check in self.checks)

    @property
    def faults(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.ok)

    def __str__(self) -> str:
        """Return the name of the file, whether it passed, and a line for each check."""
        lines = [(check.name, ("" if check.ok else "FAULT: ") + check.detail) for check in self.checks]
        return report(f"{self.path.name}: {'passed' if self.ok else 'failed'}", lines)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, with the file's name instead of its path."""
        return {
            "file": self.path.name,
            "ok": self.ok,
            "triangles": self.triangles,
            "size_mm": None if self.size_mm is None else list(self.size_mm),
            "volume_mm3": self.volume_mm3,
            "deviation_mm": self.deviation_mm,
            "checks": [{"name": check.name, "ok": bool(check.ok), "detail": check.detail} for check in self.checks],
        }
