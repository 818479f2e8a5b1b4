"""How much of each wave of the formula was printed, from the unknowns of a fit."""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.scan.estimates import HALF_WIDTH, WaveEstimate, wave_direction_deg
from tacbench_cad.scan.refining import Unknowns, free_waves
from tacbench_cad.scan.relief import Relief
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.types import Floats


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
    error = np.zeros(2 * count)
    error[free_waves(relief, unknown)] = standard_error
    result = []
    for j, i in enumerate(relief.fitted):
        wave = relief.surface.waves[i]
        cosine, sine = 1.0 + relief.changes[i, 0], relief.changes[i, 1]
        ratio, phase = math.hypot(cosine, sine), math.degrees(math.atan2(sine, cosine))
        spread = float(error[j])
        # The phase of a wave that is hardly there is not known at all.
        turn = math.degrees(float(error[count + j]) / ratio) if ratio > 0.0 else math.inf
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
                determined=bool(np.isfinite(error[[j, count + j]]).all()),
            )
        )
    return tuple(result)
