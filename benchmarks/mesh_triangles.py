"""Count the triangles that this package and four simplifiers need for the same measured distance from the formula.

    python benchmarks/mesh_triangles.py [--textures 1,2,3,5,6] [--tolerance 0.01] [--peers manifold3d,...] [--rounds 8]

Each texture of the preset paper is meshed within a tolerance, and the distance of its top from the formula is
measured. Each peer gets a start mesh whose own error is below a tenth of that. A search then finds the fewest
triangles with which the peer stays within the same distance, measured in the same way. The counts are of the whole
closed part. pydelatin makes only tops, so the triangles of the walls and the underside for its outline are added to
its count.

This needs the extra ``bench``. Texture 4 takes minutes, nearly all of it for the peers.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.meshing.certify import derivatives
from tacbench_cad.geometry.meshing.closing import close
from tacbench_cad.geometry.meshing.top import Top, single
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.sines import Sines
from tacbench_cad.util.types import Floats

#: Rounds of each search for the fewest triangles.
ROUNDS = 8
#: The maximum number of triangles of a start mesh, unless a tenth of the distance needs more.
MAX_START_TRIANGLES = 600_000
#: The settings of fast-simplification to try; the best result counts. Its thresholds are absolute, in mesh units.
AGGRESSIONS = (2.0, 2.8)
#: The distance between measured points along x and y, in mm; in a small triangle it is a twelfth of the side.
STEP_MM = 0.04


class Profile:
    """A table of one axis of the formula: value and slope by cubic interpolation on 400,000 points."""

    def __init__(self, sines: Sines, length_mm: float) -> None:
        self.step = length_mm / 400_000
        self.value, self.slope = derivatives(sines, np.linspace(0.0, 400_002 * self.step, 400_003), [0, 1])

    def __call__(self, t: Floats) -> tuple[Floats, Floats]:
        place = np.clip(t / self.step, 0.0, 400_001.0)
        i = place.astype(np.int64)
        s, h = place - i, self.step
        low, high = self.value[i], self.value[i + 1]
        m0, m1 = h * self.slope[i], h * self.slope[i + 1]
        value = low + s * (m0 + s * (3 * (high - low) - 2 * m0 - m1 + s * (2 * (low - high) + m0 + m1)))
        return value, self.slope[i] + s * (self.slope[i + 1] - self.slope[i])


class Ruler:
    """A measurement of the distance between upward triangles and the formula of a block."""

    def __init__(self, block: Block) -> None:
        self.datum = block.formula_datum_mm
        self.p = Profile(block.surface.along_u, block.size_mm[0])
        self.q = Profile(block.surface.along_v, block.size_mm[1])
        self.waves_along = [not s.is_constant for s in (block.surface.along_u, block.surface.along_v)]

    def distance(self, mesh: Mesh, limit_mm: float = np.inf) -> float:
        """Return the largest ``|z - formula| / sqrt(1 + |gradient|^2)`` at dense points of the top, in mm.

        If a few points of each triangle already exceed the limit, the others are not measured.
        """
        triangles = mesh.triangle_points
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        top = triangles[normal[:, 2] > 1e-3 * np.linalg.norm(normal, axis=1)]
        # triangles of the underside look down and those of the walls sideways
        span = (np.ptp(top[:, :, :2], axis=1) * self.waves_along).max(axis=1)
        order = np.clip(np.ceil(span / STEP_MM), 12, 96).astype(np.int64)
        order = 12 * 2 ** np.ceil(np.log2(order / 12)).astype(np.int64)
        worst = self._worst(top, 4)
        for density in np.unique(order):
            if worst > limit_mm:
                break
            worst = max(worst, self._worst(top[order == density], int(density)))
        return worst

    def _worst(self, group: Floats, order: int) -> float:
        weights, worst = _lattice(order), 0.0
        for part in np.array_split(group, max(1, len(group) * len(weights) // 2_000_000)):
            points = np.einsum("kw,nwc->nkc", weights, part).reshape(-1, 3)
            p, dp = self.p(points[:, 0])
            q, dq = self.q(points[:, 1])
            gap = np.abs(points[:, 2] - self.datum - p - q) / np.sqrt(1.0 + dp**2 + dq**2)
            worst = max(worst, float(gap.max(initial=0.0)))
        return worst


def _lattice(order: int) -> Floats:
    i, j = np.meshgrid(np.arange(order + 1), np.arange(order + 1), indexing="ij")
    inside = i + j <= order
    a, b = i[inside] / order, j[inside] / order
    return np.column_stack([a, b, 1.0 - a - b])


def start_mesh(block: Block, ruler: Ruler, distance_mm: float, across: int) -> Mesh:
    """Return a mesh with vertices on the formula and an error below a tenth of a distance.

    The vertices are dense where the formula is curved.

    Args:
        block: The block.
        ruler: Measures the mesh.
        distance_mm: The distance.
        across: Number of lines along a flat axis.
    """
    tolerance_mm = distance_mm / 40.0
    while True:
        x = _lines(block.surface.along_u, block.size_mm[0], tolerance_mm, across)
        y = _lines(block.surface.along_v, block.size_mm[1], tolerance_mm, across)
        if 2 * len(x) * len(y) < MAX_START_TRIANGLES or tolerance_mm > distance_mm / 16.0:
            z = single(block.formula_datum_mm + block.surface.grid(x, y))
            top = Top(x, y, z, None, Certificate(distance_mm=0.0, vertical_mm=0.0))
            mesh = close(top.sheet)
            measured = ruler.distance(mesh)
            if measured < distance_mm / 10.0:
                return mesh
            tolerance_mm *= 0.08 * distance_mm / measured
        else:
            tolerance_mm *= 1.2


def _lines(sines: Sines, length_mm: float, distance_mm: float, across: int) -> Floats:
    if sines.is_constant:
        return single(np.linspace(0.0, length_mm, across))
    t = np.linspace(0.0, length_mm, 20_001)
    slope, second = derivatives(sines, t, [1, 2])
    # the error between lines at a distance h is |p''| h^2 / 8 over sqrt(1 + p'^2); each axis may use half of it
    density = np.sqrt(np.abs(second) / np.sqrt(1.0 + slope**2) / (4.0 * distance_mm)) + 1.0
    total = np.append(0.0, np.cumsum((density[1:] + density[:-1]) / 2.0 * np.diff(t)))
    return single(np.interp(np.linspace(0.0, total[-1], int(total[-1]) + 2), total, t))


@dataclass(frozen=True, order=True)
class Result:
    """The result of a peer.

    Args:
        count: The smallest number of triangles within the distance; infinite if no run stayed within it.
        seconds: The time of its slowest run.
        at_ours_mm: Its measured distance with as many triangles as this package uses; NaN if it cannot make so few.
        start_count: The number of triangles of the start mesh.
    """

    count: float
    seconds: float
    at_ours_mm: float
    start_count: int


@dataclass(frozen=True)
class Race:
    """A start mesh, and the search that each peer makes with it."""

    block: Block
    start: Mesh
    ruler: Ruler
    distance_mm: float
    ours: int
    rounds: int

    def run(self, name: str) -> Result:
        """Return the best result of a peer's settings."""
        if name == "fast-simplification":
            return min(self._by_count(fast_simplification_peer(self.start, value)) for value in AGGRESSIONS)
        if name == "pymeshlab":
            return self._by_count(pymeshlab_peer(self.start))
        if name == "manifold3d":
            return self._fewest(manifold_peer(self.start, self.distance_mm), 1000.0, np.nan)
        return self._fewest(pydelatin_peer(self.block, self.start, self.distance_mm), 200.0, np.nan)

    def _by_count(self, reduce: Callable[[float], Mesh]) -> Result:
        fraction = len(self.start.faces) / self.ours
        mesh = reduce(fraction)
        # some peers stop before they reach the requested count
        at_ours = self.ruler.distance(mesh) if len(mesh.faces) <= 1.01 * self.ours else np.nan
        # if the peer is worse with our number of triangles, it needs more: search between our number and the start mesh
        return self._fewest(reduce, fraction if at_ours > self.distance_mm else 12.0 * fraction, at_ours)

    def _fewest(self, reduce: Callable[[float], Mesh], high: float, at_ours: float) -> Result:
        """Bisect the control value; 1 keeps the most triangles and ``high`` the fewest."""
        best, slowest_s, low = np.inf, 0.0, 1.0
        for _ in range(self.rounds):
            middle = float(np.sqrt(low * high))
            begin = time.perf_counter()
            mesh = reduce(middle)
            slowest_s = max(slowest_s, time.perf_counter() - begin)
            if self.ruler.distance(mesh, self.distance_mm) <= self.distance_mm:
                best, low = min(best, len(mesh.faces)), middle
            else:
                high = middle
        return Result(best, slowest_s, at_ours, len(self.start.faces))


