"""The protocol of a surface: what the formula of a texture must offer, and the operations on surfaces.

A surface is a function ``z(u, v)`` with bounds of its derivatives. Meshes, solids, pictures, the simulated sensor and
the checks use only these methods, so every implementation works with all of them. A class that inherits from
:class:`Surface` has the operations: ``a + b``, ``a - b``, ``2 * a``, ``a.turned(30)``, ``a.windowed(2.0)``.
:class:`tacbench_cad.spec.waves.WaveSum` is a formula, and :class:`tacbench_cad.spec.spline.SplineSurface` represents
height maps, functions of Python and textures with creases.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

# the operations make splines, which are surfaces, so their modules are loaded when they are used
from tacbench_cad import spec
from tacbench_cad.spec.extremes import Extremes, Footprint
from tacbench_cad.spec.sines import Sines, Wave
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: What the numbers of a surface are: ``units`` without a dimension, which a block maps to mm, or lengths in ``mm``.
Unit = Literal["units", "mm"]
#: The ends of a rectangle along u and v.
Domain = tuple[tuple[float, float], tuple[float, float]]
#: The ends along u and along v, where there are some.
Ends = tuple[tuple[float, float] | None, tuple[float, float] | None]


#: The largest fraction by which frequencies may differ from multiples of a common one.
_COMMON = 1e-6
#: The largest multiple of the common frequency that the lowest frequency may have.
_MAX_MULTIPLE = 12


class Surface(Protocol):
    """A function ``z(u, v)`` with bounds of its derivatives."""

    @property
    def unit(self) -> Unit:
        """The unit of u, v and the height. Every operation keeps it."""
        ...

    @property
    def error(self) -> float:
        """The largest vertical distance of the surface from the function that it represents; 0 for a definition."""
        return 0.0

    @property
    def evidence(self) -> Literal["proved", "measured"]:
        """Whether the error is proved, or only measured at many points."""
        return "proved"

    @property
    def creases(self) -> tuple[Floats, Floats]:
        """The positions along u and along v of the lines along which the slope changes suddenly.

        A cell must not have a crease inside, because its second derivatives have no bound there.
        """
        return np.zeros(0), np.zeros(0)

    @property
    def breaks(self) -> tuple[Floats, Floats]:
        """The positions along u and along v between which the bounds of cells are tightest: the knots of a spline.

        They are empty for a surface without such lines.
        """
        return np.zeros(0), np.zeros(0)

    @property
    def is_flat(self) -> bool:
        """Whether all heights are equal."""
        ...

    @property
    def amplitude_sum(self) -> float:
        """An upper bound of ``|z|``."""
        ...

    @property
    def is_separable(self) -> bool:
        """Whether ``z = p(u) + q(v)``."""
        return False

    @property
    def along_u(self) -> Sines:
        """The part ``p(u)`` of a separable surface, including its constant."""
        raise InputError("surface", str(self), "is not separable")

    @property
    def along_v(self) -> Sines:
        """The part ``q(v)`` of a separable surface."""
        return self.along_u

    @property
    def highest_frequency(self) -> tuple[float, float]:
        """The highest relevant angular frequencies along u and v, in radians per unit."""
        ...

    def __call__(self, u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the value or a partial derivative at the points ``(u, v)``, with the broadcast shape."""
        ...

    def grid(self, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the values or a partial derivative on a grid of lines, shape (n, m)."""
        ...

    def gradient(self, u: ArrayLike, v: ArrayLike) -> tuple[Floats, Floats]:
        """Return both first partial derivatives at the points ``(u, v)``."""
        return self(u, v, (1, 0)), self(u, v, (0, 1))

    def bound(self, order_u: int, order_v: int) -> float:
        """Return an upper bound of the absolute value of a partial derivative over the whole domain."""
        ...

    def cell_bounds(self, u: Floats, v: Floats, order: tuple[int, int]) -> Floats:
        """Return an upper bound of the absolute value of a partial derivative on each cell of a grid.

        Args:
            u: The lines along u, ascending, shape (n,).
            v: The lines along v, ascending, shape (m,).
            order: The orders of the derivative along u and v.

        Returns:
            The bounds, shape (n - 1, m - 1).
        """
        ...

    def integral(self, u: tuple[float, float], v: tuple[float, float]) -> float:
        """Return the integral over a rectangle."""
        ...

    def integral_triangle(self, corners: Sequence[tuple[float, float]]) -> float:
        """Return the integral over a triangle with these corners ``(u, v)``."""
        ...

    def extremes(self, u: tuple[float, float], v: tuple[float, float], region: Footprint | None = None) -> Extremes:
        """Find the lowest and the highest value over a rectangle, or over its part in a region."""
        ...

    def mapped(
        self,
        per_unit: tuple[float, float],
        height_per_unit: float,
        origin: tuple[float, float] = (0.0, 0.0),
        unit: Unit | None = None,
    ) -> Surface:
        """Return the same surface in other coordinates: ``x = (u - origin_u) * per_unit_x``, and y likewise.

        The new unit is ``unit``; None keeps it.
        """
        ...

    def over(self, u: tuple[float, float], v: tuple[float, float]) -> Surface:
        """Return the part of the surface over a rectangle. Bounds of cells and integrals need this part.

        Raises:
            InputError: The surface is not known over the whole rectangle.
        """
        return self

    @property
    def plane_waves(self) -> tuple[Wave, ...] | None:
        """The plane waves whose sum the surface is exactly; None if it is not such a sum."""
        return None

    @property
    def spline(self) -> spec.SplineSurface | None:
        """The spline that the surface is exactly; None if it is none."""
        return None

    @property
    def ends(self) -> Ends:
        """The ends along u and along v beyond which the surface is not known; None along an axis without ends."""
        return None, None

    @property
    def period_u(self) -> float | None:
        """The period along u; infinite if the surface does not depend on u, and None if it has no period."""
        if self.plane_waves is None:
            return None
        frequencies = sorted({abs(wave.f) for wave in self.plane_waves if wave.amplitude and wave.f})
        if not frequencies:
            return math.inf
        for divisor in range(1, _MAX_MULTIPLE + 1):
            common = frequencies[0] / divisor
            if all(abs(f / common - round(f / common)) < _COMMON * f / common for f in frequencies):
                return 2.0 * math.pi / common
        return None

    def __add__(self, other: Surface) -> Surface:
        """Return the sum; see :func:`tacbench_cad.spec.operations.added`."""
        return spec.added([self, other])

    def __sub__(self, other: Surface) -> Surface:
        """Return the difference."""
        return self + -1.0 * other

    def __mul__(self, factor: float) -> Surface:
        """Return the surface with its height multiplied by a factor."""
        return spec.scaled(self, factor)

    def __rmul__(self, factor: float) -> Surface:
        """Return the surface with its height multiplied by a factor."""
        return spec.scaled(self, factor)

    def turned(self, angle_deg: float, domain: Domain | None = None) -> Surface:
        """Return the surface turned counter-clockwise; see :func:`tacbench_cad.spec.operations.turned`."""
        return spec.turned(self, angle_deg, domain)

    def windowed(self, margin: float | tuple[float, float], domain: Domain | None = None) -> Surface:
        """Return the surface that fades out towards its edges; see :func:`tacbench_cad.spec.operations.windowed`."""
        return spec.windowed(self, margin, domain)

    def masked(self, mask: Callable[[Floats, Floats], Floats], domain: Domain | None = None) -> Surface:
        """Return the surface multiplied by a mask; see :func:`tacbench_cad.spec.operations.masked`."""
        return spec.masked(self, mask, domain)

    def repeated(self, along: tuple[bool, bool] = (True, True)) -> Surface:
        """Return the surface that repeats beyond its ends; a surface that is known in the whole plane is returned."""
        return self
