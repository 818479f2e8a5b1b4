"""Run one surface fit of a CAD library for benchmarks/solid.py. It prints a line when ready, fitted and measured.

python benchmarks/solid_peers.py cadquery '{"tol": 0.01, "smoothing": null, "min": 1, "max": 3}'
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.Geom import Geom_Surface
from OCP.TopoDS import TopoDS_Face

from tacbench_cad.spec.block import Block
from tacbench_cad.util.types import Floats

#: Number of points along each parameter at which a surface is compared with the formula.
DENSE = 1000


def say(**facts: object) -> None:
    """Print one line for the parent process."""
    print(json.dumps(facts), flush=True)


def formula_errors(surface: Geom_Surface, block: Block, dense: int) -> tuple[float, float]:
    """Return the largest and the root-mean-square ``|z - formula|`` in mm, at the x and y of the surface.

    Args:
        surface: Any surface.
        block: The block; the zero of the formula is at its datum.
        dense: The number of points along each parameter of the surface, ends included.
    """
    u0, u1, v0, v1 = surface.Bounds()
    points: Floats = np.empty((dense, dense, 3))
    for i, u in enumerate(np.linspace(u0, u1, dense).tolist()):
        for j, v in enumerate(np.linspace(v0, v1, dense).tolist()):
            at = surface.Value(u, v)
            points[i, j] = at.X(), at.Y(), at.Z()
    x, y, z = points.reshape(-1, 3).T
    off = np.abs(z - block.solid_datum_mm - block.surface(x, y))
    return float(off.max()), float(np.sqrt(np.mean(off**2)))


def _cadquery(points: Floats) -> Callable[..., TopoDS_Face]:
    import cadquery

    rows = [[cadquery.Vector(*point) for point in row] for row in points.tolist()]

    def fit(tol: float, smoothing: list[float] | None, low: int, high: int) -> TopoDS_Face:
        weights = tuple(smoothing) if smoothing else None
        return cadquery.Face.makeSplineApprox(rows, tol=tol, smoothing=weights, minDeg=low, maxDeg=high).wrapped

    return fit


def _build123d(points: Floats) -> Callable[..., TopoDS_Face]:
    import build123d

    rows = [[build123d.Vector(*point) for point in row] for row in points.tolist()]

    def fit(tol: float, smoothing: list[float] | None, low: int, high: int) -> TopoDS_Face:
        weights = tuple(smoothing) if smoothing else None
        make = build123d.Face.make_surface_from_array_of_points
        return make(rows, tol=tol, smoothing=weights, min_deg=low, max_deg=high).wrapped

    return fit


def main() -> None:
    """Fit a surface once and measure it."""
    library, setting = sys.argv[1], json.loads(sys.argv[2])
    block = Block.of(4, sampling="grid")
    x, y = block.samples_mm
    z = block.solid_datum_mm + block.surface.grid(x, y)
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1)
    fit = {"cadquery": _cadquery, "build123d": _build123d}[library](points)
    say(state="ready", samples=list(z.shape))
    start = time.perf_counter()
    try:
        face = fit(setting["tol"], setting["smoothing"], setting["min"], setting["max"])
    except Exception as error:  # any exception of the kernel is the result of this setting
        say(state="failed", seconds=time.perf_counter() - start, error=f"{type(error).__name__}: {error}")
        return
    say(state="fitted", seconds=time.perf_counter() - start)
    surface: Any = BRep_Tool.Surface_s(face)
    worst, rms = formula_errors(surface, block, DENSE)
    say(state="measured", worst_mm=worst, rms_mm=rms, poles=[surface.NbUPoles(), surface.NbVPoles()])


if __name__ == "__main__":
    main()
