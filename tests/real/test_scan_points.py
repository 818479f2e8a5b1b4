"""The coloured points of a scan, read by MeshLab's library."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.scans import true_scan

pymeshlab = pytest.importorskip("pymeshlab")

from tacbench_cad.extensions.scan.colours import coloured, reach_mm
from tacbench_cad.extensions.scan.deviations import top_map, wall_points
from tacbench_cad.extensions.scan.result import Noise, ScanResult
from tacbench_cad.extensions.scan.result_files import write_coloured
from tacbench_cad.extensions.scan.simulating import ScanTruth, low_pass
from tacbench_cad.spec.block import Block

pytestmark = pytest.mark.real


def test_meshlab_reads_the_points_their_deviation_and_their_colours(tmp_path: Path) -> None:
    block = Block.of(2, scale=0.5)
    cloud, fit = true_scan(block, ScanTruth(points=5000, transfer_x=low_pass(1.0), seed=1).with_random_pose())
    top, walls = top_map(cloud, block, fit, layer_mm=0.2), wall_points(cloud, block, fit)
    noise = Noise(rms_mm=0.01, source="residuals")
    write_coloured(ScanResult(cloud=cloud, block=block, fit=fit, top=top, walls=walls, noise=noise), tmp_path / "a.ply")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "a.ply"))
    mesh = meshes.current_mesh()
    deviation = fit.deviation_mm[fit.used]
    np.testing.assert_allclose(mesh.vertex_matrix(), fit.pose.to_block(cloud.points_mm[fit.used]), atol=1e-4)
    np.testing.assert_allclose(mesh.vertex_scalar_array(), deviation, atol=1e-6)
    expected = coloured(deviation, reach_mm(deviation)) / 255.0
    np.testing.assert_allclose(mesh.vertex_color_matrix()[:, :3], expected, atol=1e-6)
