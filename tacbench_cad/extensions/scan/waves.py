"""How much of each wave of the formula was printed, from the unknowns of a fit."""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.extensions.scan.estimates import HALF_WIDTH, WaveEstimate, wave_direction_deg
from tacbench_cad.extensions.scan.height_model import Relief
from tacbench_cad.extensions.scan.refining import Unknowns, free_waves
from tacbench_cad.spec import WaveSum
from tacbench_cad.util.types import Floats

#: The length of a vector of two normal components, in standard deviations, that noise alone exceeds in 5 % of cases.
_LENGTH_OF_NOISE = 2.448


def wave_estimates(relief: Relief, unknown: Unknowns, standard_error: Floats) -> tuple[WaveEstimate, ...]:
    """Return the estimate of each wave that has an amplitude.

    Args:
        relief: The fitted relief.
        unknown: The parameters of the fit.
        standard_error: The standard errors of the free numbers of the waves, in the order of ``free_waves``.
    """
    if not isinstance(relief.surface, WaveSum) or not unknown.waves:
        return ()
    count = len(relief.fitted)
    known = np.zeros(2 * count)
    known[free_waves(relief, unknown)] = standard_error
    errors = {i: (float(known[j]), float(known[count + j])) for j, i in enumerate(relief.fitted)}
    result = []
    for i in relief.moving:
        wave = relief.surface.waves[i]
        spread, turn_spread = errors.get(i, (math.inf, math.inf))
        cosine, sine = 1.0 + relief.changes[i, 0], relief.changes[i, 1]
        phase = math.degrees(math.atan2(sine, cosine))
        ratio = _length(cosine, sine, spread) if turn_spread else cosine
        # The phase of a wave that is hardly there is not known at all.
        turn = math.degrees(turn_spread / ratio) if ratio > 0.0 else math.inf
        half = min(HALF_WIDTH * turn, 180.0)
        result.append(
            WaveEstimate(
                wave=wave,
                wavelength_mm=2.0 * math.pi / math.hypot(wave.f, wave.g),
                direction_deg=wave_direction_deg(wave),
                amplitude_ratio=ratio,
                ratio_low=max(0.0, ratio - HALF_WIDTH * spread),
                ratio_high=ratio + HALF_WIDTH * spread,
                standard_error=spread,
                phase_deg=phase,
                phase_low_deg=phase - half,
                phase_high_deg=phase + half,
                is_scale_reference=i == unknown.scale_reference,
                is_shift_reference=i in unknown.shift_references,
                determined=math.isfinite(spread + turn_spread),
            )
        )
    return tuple(result)


def _length(cosine: float, sine: float, spread: float) -> float:
    """Return the length of a vector from its measured components, without the length that the noise alone gives.

    A wave that cannot be told from noise at 95 % has the length of its component in phase with the formula.
    """
    square = cosine**2 + sine**2
    if square < _LENGTH_OF_NOISE**2 * spread**2:
        return max(0.0, cosine)
    return math.sqrt(square - spread**2) if math.isfinite(spread) else math.sqrt(square)
