"""OpenUSD: usd-core reads a stage in metres with z up, with the heights of the formula and unsubdivided triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import Exported, places_mm
from helpers.triangles import heights_mm

from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.spec.block import Block

pytest.importorskip("pxr", reason="usd-core is not installed: pip install usd-core")
trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: pip install trimesh")
from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation

pytestmark = pytest.mark.real


def mesh_of(number: str, exported: Exported) -> tuple[Any, np.ndarray, np.ndarray]:
    """Return the mesh prim, its points in mm with z up, and its triangles."""
    stage = Usd.Stage.Open(str(exported(number, "usd") / f"texture-{number}.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    to_mm = 1e3 * UsdGeom.GetStageMetersPerUnit(stage)
    (prim,) = [candidate for candidate in stage.Traverse() if candidate.IsA(UsdGeom.Mesh)]
    assert prim.GetPath().HasPrefix(stage.GetDefaultPrim().GetPath())
    mesh = UsdGeom.Mesh(prim)
    points = np.array(mesh.GetPointsAttr().Get(), dtype=np.float64)
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
    # the stage is also returned, because the prim becomes invalid without it
    return (stage, prim), points * to_mm, np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)


@pytest.mark.parametrize("number", mostly_long("123456", "2", "4"))
def test_heights(number: str, exported: Exported) -> None:
    block = Block.of(number)
    (_, prim), points, triangles = mesh_of(number, exported)
    solid = trimesh.Trimesh(points, triangles, process=False)
    assert solid.is_watertight and solid.is_winding_consistent
    assert solid.bounds[1][2] == pytest.approx(block.height_mm, abs=1e-5)
    extent = np.array(UsdGeom.Mesh(prim).GetExtentAttr().Get()) * 1e3
    np.testing.assert_allclose(extent, solid.bounds, atol=1e-5)
    assert UsdGeom.Mesh(prim).GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.none
    assert prim.HasAPI(UsdPhysics.CollisionAPI)
    assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == UsdPhysics.Tokens.none
    places = places_mm(block)
    top = heights_mm(points, triangles, places)
    assert np.abs(top - block.height_at(*places.T)).max() <= SimulatorAsset(block).mesh_certificate.vertical_mm + 1e-4


def test_the_physics_material_is_bound(exported: Exported) -> None:
    (stage, prim), _, _ = mesh_of("2", exported)
    (target,) = prim.GetRelationship("material:binding:physics").GetTargets()
    material = UsdPhysics.MaterialAPI(stage.GetPrimAtPath(target))
    assert material.GetStaticFrictionAttr().Get() == pytest.approx(0.5)


def test_the_validators_of_openusd_find_nothing(exported: Exported) -> None:
    (stage, _), _, _ = mesh_of("2", exported)
    registry = UsdValidation.ValidationRegistry()
    validators = registry.GetOrLoadAllValidators()
    assert validators
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [f"{error.GetName()}: {error.GetMessage()}" for error in errors] == []
