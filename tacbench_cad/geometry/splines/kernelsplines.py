"""Spline curves and surfaces of Open CASCADE from arrays."""

from __future__ import annotations

from collections.abc import Sequence

from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface
from OCP.gp import gp_Pnt
from OCP.TColgp import TColgp_Array1OfPnt, TColgp_Array2OfPnt
from OCP.TColStd import TColStd_Array1OfInteger, TColStd_Array1OfReal

from tacbench_cad.util.types import Floats

#: The different knots of a spline, and the number of copies of each.
Knots = tuple[Floats, Sequence[int]]


def curve(poles: Floats, knots: Knots, degree: int) -> Geom_BSplineCurve:
    """Make a curve from its poles, shape (n, 3)."""
    points = TColgp_Array1OfPnt(1, len(poles))
    for i, pole in enumerate(poles.tolist(), start=1):
        points.SetValue(i, gp_Pnt(*pole))
    return Geom_BSplineCurve(points, reals(knots[0]), integers(knots[1]), degree, False)


def surface(poles: Floats, knots: tuple[Knots, Knots], degrees: tuple[int, int]) -> Geom_BSplineSurface:
    """Make a surface from its poles, shape (n, m, 3), and the knots and degrees along both axes."""
    n, m, _ = poles.shape
    points = TColgp_Array2OfPnt(1, n, 1, m)
    for i, row in enumerate(poles.tolist(), start=1):
        for j, pole in enumerate(row, start=1):
            points.SetValue(i, j, gp_Pnt(*pole))
    (at_u, times_u), (at_v, times_v) = knots
    return Geom_BSplineSurface(
        points, reals(at_u), reals(at_v), integers(times_u), integers(times_v), *degrees, False, False
    )


def reals(values: Floats) -> TColStd_Array1OfReal:
    """Copy numbers to an array of the kernel."""
    array = TColStd_Array1OfReal(1, len(values))
    for i, value in enumerate(values.tolist(), start=1):
        array.SetValue(i, value)
    return array


def integers(values: Sequence[int]) -> TColStd_Array1OfInteger:
    """Copy whole numbers to an array of the kernel."""
    array = TColStd_Array1OfInteger(1, len(values))
    for i, value in enumerate(values, start=1):
        array.SetValue(i, value)
    return array
