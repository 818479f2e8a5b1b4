"""MuJoCo: the block as one height field (for probes) and as 8 x 8 of them (for domes), in metres, z up.

MuJoCo collides a mesh as its convex hull, which has no relief, so height fields it is. It keeps at most 50 contacts a
pair of geoms: a dome that touches more lets go of the rest and sinks; with tiles each tile has 50 of its own.

A field's file is ``int32 rows, int32 columns`` and ``float32`` heights, row 0 at the lowest y; the loader scales the
heights to 0..1, so that the size along z has to be the samples' own range.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from tacbench_cad.formats.simulators.asset import HeightField, SimulatorAsset, TargetFiles
from tacbench_cad.util.types import Floats

#: Tiles along each side in the file for domes.
TILES = 8
#: The step that the contact settings are meant for, in s: a time constant must be two steps at least.
STEP_S = 0.0005
#: Stiff contacts that win over the probe's own settings (``priority``).
CONTACT = 'solref="0.002 1" solimp="0.99 0.999 0.0001" friction="0.5 0.0001 0.000001" condim="3" priority="1"'
#: A field without range would be refused; no relief is as small as this, in m.
MIN_RANGE_M = 1e-9


def write_mjcf(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.xml`` with one field and ``NAME-tiles.xml`` with tiles.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    heights, name = asset.heights, asset.name
    whole = {f"{name}.hf": heights}
    tiles = {f"{name}-tiles/{place}.hf": tile for place, tile in _tiles(heights)}
    (folder / f"{name}-tiles").mkdir()
    for model, fields in ((name, whole), (f"{name}-tiles", tiles)):
        for file, field in fields.items():
            _write_field(field.z_mm, folder / file)
        _write_model(asset, fields, folder / f"{model}.xml")
    files = (f"{name}.xml", f"{name}-tiles.xml", *whole, *tiles)
    return TargetFiles(files=files, note=_note(asset))


def _tiles(heights: HeightField) -> Iterator[tuple[str, HeightField]]:
    """The field cut into tiles that share their border samples, with row and column; fewer for too few cells."""
    x, y, z = heights.x_mm, heights.y_mm, heights.z_mm
    for row, (k, m) in enumerate(pairwise(_cuts(len(y) - 1))):
        for column, (i, j) in enumerate(pairwise(_cuts(len(x) - 1))):
            tile = replace(heights, x_mm=x[i : j + 1], y_mm=y[k : m + 1], z_mm=z[k : m + 1, i : j + 1])
            yield f"{row}-{column}", tile


def _cuts(cells: int) -> list[int]:
    """Lines at which a side of some cells is cut."""
    tiles = min(TILES, cells)
    return [round(cells * i / tiles) for i in range(tiles + 1)]


def _write_field(z_mm: Floats, path: Path) -> None:
    rows, columns = z_mm.shape
    path.write_bytes(np.array([rows, columns], dtype="<i4").tobytes() + z_mm.astype("<f4").tobytes())


def _write_model(asset: SimulatorAsset, fields: Mapping[str, HeightField], path: Path) -> None:
    name = asset.name
    assets, geoms = [], []
    for file, field in fields.items():
        label = file.removesuffix(".hf").replace("-tiles/", "-")
        low, high = float(field.z_mm.min()) * 1e-3, float(field.z_mm.max()) * 1e-3
        (x0, *_, x1), (y0, *_, y1) = field.x_mm.tolist(), field.y_mm.tolist()
        size = ((x1 - x0) / 2e3, (y1 - y0) / 2e3, max(high - low, MIN_RANGE_M), low)
        place = ((x0 + x1) / 2e3, (y0 + y1) / 2e3, low)
        assets.append(f'    <hfield name="{label}" file="{file}" size="{_numbers(size)}"/>')
        geoms.append(
            f'      <geom name="{label}" type="hfield" hfield="{label}" pos="{_numbers(place)}" {CONTACT} '
            'rgba="0.55 0.62 0.70 1"/>'
        )
    lines = [
        f'<mujoco model="{path.stem}">',
        f"  <!-- {asset.block.name}: metres, z up; origin at the lower corner of the underside -->",
        f'  <option timestep="{STEP_S:g}"/>',
        "  <asset>",
        *assets,
        "  </asset>",
        "  <worldbody>",
        f'    <body name="{name}">',
        *geoms,
        "    </body>",
        "  </worldbody>",
        "</mujoco>",
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _note(asset: SimulatorAsset) -> str:
    heights, name = asset.heights, asset.name
    rows, columns = heights.z_mm.shape
    proof = heights.certificate
    return f"""\
- `{name}.xml` with `{name}.hf`: one height field, {columns} x {rows} samples. For probes of a few mm.
- `{name}-tiles.xml` with the folder `{name}-tiles`: the same samples as {TILES} x {TILES} fields that share their
  borders. For domes: MuJoCo keeps 50 contacts a pair of geoms, which a soft dome uses up, and looks at every sample
  below a dome (with tiles many times fewer).
- Units and axes: metres, z up, block frame. Static; put it into your scene with `<attach>` or `MjSpec.attach` (body
  `{name}`).
- Error against the formula: {proof.distance_mm:.2g} mm in distance, {proof.vertical_mm:.2g} mm in height (proved).
- Contact settings, on the geoms, with a `priority` that lets them hold against any probe:
  `{CONTACT}`,
  with `timestep="{STEP_S:g}"` (the time constant must be two steps at least; `<attach>` does not bring the step along).
- A mesh geom would not do: MuJoCo collides its convex hull, although its rays see the triangles.
- Tested in MuJoCo 4.0 with the paper's six at scale 1: rays against the formula; a steel ball of 0.5 mm radius dropped
  into a valley rests within 0.05 mm of where the formula lets it, in both files; a dome of 20 mm radius under 2 N,
  dropped by 0.3 mm, rests within 0.05 mm of it on textures 2 and 4, in the tiles. With MuJoCo's default settings it
  is still 0.4 mm too deep in texture 2 after 0.3 s with one field, 0.02 mm with tiles, and small balls fall through.
"""
