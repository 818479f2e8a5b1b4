"""The paper's families of formulas, its six textures, and the names of all built-in textures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal

from tacbench_cad.spec.authors_later import FIRST_NUMBER, LATER, later_surface
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError, one_of

Law = Literal["triangle", "square", "sawtooth"]
Terms = Literal["highest", "count"]
Axes = Literal["x", "y", "xy"]

#: The largest allowed odd multiple of a series.
MAX_TERMS = 5_001


def equation1(A1: float, A2: float, f1: float, f2: float, phase: float = 0.0) -> WaveSum:  # noqa: N803 (the paper's)
    """Make the waves of the paper's first equation, ``A1 sin(f1 u) + A2 sin(f2 v + phase)``.

    Args:
        A1: The amplitude along u, in units of height.
        A2: The amplitude along v, in units of height.
        f1: The frequency along u, in radians per unit of u.
        f2: The frequency along v, in radians per unit of v.
        phase: The phase of the wave along v, in radians.
    """
    return WaveSum(
        (Wave(amplitude=A1, f=f1, g=0.0, phase=0.0), Wave(amplitude=A2, f=0.0, g=f2, phase=phase)),
    )


def series(law: Law, N: int, terms: Terms = "highest", axes: Axes = "xy") -> WaveSum:  # noqa: N803
    """Make the waves of the paper's second equation, a Fourier series over odd multiples i, or of a sawtooth.

    Args:
        law: The amplitudes: ``triangle`` for ``8/pi^2 (-1)^((i-1)/2) / i^2``, ``square`` for ``4/(pi i)``, both over
            odd i; ``sawtooth`` for ``2/pi (-1)^(i+1) / i`` over all i.
        N: The highest multiple, or the number of terms.
        terms: The meaning of ``N``: the ``highest`` multiple (as in the authors' files) or the ``count`` of terms.
        axes: The axes along which the series runs.

    Raises:
        InputError: ``N`` is not a positive whole number, or it is even for a triangle or a square.
    """
    if isinstance(N, bool) or not isinstance(N, int) or N < 1:
        raise InputError("N", N, "must be a whole number of at least 1")
    one_of("terms", terms, ("highest", "count"))
    one_of("law", law, ("triangle", "square", "sawtooth"))
    one_of("axes", axes, ("x", "y", "xy"))
    odd_only = law != "sawtooth"
    if odd_only and terms == "highest" and N % 2 == 0:
        raise InputError("N", N, f'must be odd where terms = "highest"; {N - 1} and {N + 1} are')
    highest = N if terms == "highest" or not odd_only else 2 * N - 1
    if highest > MAX_TERMS:
        raise InputError("N", N, f"the highest multiple may be {MAX_TERMS} at most")
    laws: dict[Law, Callable[[int], float]] = {
        "triangle": lambda i: 8.0 / math.pi**2 * (-1.0) ** ((i - 1) // 2) / i**2,
        "square": lambda i: 4.0 / (math.pi * i),
        "sawtooth": lambda i: 2.0 / math.pi * (-1.0) ** (i + 1) / i,
    }
    weights = [laws[law](i) if i % 2 or not odd_only else 0.0 for i in range(1, highest + 1)]
    return harmonics(weights, axes)


def harmonics(weights: Sequence[float], axes: Axes = "xy") -> WaveSum:
    """Make a Fourier series with any weights, ``sum of weights[i - 1] sin(i u)``, and the same in v.

    >>> print(harmonics([1.0, 0.0, 0.25], axes="x"))
    sin u + 0.25 sin(3u)

    Args:
        weights: The amplitudes of the multiples 1, 2, 3 and so on.
        axes: The axes along which the series runs.

    Raises:
        InputError: There are too many weights, or one is not a finite number.
    """
    one_of("axes", axes, ("x", "y", "xy"))
    if not 1 <= len(weights) <= MAX_TERMS:
        raise InputError("weights", len(weights), f"must be 1 to {MAX_TERMS} numbers")
    used = [(float(i), weight) for i, weight in enumerate(weights, start=1) if weight != 0.0]
    along_x = [Wave(amplitude=weight, f=i, g=0.0) for i, weight in used if "x" in axes]
    along_y = [Wave(amplitude=weight, f=0.0, g=i) for i, weight in used if "y" in axes]
    return WaveSum(tuple(along_x + along_y))


def plane_waves(*waves: tuple[float, ...]) -> WaveSum:
    """Make a sum of any waves, each given as ``(amplitude, f, g)`` or ``(amplitude, f, g, phase)``.

    >>> print(plane_waves((0.6, 2.0, 1.0), (0.6, 2.0, -1.0)))
    0.6 sin(2u + v) + 0.6 sin(2u - v)

    Raises:
        InputError: A wave has too few or too many numbers, or a number that is not finite.
    """
    table = []
    for one in waves:
        if len(one) not in (3, 4):
            raise InputError("wave", one, "must be (amplitude, f, g) or (amplitude, f, g, phase)")
        amplitude, f, g, phase = (*one, 0.0)[:4]
        table.append(Wave(amplitude=amplitude, f=f, g=g, phase=phase))
    return WaveSum(tuple(table))


def ridges(pitch_mm: float, height_mm: float) -> WaveSum:
    """Make parallel round ridges at a distance along x, and the height from valley to ridge."""
    return WaveSum((Wave(amplitude=height_mm / 2.0, f=2.0 * math.pi / pitch_mm, g=0.0),), "mm")


def dots(pitch_mm: float, height_mm: float) -> WaveSum:
    """Make round bumps on a square grid."""
    k = 2.0 * math.pi / pitch_mm
    return _cosines(height_mm / 4.0, (k, 0.0), (0.0, k))


def checks(pitch_mm: float, height_mm: float) -> WaveSum:
    """Make bumps and pits like the fields of a chessboard; two bumps along x are one pitch apart."""
    k = 2.0 * math.pi / pitch_mm
    return _cosines(height_mm / 4.0, (k, k), (k, -k))


def hex_bumps(pitch_mm: float, height_mm: float) -> WaveSum:
    """Make bumps that each have six neighbours at the distance of the pitch."""
    k, half = 4.0 * math.pi / math.sqrt(3.0) / pitch_mm, math.sqrt(3.0) / 2.0
    return _cosines(height_mm / 4.5, (0.0, k), (half * k, k / 2.0), (half * k, -k / 2.0))


def _cosines(amplitude: float, *ways: tuple[float, float]) -> WaveSum:
    return WaveSum(tuple(Wave(amplitude=amplitude, f=f, g=g, phase=math.pi / 2.0) for f, g in ways), "mm")


def _series_texture(number: int, law: Law, highest: int, axes: Axes) -> Texture:
    weight = "8/pi^2 (-1)^((i-1)/2)/i^2" if law == "triangle" else "4/(pi i)"
    shape = "(sin iu + sin iv)" if axes == "xy" else "sin iu"
    text = f"sum of {weight} {shape}, odd i = 1..{highest}"
    return Texture(name=f"texture-{number}", number=number, equation=text, surface=series(law, highest, axes=axes))


def catalogue(preset: str = "paper") -> tuple[Texture, ...]:
    """Return the paper's six textures. For ``released``, textures 4 and 6 have N = 101, as in the authors' files."""
    square = 101 if preset == "released" else 25
    return (
        Texture(name="texture-1", number=1, equation="sin u", surface=equation1(1.0, 0.0, 1.0, 1.0, math.pi / 2)),
        Texture(
            name="texture-2",
            number=2,
            equation="sin u + sin(v + pi/2)",
            surface=equation1(1.0, 1.0, 1.0, 1.0, math.pi / 2),
        ),
        _series_texture(3, "triangle", 25, "xy"),
        _series_texture(4, "square", square, "xy"),
        _series_texture(5, "triangle", 25, "x"),
        _series_texture(6, "square", square, "x"),
    )


#: The names of the authors' later textures.
LATER_NAMES = tuple(LATER)
#: The names of all built-in textures.
BUILT_IN_NAMES = (*(f"texture-{number}" for number in range(1, 7)), *LATER_NAMES)


def built_in_name(word: str) -> str | None:
    """Return the name of a built-in texture for its name or number (``4``, ``dunes``, ``z13``), or None."""
    word = word.lower()
    numbers = {str(number): f"texture-{number}" for number in range(1, 7)}
    numbers |= {f"z{FIRST_NUMBER + i}": name for i, name in enumerate(LATER_NAMES)}
    return numbers.get(word, word if word in BUILT_IN_NAMES else None)


@cache
def built_in(name: str, preset: str = "paper") -> Texture:
    """Return the built-in texture with one of :data:`BUILT_IN_NAMES`."""
    if name in LATER:
        return Texture(name=name, surface=later_surface(name), equation=LATER[name][1])
    return next(texture for texture in catalogue(preset) if texture.name == name)