def pymeshlab_peer(start: Mesh) -> Callable[[float], Mesh]:
    import pymeshlab

    def reduce(factor: float) -> Mesh:
        work = pymeshlab.MeshSet()
        work.add_mesh(pymeshlab.Mesh(start.vertices, start.faces))
        work.meshing_decimation_quadric_edge_collapse(
            targetfacenum=int(len(start.faces) / factor),
            preservenormal=True,
            preservetopology=True,
            optimalplacement=True,
            planarquadric=True,
            planarweight=1e-4,
        )
        mesh = work.current_mesh()
        return Mesh(np.array(mesh.vertex_matrix()), np.array(mesh.face_matrix(), dtype=np.int32))

    return reduce


def fast_simplification_peer(start: Mesh, aggression: float) -> Callable[[float], Mesh]:
    import fast_simplification  # type: ignore[import-untyped, unused-ignore]

    def reduce(factor: float) -> Mesh:
        target = int(len(start.faces) / factor)
        points, faces = fast_simplification.simplify(
            start.vertices.astype(np.float32), start.faces, target_count=target, agg=aggression
        )
        return Mesh(points.astype(np.float64), faces.astype(np.int32))

    return reduce


def manifold_peer(start: Mesh, distance_mm: float) -> Callable[[float], Mesh]:
    import manifold3d

    body = manifold3d.Manifold(manifold3d.Mesh(start.vertices.astype(np.float32), start.faces.astype(np.uint32)))

    def reduce(factor: float) -> Mesh:
        mesh = body.simplify(distance_mm * factor / 100.0).to_mesh()
        return Mesh(mesh.vert_properties[:, :3].astype(np.float64), mesh.tri_verts.astype(np.int32))

    return reduce


