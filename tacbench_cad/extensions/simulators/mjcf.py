"""MuJoCo: the block as one height field (for probes) and as 8 x 8 height fields (for domes), in metres, with z up.

For collisions, MuJoCo replaces a mesh by its convex hull, which has no relief. Height fields keep the relief. MuJoCo
keeps at most 50 contacts for each pair of geoms. A dome that has more contacts with one field loses the others and
sinks in; if the field is divided into tiles, there are 50 contacts for each tile.

The file of a field contains ``int32 rows, int32 columns`` and the heights as ``float32``, with row 0 at the lowest y.
The loader scales the heights to the range from 0 to 1. The size along z is therefore the range of the samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.simulators.asset import HeightField, SimulatorAsset, TargetFiles
from tacbench_cad.util.text import at_most
from tacbench_cad.util.types import Floats

#: The number of tiles along each side in the file for domes.
TILES = 8
#: The time step for the contact settings, in s. The time constant of ``solref`` must be at least two steps.
STEP_S = 0.0005
#: The settings for stiff contacts. They replace the settings of the probe because of their ``priority``.
CONTACT = 'solref="0.002 1" solimp="0.99 0.999 0.0001" friction="0.5 0.0001 0.000001" condim="3" priority="1"'
#: The smallest range of a field along z, in m, for flat fields: MuJoCo refuses a range of 0. Every relief is larger.
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
    """Divide a field into tiles that share their border samples. Yield each tile with the text ``ROW-COLUMN``.

    A field that has fewer cells than :data:`TILES` along a side is divided into single cells along that side.
    """
    x, y, z = heights.x_mm, heights.y_mm, heights.z_mm
    for row, (k, m) in enumerate(pairwise(_cuts(len(y) - 1))):
        for column, (i, j) in enumerate(pairwise(_cuts(len(x) - 1))):
            tile = replace(heights, x_mm=x[i : j + 1], y_mm=y[k : m + 1], z_mm=z[k : m + 1, i : j + 1])
            yield f"{row}-{column}", tile


def _cuts(cells: int) -> list[int]:
    """Return the indices of the lines at which a side with this number of cells is divided."""
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
- For probes of a few mm: `{name}.xml` with `{name}.hf`, one height field with {columns} x {rows} samples.
- For domes: `{name}-tiles.xml` with the folder `{name}-tiles`. It has the same samples, divided into {TILES} x {TILES}
  fields that share their borders. MuJoCo keeps at most 50 contacts for each pair of geoms, and a soft dome on one field
  needs more. MuJoCo also checks every sample below the dome; with tiles it checks many times fewer samples.
- Units and axes: metres, z up, block frame. The body `{name}` does not move. Add it to your scene with `<attach>` or
  `MjSpec.attach`.
- Error against the formula: at most {at_most(proof.vertical_mm, 2)} mm in height ({proof.evidence}).
- The geoms have these contact settings. Because of their `priority`, they replace the settings of any probe:
  `{CONTACT}`.
- Set `timestep="{STEP_S:g}"` in your own scene, because `<attach>` does not copy it. The first number of `solref`, the
  time constant, must be at least two steps.
- Do not use a mesh geom: MuJoCo replaces it by its convex hull for collisions, although rays meet the triangles.
- Tested in MuJoCo 4.0 with the six textures of the paper at scale 1:
  - Heights measured by rays agree with the formula.
  - With both files, a steel ball of 0.5 mm radius, dropped into a valley, comes to rest within 0.05 mm of the height
    that the formula predicts.
  - With the tiles, a dome of 20 mm radius under 2 N, dropped by 0.3 mm, comes to rest within 0.05 mm of the predicted
    height (textures 2 and 4).
  - With the default settings of MuJoCo, the dome is still too deep in texture 2 after 0.3 s: by 0.4 mm with one field
    and by 0.02 mm with tiles. Small balls fall through.
"""
