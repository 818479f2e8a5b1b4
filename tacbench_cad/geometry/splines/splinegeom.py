"""Open CASCADE's spline curves and surfaces of a block's patches."""

from __future__ import annotations

import math

import numpy as np
from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface
from OCP.GeomFill import GeomFill_BSplineCurves, GeomFill_FillingStyle
from OCP.gp import gp_Vec

from tacbench_cad.geometry.splines import kernelsplines
from tacbench_cad.geometry.splines.exact import SplinePatches
from tacbench_cad.geometry.splines.patches import Patches
from tacbench_cad.spec.spline import greville
from tacbench_cad.util.types import Floats


class SplineGeometry:
    """The curves and surfaces of the patches. A curve that two patches share is made once.

    Args:
        relief: The patches.
    """

    def __init__(self, relief: Patches | SplinePatches) -> None:
        self._relief = relief
        self._made_x: dict[tuple[int, int], Geom_BSplineCurve] = {}
        self._made_y: dict[tuple[int, int], Geom_BSplineCurve] = {}
        self._profiles_x: dict[int, Geom_BSplineCurve] = {}
        self._profiles_y: dict[int, Geom_BSplineCurve] = {}

    def corner_height_mm(self, i: int, j: int) -> float:
        """Return the height z at the crossing of line i of x and line j of y, in mm."""
        if self._relief.profiles_mm is not None:
            return _at_line(self._relief.profiles_mm[0], i) + _at_line(self._relief.profiles_mm[1], j)
        last = i == self._relief.x.patches
        return float(self._row_along_x(i - last, j)[-1 if last else 0])

    def curve_x(self, i: int, j: int) -> Geom_BSplineCurve:
        """Return the curve of patch i of x at line j of y. Its parameter is x in mm."""
        if (i, j) not in self._made_x:
            axis, y = self._relief.x, float(self._relief.y.lines[j])
            if self._relief.profiles_mm is None:
                poles = _points(axis.abscissae_mm(i), y, self._row_along_x(i, j))
                self._made_x[i, j] = kernelsplines.curve(poles, axis.knots_of(i), axis.degree)
            else:
                if i not in self._profiles_x:
                    poles = _points(axis.abscissae_mm(i), 0.0, self._relief.profiles_mm[0][i])
                    self._profiles_x[i] = kernelsplines.curve(poles, axis.knots_of(i), axis.degree)
                rise = _at_line(self._relief.profiles_mm[1], j)
                self._made_x[i, j] = self._profiles_x[i].Translated(gp_Vec(0.0, y, rise))
        return self._made_x[i, j]

    def curve_y(self, i: int, j: int) -> Geom_BSplineCurve:
        """Return the curve of patch j of y at line i of x. Its parameter is y in mm."""
        if (i, j) not in self._made_y:
            axis, x = self._relief.y, float(self._relief.x.lines[i])
            if self._relief.profiles_mm is None:
                poles = _points(x, axis.abscissae_mm(j), self._column_along_y(i, j))
                self._made_y[i, j] = kernelsplines.curve(poles, axis.knots_of(j), axis.degree)
            else:
                if j not in self._profiles_y:
                    poles = _points(0.0, axis.abscissae_mm(j), self._relief.profiles_mm[1][j])
                    self._profiles_y[j] = kernelsplines.curve(poles, axis.knots_of(j), axis.degree)
                rise = _at_line(self._relief.profiles_mm[0], i)
                self._made_y[i, j] = self._profiles_y[j].Translated(gp_Vec(x, 0.0, rise))
        return self._made_y[i, j]

    def surface(self, i: int, j: int) -> Geom_BSplineSurface:
        """Return the surface of patch (i, j). Its parameters are x and y in mm.

        For ``p(x) + q(y)``, the poles are ``(X_i, Y_j, a_i + b_j)``. The kernel's Coons patch of the four boundary
        curves has the same poles, and is faster than a loop over the poles in Python.
        """
        if self._relief.profiles_mm is not None:
            return _coons(self.curve_x(i, j), self.curve_y(i + 1, j), self.curve_x(i, j + 1), self.curve_y(i, j))
        x, y = self._relief.x, self._relief.y
        poles = _grid(x.abscissae_mm(i), y.abscissae_mm(j), self._relief.heights_mm(i, j))
        return kernelsplines.surface(poles, (x.knots_of(i), y.knots_of(j)), (x.degree, y.degree))

    def curve_diagonal(self, i: int, j: int) -> Geom_BSplineCurve:
        """Return the curve over the diagonal of the square patch (i, j). Its parameter is ``sqrt(2) y`` in mm.

        On the diagonal, the surface is a spline with the knots of both axes. If the surface is separable, its degree is
        the larger of the two degrees, otherwise their sum. At each knot, it is as smooth as the axis of the knot.
        Interpolation in the space of these splines is exact.
        """
        from scipy.interpolate import BSpline

        x, y = self._relief.x, self._relief.y
        degrees = (x.degree, y.degree)
        degree = max(degrees) if self._relief.profiles_mm is not None else sum(degrees)
        breaks: dict[float, int] = {}
        for inner, own in ((x.inner_knots(i), x.degree), (y.inner_knots(j), y.degree)):
            for place, times in inner.items():
                breaks[place] = max(breaks.get(place, 1), degree - own + times)
        repeated = np.repeat(sorted(breaks), [breaks[place] for place in sorted(breaks)])
        knots = np.concatenate([np.zeros(degree + 1), repeated, np.ones(degree + 1)])
        t = np.clip(greville(knots, degree), 0.0, 1.0)
        heights = np.einsum("ki,ij,kj->k", x.values(i, t), self._relief.heights_mm(i, j), y.values(j, t))
        z = np.linalg.solve(BSpline.design_matrix(t, knots, degree).toarray(), heights)
        z[0], z[-1] = heights[0], heights[-1]
        lines_x, lines_y = self._relief.x.lines, self._relief.y.lines
        poles = _points(
            lines_x[i] + (lines_x[i + 1] - lines_x[i]) * t, lines_y[j] + (lines_y[j + 1] - lines_y[j]) * t, z
        )
        places = np.array([0.0, *sorted(breaks), 1.0])
        ends = math.sqrt(2.0) * lines_y[j : j + 2]
        along = ends[0] + (ends[1] - ends[0]) * places
        along[-1] = ends[1]
        copies = [degree + 1, *(breaks[place] for place in sorted(breaks)), degree + 1]
        return kernelsplines.curve(poles, (along, copies), degree)

    def whole_surface(self) -> Geom_BSplineSurface:
        """Return all patches as one surface that is C1 at the joints. Its parameters are x and y in mm."""
        x, y = self._relief.x, self._relief.y
        knots_x, keep_x = x.joined()
        knots_y, keep_y = y.joined()
        at_x = np.concatenate([x.abscissae_mm(i) for i in range(x.patches)])[keep_x]
        at_y = np.concatenate([y.abscissae_mm(j) for j in range(y.patches)])[keep_y]
        degrees = (x.degree, y.degree)
        if self._relief.profiles_mm is None:
            rows = [np.hstack([self._relief.heights_mm(i, j) for j in range(y.patches)]) for i in range(x.patches)]
            heights = np.vstack(rows)[np.ix_(keep_x, keep_y)]
            return kernelsplines.surface(_grid(at_x, at_y, heights), (knots_x, knots_y), degrees)
        a, b = (profile.ravel()[keep] for profile, keep in zip(self._relief.profiles_mm, (keep_x, keep_y), strict=True))
        sides_x = [kernelsplines.curve(_points(at_x, at_y[j], a + b[j]), knots_x, degrees[0]) for j in (0, -1)]
        sides_y = [kernelsplines.curve(_points(at_x[i], at_y, a[i] + b), knots_y, degrees[1]) for i in (0, -1)]
        return _coons(sides_x[0], sides_y[1], sides_x[1], sides_y[0])

    def _row_along_x(self, i: int, j: int) -> Floats:
        """Return the heights z of the poles of patch i of x at line j of y, in mm."""
        last = j == self._relief.y.patches
        return self._relief.heights_mm(i, j - last)[:, -1 if last else 0]

    def _column_along_y(self, i: int, j: int) -> Floats:
        last = i == self._relief.x.patches
        return self._relief.heights_mm(i - last, j)[-1 if last else 0, :]


def _at_line(profile: Floats, line: int) -> float:
    """Return the value of a profile, shape (patches, count), at a line between patches."""
    return float(profile[line, 0] if line < len(profile) else profile[-1, -1])


def _points(x: Floats | float, y: Floats | float, z: Floats) -> Floats:
    return np.column_stack(np.broadcast_arrays(x, y, z))


def _grid(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the poles of a surface from positions x, shape (n,), and y, shape (m,), and heights z, shape (n, m)."""
    return np.stack(np.broadcast_arrays(x[:, None], y[None, :], z), axis=-1)


def _coons(
    low: Geom_BSplineCurve, right: Geom_BSplineCurve, high: Geom_BSplineCurve, left: Geom_BSplineCurve
) -> Geom_BSplineSurface:
    """Make the bilinearly blended patch of four boundary curves."""
    return GeomFill_BSplineCurves(low, right, high, left, GeomFill_FillingStyle.GeomFill_StretchStyle).Surface()