def pydelatin_peer(block: Block, start: Mesh, distance_mm: float) -> Callable[[float], Mesh]:
    from pydelatin import Delatin

    x, y = np.unique(start.vertices[:, 0]), np.unique(start.vertices[:, 1])
    if len(x) == 2:
        x = np.linspace(0.0, x[-1], 50)
    if len(y) == 2:
        y = np.linspace(0.0, y[-1], 50)
    height = (block.formula_datum_mm + block.surface.grid(x, y)).astype(np.float32)

    def reduce(factor: float) -> Mesh:
        # pydelatin's error is vertical, so the search continues until the measured distance fits
        surface = Delatin(np.ascontiguousarray(height.T), max_error=distance_mm * factor / 10.0)
        column, row = surface.vertices[:, 0].astype(np.int64), surface.vertices[:, 1].astype(np.int64)
        row = len(y) - 1 - row  # pydelatin counts rows from the other end
        points = np.column_stack([x[column], y[row], height[column, row]])
        faces = np.asarray(surface.triangles, dtype=np.int32).reshape(-1, 3)
        a, b, c = (points[faces[:, k], :2] for k in range(3))
        turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0.0
        faces[turned] = faces[turned][:, ::-1]
        edge = np.isin(points[:, 0], x[[0, -1]]) | np.isin(points[:, 1], y[[0, -1]])
        closing = np.zeros((int(edge.sum()) + 4 + 2, 3), dtype=np.int32)  # walls and underside, for the count
        return Mesh(points, np.concatenate([faces, closing]))

    return reduce


def main() -> None:
    """Print one table row for each texture and peer."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", default="1,2,3,4,5,6")
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--peers", default="pymeshlab,fast-simplification,manifold3d,pydelatin")
    parser.add_argument(
        "--rounds", type=int, default=ROUNDS, help="bisections for each peer; one takes minutes for texture 4"
    )
    options = parser.parse_args()
    print(f"{'texture':8}{'program':22}{'triangles':>10}{'ratio':>8}{'seconds':>9}   measured distance, start mesh")
    for number in options.textures.split(","):
        block = Block.of(number, sampling=Tolerance(mm=options.tolerance))
        start_time = time.perf_counter()
        mesh, certificate = mesh_block(block)
        elapsed_s = time.perf_counter() - start_time
        ruler = Ruler(block)
        distance = ruler.distance(mesh)
        ours = len(mesh.faces)
        proved = f"{distance:.5f} mm measured, {certificate.distance_mm:.5f} proved"
        print(f"{number:8}{'ours':22}{ours:10}{1:8.2f}{elapsed_s:9.3f}   {proved}", flush=True)
        flat = not all(ruler.waves_along)
        # a texture of one axis is tried as strips and with square cells; the better result counts
        starts = [start_mesh(block, ruler, distance, lines) for lines in ((2, 41) if flat else (2,))]
        for name in options.peers.split(","):
            races = (Race(block, start, ruler, distance, ours, options.rounds) for start in starts)
            result = min(race.run(name) for race in races)
            note = "" if np.isnan(result.at_ours_mm) else f", {result.at_ours_mm:.4f} mm with our number of triangles"
            verdict = "  PEER WINS" if result.count < ours or result.at_ours_mm < distance else ""
            row = f"{number:8}{name:22}{result.count:10.0f}{result.count / ours:8.2f}{result.seconds:9.3f}"
            print(f"{row}   from {result.start_count}{note}{verdict}", flush=True)


if __name__ == "__main__":
    main()
