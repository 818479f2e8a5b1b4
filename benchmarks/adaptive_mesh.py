"""Count the triangles of adaptive tops and of two other programs for the same measured distance from the formula.

    python benchmarks/adaptive_mesh.py [--textures weave,octaves,...] [--tolerance 0.01] [--rounds 5] [--map 1024]

Six textures that are not separable are meshed within a tolerance, and the distance of each top from its formula is
measured. pymeshlab's quadric decimation gets a fine start mesh, and a search finds the fewest triangles with which it
stays within the same distance, measured in the same way. The search begins with our number of triangles divided by 1.3:
if the distance is then larger than ours, the claim holds. The counts are of the whole closed part.
Claim: at most 1.3 times the triangles of pymeshlab, closed, not folded, and in at most 5 s of processor time.

With ``--map N``, a height map of N x N samples becomes an STL file within 0.02 mm. pydelatin makes a mesh of the same
samples, with the fewest triangles that stay within the measured distance of ours. The samples of a map are a surface
without a wall, so here the triangles of the top are compared.

This needs the extra ``bench``.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from mesh_triangles import pymeshlab_peer

from tacbench_cad.checks.meshcheck import edges
from tacbench_cad.formats.stl import write_stl
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.meshing.closing import close
from tacbench_cad.geometry.meshing.net import lattice
from tacbench_cad.geometry.meshing.top import Top, single
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.interpolation import height_map
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.types import Floats

#: The numbers of samples of the start mesh along x and y.
START = (320, 400)
#: The tolerance of the height map, in mm.
MAP_TOLERANCE_MM = 0.02
#: The claim: at most this many times the triangles of pymeshlab, in at most this processor time.
MAX_RATIO, MAX_SECONDS = 1.3, 5.0


def textures() -> dict[str, Texture | str]:
    """Return the six textures: four sums of oblique waves, and two of the authors' later textures."""
    third, root = 2.0 * math.pi / 3.0, math.sqrt(2.0)
    waves = {
        "weave": plane_waves((0.7, 1.0, 0.5), (0.7, 1.0, -0.5)),
        "hexagonal": plane_waves(*[(0.3, math.cos(k * third), math.sin(k * third), math.pi / 2.0) for k in range(3)]),
        "octaves": plane_waves((0.6, 1.0, 0.0), (0.6, 0.0, 1.0), (0.3, root, root), (0.3, root, -root)),
        "ripples": plane_waves((0.5, 1.0, -1.0, math.pi / 2.0), (-0.5, 1.0, 1.0, math.pi / 2.0), (0.2, 4.0, 0.0)),
    }
    made: dict[str, Texture | str] = {name: Texture(name=name, surface=wave) for name, wave in waves.items()}
    return made | {"swirl": "swirl", "dunes": "dunes"}


