"""The fourteen later textures of the paper's authors, z6 to z19 in their files.

Four are sums of waves as they are. Three are Fourier series with Bessel functions as coefficients, by the formulas of
Jacobi and Anger; the terms that are left out sum to less than 1e-12, which is proved. Three have creases along straight
grid lines, and are splines with a proved error. The other four have cone points or oblique creases, and are splines
with a measured error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from tacbench_cad.spec.interpolation import measured_error, sampled, spline_through
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.spline import SplineAxis, SplineSurface
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.types import Floats

#: The highest order of the Bessel functions. For an argument of 1, the sum over all higher orders n of n J_n, and that
#: of I_n, are below 1e-12, because J_n(1) and I_n(1) are at most exp(1/4) / (2^n n!).
_ORDERS = 12
#: The number of spans of the spline of a half sine wave. By Hall and Meyer (1976), a complete cubic spline has an error
#: of at most 5/384 h^4 max |f''''|.
_SPANS = 40
_HALF_SINE_ERROR = 5.0 / 384.0 * (math.pi / _SPANS) ** 4

#: The number of spans of a period with oblique creases. With more spans, the error would be smaller, but a solid of the
#: paper's block would have too many poles.
_EVEN_SPANS = 120

#: The authors' number of the first of these textures.
FIRST_NUMBER = 6
_COS = math.pi / 2.0


@cache
def later_surface(name: str) -> Surface:
    """Return the surface of a later texture by its name."""
    return LATER[name][0]()


def _product(amplitude: float, left: tuple[float, float], right: tuple[float, float]) -> list[Wave]:
    """Return ``amplitude sin(f u + a) sin(g v + b)`` as two waves, from ``(f, a)`` and ``(g, b)``."""
    (f, a), (g, b) = left, right
    return [
        Wave(amplitude=amplitude / 2.0, f=f, g=-g, phase=a - b + _COS),
        Wave(amplitude=-amplitude / 2.0, f=f, g=g, phase=a + b + _COS),
    ]


def _ripple() -> Surface:
    return WaveSum((Wave(amplitude=1.0, f=1.0, g=1.0), Wave(amplitude=0.5, f=2.0, g=-2.0, phase=_COS)))


def _weave() -> Surface:
    return WaveSum(
        (*_product(1.0, (1.0, 0.0), (1.0, 0.0)), *_product(0.3, (3.0, _COS), (3.0, _COS))),
    )


def _hexagons() -> Surface:
    half = math.sqrt(3.0) / 2.0
    ways = ((1.0, 0.0), (0.5, half), (0.5, -half))
    return WaveSum(tuple(Wave(amplitude=1.0, f=f, g=g, phase=_COS) for f, g in ways))


def _coral() -> Surface:
    return WaveSum(
        (
            *_product(1.0, (1.0, 0.0), (1.0, _COS)),
            *_product(0.5, (2.0, math.pi / 4.0), (2.0, _COS)),
            *_product(0.25, (4.0, 0.0), (4.0, 0.0)),
        )
    )


def _dunes() -> Surface:
    from scipy.special import iv

    # exp(sin u) = I_0 + 2 sum of I_n cos n(u - pi/2)
    waves = [Wave(amplitude=float(iv(0, 1.0)), f=0.0, g=1.0, phase=_COS)]
    for n in range(1, _ORDERS + 1):
        waves += _product(2.0 * float(iv(n, 1.0)), (float(n), _COS - n * _COS), (1.0, _COS))
    return WaveSum(tuple(waves))


def _scales() -> Surface:
    from scipy.special import jv

    # sin(u + sin v) = sum of J_n sin(u + n v), and J_(n-1) + J_(n+1) = 2 n J_n
    orders = [n for n in range(-_ORDERS, _ORDERS + 1) if n]
    return WaveSum(tuple(Wave(amplitude=n * float(jv(n, 1.0)), f=1.0, g=float(n)) for n in orders))


def _swirl() -> Surface:
    from scipy.special import jv

    # sin(u + cos v) = sum of J_n sin(u + n v + n pi/2), and cos(v + sin u) = sum of J_n cos(v + n u)
    waves = []
    for n in range(-_ORDERS, _ORDERS + 1):
        waves.append(Wave(amplitude=float(jv(n, 1.0)), f=1.0, g=float(n), phase=n * _COS))
        waves.append(Wave(amplitude=float(jv(n, 1.0)), f=float(n), g=1.0, phase=_COS))
    return WaveSum(tuple(waves))


def _half_sine(start: float, length: float = math.pi) -> tuple[SplineAxis, Floats]:
    """Return a spline of one arch of a sine wave from ``start`` on. It repeats with creases at both ends."""
    from scipy.interpolate import make_interp_spline

    t = np.linspace(0.0, math.pi, _SPANS + 1)
    spline = make_interp_spline(t, np.sin(t), k=3, bc_type=([(1, 1.0)], [(1, -1.0)]))
    poles = np.asarray(spline.c, dtype=np.float64)
    poles[0] = poles[-1] = 0.0
    return SplineAxis(start + spline.t * (length / math.pi), 3, True), poles


def _diamond() -> Surface:
    (u, a), (v, b) = _half_sine(0.0), _half_sine(-_COS)
    return SplineSurface(u, v, a[:, None] + b[None, :], error=2.0 * _HALF_SINE_ERROR)


def _ridges() -> Surface:
    (u, a), (v, b) = _half_sine(0.0), _half_sine(-_COS)
    return SplineSurface(u, v, 1.0 - np.outer(a, b), error=(2.0 + _HALF_SINE_ERROR) * _HALF_SINE_ERROR)


def _dimples() -> Surface:
    (u, a), (v, b) = _half_sine(0.0, 2.0 * math.pi), _half_sine(-math.pi, 2.0 * math.pi)
    return SplineSurface(u, v, -np.outer(a, b), error=(2.0 + _HALF_SINE_ERROR) * _HALF_SINE_ERROR)


def _rings() -> Surface:
    def rings(u: Floats, v: Floats) -> Floats:
        return np.asarray(np.sin(math.pi * np.sqrt(np.sin(u) ** 2 + np.cos(v) ** 2)))

    # the cone points are at the corners of a period
    return sampled(rings, u=(0.0, math.pi), v=(-_COS, _COS), error=9e-4, repeats=(True, True))


def _knurl() -> Surface:
    def knurl(u: Floats, v: Floats) -> Floats:
        return np.asarray(np.arcsin(np.clip(np.sin(u) * np.cos(v), -1.0, 1.0)))

    lines = ((_COS,), (math.pi,))
    ends = (-_COS, 3.0 * _COS), (0.0, 2.0 * math.pi)
    return sampled(knurl, u=ends[0], v=ends[1], error=9e-4, creases=lines, repeats=(True, True))


def _rock() -> Surface:
    def rock(u: Floats, v: Floats) -> Floats:
        return np.asarray(np.maximum(np.sin(u), np.cos(v)) + 0.5 * np.minimum(np.sin(2.0 * u), np.cos(2.0 * v)))

    return _on_even_lines(rock)


def _chevron() -> Surface:
    def chevron(u: Floats, v: Floats) -> Floats:
        return np.asarray(np.arccos(np.cos(u + np.arcsin(np.sin(v)))))

    return _on_even_lines(chevron)


def _on_even_lines(function: Callable[[Floats, Floats], Floats]) -> SplineSurface:
    """Return a spline on even lines. Creases at 45 degrees then run through the crossings of the lines."""
    lines = np.linspace(0.0, 2.0 * math.pi, _EVEN_SPANS + 1)
    heights = function(lines[:, None], lines[None, :])
    return measured_error(function, spline_through(lines, lines, heights, repeats=(True, True)))


#: The functions that make the surfaces, and their equations, by names in the order of the authors' numbers from z6.
LATER: dict[str, tuple[Callable[[], Surface], str]] = {
    "ripple": (_ripple, "sin(u + v) + 0.5 cos(2u - 2v)"),
    "rings": (_rings, "sin(pi sqrt(sin^2 u + cos^2 v))"),
    "diamond": (_diamond, "|sin u| + |cos v|"),
    "weave": (_weave, "sin u sin v + 0.3 cos 3u cos 3v"),
    "hexagons": (_hexagons, "cos u + cos(u/2 + sqrt(3)/2 v) + cos(u/2 - sqrt(3)/2 v)"),
    "ridges": (_ridges, "1 - |sin u cos v|"),
    "rock": (_rock, "max(sin u, cos v) + 0.5 min(sin 2u, cos 2v)"),
    "dunes": (_dunes, "exp(sin u) cos v"),
    "dimples": (_dimples, "-sqrt(sin^2(u/2) cos^2(v/2))"),
    "scales": (_scales, "sin(u + sin v) cos v"),
    "knurl": (_knurl, "arcsin(sin u cos v)"),
    "swirl": (_swirl, "sin(u + cos v) + cos(v + sin u)"),
    "chevron": (_chevron, "arccos(cos(u + arcsin(sin v)))"),
    "coral": (_coral, "sin u cos v + 0.5 sin(2u + pi/4) cos 2v + 0.25 sin 4u sin 4v"),
}
