"""Compare the textured tops of meshes with their formula, using only the triangles."""

from __future__ import annotations

import manifold3d
import numpy as np

from helpers.own_formulas import largest_distance
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.types import Floats


def faults(mesh: Mesh) -> list[str]:
    """Return the faults that keep a mesh from being a closed, outward-oriented, non-degenerate body of genus 0."""
    faults = []
    if not np.array_equal(mesh.vertices, mesh.vertices.astype(np.float32)):
        faults.append("a coordinate is no float32 value")
    if len(np.unique(mesh.vertices, axis=0)) != len(mesh.vertices):
        faults.append("two vertices at one place")
    if not np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices))):
        faults.append("a vertex is not used")
    a, b, c = mesh.faces.astype(np.int64).T
    count = len(mesh.vertices)
    edges = np.concatenate([a * count + b, b * count + c, c * count + a])
    backward = np.concatenate([b * count + a, c * count + b, a * count + c])
    if len(np.unique(edges)) != len(edges):
        faults.append("an edge is used twice in the same direction")
    if not np.array_equal(np.sort(edges), np.sort(backward)):
        faults.append("an edge is open or wound inconsistently")
    if not np.all(areas(mesh) > 0.0):
        faults.append("a triangle without area")
    body = manifold3d.Manifold(manifold3d.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)))
    if body.status() != manifold3d.Error.NoError:
        faults.append(f"manifold3d: {body.status()}")
    elif body.genus() != 0 or not np.isclose(body.volume(), mesh.volume_mm3, rtol=1e-9) or body.volume() <= 0.0:
        faults.append(f"genus {body.genus()}, volume {body.volume()} and {mesh.volume_mm3}")
    return faults


def areas(mesh: Mesh) -> Floats:
    """Return the area of each triangle, from its float32 coordinates."""
    return np.asarray(np.linalg.norm(normals(mesh.triangle_points), axis=1) / 2.0)


def normals(triangle_points: Floats) -> Floats:
    """Return twice the area vector of each triangle, shape (m, 3)."""
    return np.cross(triangle_points[:, 1] - triangle_points[:, 0], triangle_points[:, 2] - triangle_points[:, 0])


def top_triangles(mesh: Mesh, block: Block) -> Floats:
    """Return the triangles whose normals point up, shape (m, 3, 3): the block's top.

    The wall along the key's cut leans by the rounding of its vertices, so triangles on the cut are left out.
    """
    triangle_points = mesh.triangle_points
    up = normals(triangle_points)[:, 2] > 0.0
    if block.key_mm is not None:
        excess = triangle_points[:, :, 0] - triangle_points[:, :, 1] - (block.size_mm[0] - block.key_mm)
        up &= np.any(np.abs(excess) > 1e-5, axis=1)
    return triangle_points[up]


def deviations(
    block: Block, mesh: Mesh, order: int = 6, seed: int = 0, max_points: int = 2_000_000
) -> tuple[float, float]:
    """Return the largest distance and the largest vertical deviation of the top from the formula.

    The top is sampled at a barycentric lattice of every triangle, with its corners and edges, and at four random
    points in it. If that takes more than ``max_points`` points, fewer triangles are sampled, drawn at random.
    """
    top = top_triangles(mesh, block)
    i, j = np.meshgrid(np.arange(order + 1), np.arange(order + 1), indexing="ij")
    lattice = np.column_stack([i[i + j <= order], j[i + j <= order]]) / order
    scattered = np.random.default_rng(seed).dirichlet([1.0, 1.0, 1.0], 4)[:, :2]
    shares = np.concatenate([lattice, scattered])
    weights = np.column_stack([shares, 1.0 - shares.sum(axis=1)])
    distance = vertical = 0.0
    if len(top) * len(weights) > max_points:
        top = top[np.random.default_rng(seed).permutation(len(top))[: max_points // len(weights)]]
    for part in np.array_split(top, max(1, len(top) * len(weights) // 500_000)):
        points = np.einsum("kw,nwc->nkc", weights, part).reshape(-1, 3)
        x, y = points[:, 0], points[:, 1]
        vertical = max(vertical, float(np.abs(points[:, 2] - block.height_at(x, y)).max()))
        distance = max(distance, largest_distance(points, block.height_at, block.size_mm, np.inf)[0])
    return distance, vertical


def random_texture(rng: np.random.Generator, oblique: bool) -> Texture:
    """Return a texture of one to five waves along the axes or, if ``oblique``, in any direction.

    Its relief is low enough for the base of every preset.
    """
    waves = []
    for _ in range(int(rng.integers(1, 6))):
        frequency = float(rng.uniform(0.15, 3.0))
        angle = float(rng.uniform(0.0, 2.0 * np.pi)) if oblique else float(rng.integers(4)) * np.pi / 2.0
        direction = (np.cos(angle), np.sin(angle)) if oblique else ((1.0, 0.0), (0.0, 1.0))[int(rng.integers(2))]
        amplitude = float(rng.uniform(0.05, 0.5)) / max(1.0, frequency)
        phase = float(rng.uniform(0.0, 6.3))
        waves.append(Wave(amplitude=amplitude, f=frequency * direction[0], g=frequency * direction[1], phase=phase))
    return Texture(name="random", equation="random", surface=WaveSum(tuple(waves)))
