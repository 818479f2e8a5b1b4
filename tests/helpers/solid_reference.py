"""Reference values for the solids, computed from the formula alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepGProp import BRepGProp
from OCP.GeomAbs import GeomAbs_SurfaceType
from OCP.GeomAdaptor import GeomAdaptor_Surface
from OCP.GProp import GProp_GProps
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS, TopoDS_Face, TopoDS_Shape

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.types import Floats


def gauss(low: float, high: float, panels: int) -> tuple[Floats, Floats]:
    """Return the nodes and weights of the 10-point Gauss rule on equal panels of [low, high]."""
    points, weights = np.polynomial.legendre.leggauss(10)
    width = (high - low) / panels
    return (
        (low + (np.arange(panels)[:, None] + (points + 1.0) / 2.0) * width).ravel(),
        np.tile(weights * width / 2.0, panels),
    )


def top_area_mm2(block: Block, panels: int) -> float:
    """Return the area of the whole top (with the corner that a key removes), in mm^2."""
    (x, wx), (y, wy) = (gauss(0.0, side, panels) for side in block.size_mm)
    surface = block.surface
    total = 0.0
    for part in np.array_split(np.arange(len(x)), max(1, len(x) // 200)):
        if surface.is_separable:
            a, b = surface.along_u(x[part], 1)[:, None], surface.along_v(y, 1)[None, :]
        else:
            a, b = surface.gradient(x[part, None], y[None, :])
        total += float(wx[part] @ np.sqrt(1.0 + a**2 + b**2) @ wy)
    return total


def block_area_mm2(block: Block) -> float:
    """Return the area of a block without key and label, in mm^2, from a quadrature that is stable to 1e-6."""
    panels, area = 50, top_area_mm2(block, 25)
    while abs((finer := top_area_mm2(block, panels)) - area) > 1e-6 * finer:
        panels, area = 2 * panels, finer
    (x, y), (u, wu), (v, wv) = block.size_mm, *(gauss(0.0, side, 500) for side in block.size_mm)
    datum = block.solid_datum_mm
    walls = sum(float(wu @ (datum + block.surface(u, at))) for at in (0.0, y))
    walls += sum(float(wv @ (datum + block.surface(at, v))) for at in (0.0, x))
    return finer + walls + x * y


def hole_mm3(block: Block, centre: tuple[float, float], radius: float) -> float:
    """Return the volume that a round hole through the block removes, in mm^3."""
    r, wr = gauss(0.0, radius, 60)
    angle = np.arange(2000) * (2.0 * np.pi / 2000)
    z = block.solid_datum_mm + block.surface(
        centre[0] + r[:, None] * np.cos(angle), centre[1] + r[:, None] * np.sin(angle)
    )
    return float((wr * r) @ z.sum(axis=1)) * 2.0 * np.pi / 2000


def kernel_volume_mm3(shape: TopoDS_Shape) -> float:
    """Return the kernel's volume by its adaptive integration, in mm^3.

    The kernel's default integration has an error of 2e-4 for the steep square waves of texture 4.
    """
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties, 1e-5, False, True)
    return float(properties.Mass())


def faces(shape: TopoDS_Shape) -> Iterator[TopoDS_Face]:
    """Yield all faces."""
    explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
    while explorer.More():
        yield TopoDS.Face_s(explorer.Current())
        explorer.Next()


def points_of_top(shape: TopoDS_Shape, per_side: int) -> Floats:
    """Return points of the spline faces of a shape, on a grid for each face with its ends included, shape (n, 3)."""
    points = []
    for face in faces(shape):
        surface = BRep_Tool.Surface_s(face)
        if GeomAdaptor_Surface(surface).GetType() != GeomAbs_SurfaceType.GeomAbs_BSplineSurface:
            continue
        u0, u1, v0, v1 = surface.Bounds()
        for u in np.linspace(u0, u1, per_side):
            for v in np.linspace(v0, v1, per_side):
                point = surface.Value(float(u), float(v))
                assert abs(point.X() - u) < 1e-9
                assert abs(point.Y() - v) < 1e-9
                points.append((point.X(), point.Y(), point.Z()))
    return np.array(points)


def random_block(rng: np.random.Generator, oblique: bool) -> Block:
    """Return a block with one to six random waves, steep or flat, which is high enough for its relief."""
    waves = []
    for _ in range(int(rng.integers(1, 7))):
        f, g = rng.uniform(0.2, 12.0, 2) * rng.choice([-1.0, 1.0], 2)
        if not oblique:
            f, g = (f, 0.0) if rng.random() < 0.5 else (0.0, g)
        waves.append(
            Wave(amplitude=float(rng.uniform(0.02, 0.9)), f=float(f), g=float(g), phase=float(rng.uniform(0.0, 6.28)))
        )
    texture = Texture(name="random", equation="random", surface=WaveSum(tuple(waves)))
    return Block.of(texture, height_mm=20.0, size_mm=(float(rng.uniform(4.0, 25.0)), float(rng.uniform(4.0, 25.0))))
