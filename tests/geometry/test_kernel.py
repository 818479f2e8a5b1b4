"""Functions for shapes of the kernel, with a box and a smaller box inside it."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")

from tacbench_cad.geometry import kernel


def test_the_parts_of_a_box() -> None:
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

    box = BRepPrimAPI_MakeBox(2.0, 3.0, 4.0).Solid()
    assert [len(kernel.distinct(box, kind)) for kind in ("SOLID", "FACE", "EDGE", "VERTEX")] == [1, 6, 12, 8]
    assert len(list(kernel.each(box, "EDGE"))) == 24  # two faces use each of them
    assert list(kernel.each(box, "FACE", outside_of="SOLID")) == []
    assert kernel.volume_mm3(box) == pytest.approx(24.0)
    assert kernel.area_mm2(kernel.distinct(box, "FACE")) == pytest.approx(52.0)


def test_a_matrix_places_a_shape() -> None:
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
    from OCP.TopoDS import TopoDS_Compound

    matrix = np.array([[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]])
    low, high = kernel.box_mm(BRepPrimAPI_MakeBox(2.0, 3.0, 4.0).Solid().Moved(kernel.location(matrix)))
    assert low == pytest.approx((2.0, 6.0, 7.0)) and high == pytest.approx((5.0, 8.0, 11.0))
    empty = TopoDS_Compound()
    assert np.array_equal(kernel.box_mm(empty), np.zeros((2, 3)))