def distance(block: Block, points: Floats) -> float:
    """Return the largest distance of triangles from the formula at 45 points of each, in mm."""
    worst = 0.0
    for part in np.array_split(points, max(1, len(points) // 20_000)):
        x, y, z = np.einsum("kw,nwc->cnk", lattice(8, corners=True), part)
        slope = np.hypot(*block.surface.gradient(x, y))
        gap = np.abs(z - block.height_at(x, y)) / np.sqrt(1.0 + slope**2)
        worst = max(worst, float(gap.max()))
    return worst


def top_of(mesh: Mesh) -> Floats:
    """Return the triangles that look up, shape (m, 3, 3)."""
    normals = mesh.doubled_normals
    return mesh.triangle_points[normals[:, 2] > 1e-3 * np.linalg.norm(normals, axis=1)]


def start_mesh(block: Block, limit: float) -> Mesh:
    """Return a mesh with vertices on the formula: an even grid, or our own fine mesh if creases need more."""
    x, y = (single(np.linspace(0.0, side, count)) for side, count in zip(block.size_mm, START, strict=True))
    z = single(block.formula_datum_mm + block.surface.grid(x, y))
    top = Top(x, y, z, None, Certificate(distance_mm=0.0, vertical_mm=0.0))
    even = close(top.sheet)
    if distance(block, top_of(even)) <= limit / 4.0:
        return even
    return block_part(replace(block, sampling=Tolerance(mm=limit / 8.0))).mesh[0]


def fewest(reduce: Callable[[float], Mesh], within: Callable[[Mesh], bool], high: float, rounds: int) -> float:
    """Bisect the control value of a peer, and return the smallest number of triangles that is within the distance."""
    low, best = 1.0, math.inf
    for _ in range(rounds):
        middle = math.sqrt(low * high)
        mesh = reduce(middle)
        if within(mesh):
            best, low = min(best, len(mesh.faces)), middle
        else:
            high = middle
    return best


def fewest_by_count(measure: Callable[[float], float], count: float, limit: float, rounds: int) -> float:
    """Search the fewest triangles of a peer whose error falls roughly as the inverse of their number.

    Args:
        measure: Returns the error of a mesh with a number of triangles.
        count: The number of triangles to begin with.
        limit: The error that is allowed.
        rounds: The number of meshes to measure.

    Returns:
        The smallest number that is within the error, or infinity if there is none.
    """
    low, high = 0.0, math.inf
    for _ in range(rounds):
        error = measure(count)
        if error <= limit:
            high = count
        else:
            low = count
        guess = count * error / limit * 1.03
        count = guess if low < guess < high else math.sqrt(low * high) if low else high / 2.0
        if not math.isfinite(count) or high <= 1.02 * low:
            break
    return high


def compare_texture(name: str, texture: Texture | str, tolerance: float, rounds: int) -> bool:
    """Print the number of triangles of a texture, of ours and of pymeshlab's; return whether the claim holds."""
    block = Block.of(texture, sampling=Tolerance(mm=tolerance))
    busy = time.process_time()
    mesh, expected = block_part(block).mesh
    busy = time.process_time() - busy
    limit = distance(block, top_of(mesh))
    assert expected.certificate is not None
    ours = len(mesh.faces)
    edges_ok = edges(mesh).ok
    # Every triangle of the top looks up, so the top is folded only if its triangles cover more than the footprint.
    covered = mesh_footprint(top_of(mesh)) / block.footprint_mm2 - 1.0
    print(
        f"{name:12}{'ours':12}{ours:9}{1:7.2f}   {busy:.2f} s of the processor; {limit:.5f} mm measured, "
        f"{expected.certificate.distance_mm:.5f} mm {expected.certificate.evidence}; "
        f"{'closed' if edges_ok else 'OPEN'}; footprint covered once, up to {abs(covered):.0e}",
        flush=True,
    )
    start = start_mesh(block, limit)
    own = distance(block, top_of(start))
    reduce = pymeshlab_peer(start)
    distances: list[float] = []

    def measure(count: float) -> float:
        distances.append(distance(block, top_of(reduce(len(start.faces) / count))))
        return distances[-1]

    begin = time.perf_counter()
    count = fewest_by_count(measure, ours / MAX_RATIO, limit, rounds)
    spent = (time.perf_counter() - begin) / len(distances)
    note = (
        f"{distances[0]:.4f} mm with {ours / MAX_RATIO:.0f} triangles; {spent:.1f} s for each run, from "
        f"{len(start.faces)} triangles within {own:.5f} mm"
    )
    print(f"{name:12}{'pymeshlab':12}{count:9.0f}{count / ours:7.2f}   {note}", flush=True)
    return distances[0] > limit and edges_ok and abs(covered) < 1e-6 and busy <= MAX_SECONDS


def mesh_footprint(points: Floats) -> float:
    """Return the sum of the areas of triangles, seen from above."""
    a, b = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2.0)


def compare_map(samples: int, rounds: int) -> None:
    """Print the time from a height map to an STL file, and the number of triangles of ours and of pydelatin's."""
    from pydelatin import Delatin

    heights = rough_ground(samples)
    side = 30.0
    pixel = side / (samples - 1)
    begin, busy = time.perf_counter(), time.process_time()
    surface = height_map(heights, mm_per_pixel=pixel, height_mm=(0.0, 1.5))
    block = Block.of(
        Texture(name="map", surface=surface),
        mm_per_unit=(1.0, 1.0, 1.0),
        size_mm=(side, side),
        sampling=Tolerance(mm=MAP_TOLERANCE_MM),
    )
    part = block_part(block)
    with tempfile.TemporaryDirectory() as folder:
        write_stl(part, Path(folder) / "map.stl")
    spent, busy = time.perf_counter() - begin, time.process_time() - busy
    top = top_of(part.mesh[0])
    limit = distance(block, top)
    print(f"{'map':12}{'ours':12}{len(top):9}{1:7.2f}   {spent:.2f} s, {busy:.2f} s of the processor; {limit:.5f} mm")
    x = np.linspace(0.0, side, samples)
    z = block.formula_datum_mm + surface.grid(x, x)

    def reduce(factor: float) -> Mesh:
        net = Delatin(np.ascontiguousarray(z.T, dtype=np.float32), max_error=limit * factor / 4.0)
        places = net.vertices[:, :2].astype(np.int64)
        places[:, 1] = samples - 1 - places[:, 1]  # pydelatin counts rows from the other end
        points = np.column_stack([x[places[:, 0]], x[places[:, 1]], z[places[:, 0], places[:, 1]]])
        return Mesh(points, np.asarray(net.triangles, dtype=np.int32).reshape(-1, 3))

    begin = time.perf_counter()
    count = fewest(reduce, lambda other: distance(block, other.triangle_points) <= limit, 6.0, rounds)
    spent = (time.perf_counter() - begin) / rounds
    print(f"{'map':12}{'pydelatin':12}{count:9.0f}{count / len(top):7.2f}   {spent:.1f} s for each run")


def rough_ground(samples: int) -> Floats:
    """Return a height map with hills of all sizes: random phases, and amplitudes that fall with the frequency."""
    rng = np.random.default_rng(0)
    along, across = np.fft.fftfreq(samples) * samples, np.fft.rfftfreq(samples) * samples
    k = np.hypot(along[:, None], across[None, :])
    k[0, 0] = 1.0
    spectrum = k**-2.2 * np.exp(-((k / (samples / 10.0)) ** 2)) * np.exp(2j * np.pi * rng.random(k.shape))
    return np.fft.irfft2(spectrum, (samples, samples))


def main() -> int:
    """Print one row for each texture and program; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", default=",".join(textures()))
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--rounds", type=int, default=5, help="meshes of each peer")
    parser.add_argument("--map", type=int, default=1024, help="samples along a side of the height map; 0 for no map")
    options = parser.parse_args()
    print(f"{'texture':12}{'program':12}{'triangles':>9}{'ratio':>7}")
    if options.map:
        compare_map(options.map, options.rounds)
    every = textures()
    names = [*filter(None, options.textures.split(","))]
    holds = [compare_texture(name, every[name], options.tolerance, options.rounds) for name in names]
    print(f"claim holds: {', '.join(f'{name} {ok}' for name, ok in zip(names, holds, strict=True))}")
    return 0 if all(holds) else 1


if __name__ == "__main__":
    sys.exit(main())
