"""Tables of the expected effect of a correction for a printer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tacbench_cad.cli import print_lines, print_table
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.extensions.printer_models.effect import Effect
    from tacbench_cad.extensions.printer_models.prediction import Errors

#: The number of waves that the table shows. The JSON document has all of them.
MAX_WAVES = 12


def show_effects(effects: Sequence[Effect]) -> None:
    """Print the expected prints of plain and corrected files, and the waves with the largest errors."""
    rows = []
    for effect in effects:
        for what, size, relief, errors in (
            ("formula", effect.size_mm, effect.relief_mm, None),
            ("print of the plain file", effect.plain_size_mm, effect.plain_relief_mm, effect.plain),
            ("print of this file", effect.corrected_size_mm, effect.corrected_relief_mm, effect.corrected),
        ):
            name = effect.texture if what == "formula" else ""
            each = (errors.rms_mm, errors.printable_rms_mm, errors.normal_rms_mm) if errors else ()
            rms = [f"{1000.0 * error:.1f}" for error in each] or [""] * 3
            rows.append((name, what, *(f"{side:.3f}" for side in size), f"{relief:.3f}", *rms))
    heads = (
        *("texture", "", ">x (mm)", ">y (mm)", ">height (mm)", ">relief (mm)"),
        *(">vertical error", ">of printable waves", ">along the normal"),
    )
    title = f"expected prints, by the model {effects[0].model}; errors are root mean squares in µm"
    print_table(title, heads, rows)
    for effect in effects:
        if not effect.waves:
            print_lines(f"{effect.texture} is not a sum of waves: only its sides and its height are corrected")
        if effect.plain and effect.corrected and effect.free and not effect.helps:
            print_lines(_advice(effect, effect.plain, effect.corrected, effect.free))
    waves = [(effect.texture, wave) for effect in effects for wave in effect.waves]
    waves.sort(key=lambda row: -abs(row[1].plain_mm - row[1].amplitude_mm))
    if waves:
        print_table(
            f"expected amplitudes (µm) of {'the waves' if len(waves) <= MAX_WAVES else 'the waves that change most'}",
            ("texture", ">wavelength (mm)", ">direction (°)", ">formula", ">plain", ">corrected", ">in the file", ""),
            [
                (
                    texture,
                    f"{wave.wavelength_mm:.3f}",
                    f"{wave.direction_deg:.0f}",
                    *(
                        f"{1000.0 * amplitude:.1f}"
                        for amplitude in (wave.amplitude_mm, wave.plain_mm, wave.corrected_mm, wave.file_mm)
                    ),
                    wave.note,
                )
                for texture, wave in waves[:MAX_WAVES]
            ],
        )
    if len(waves) > MAX_WAVES:
        print_lines(f"{counted(len(waves) - MAX_WAVES, 'more wave')} (see --json)")


def _advice(effect: Effect, plain: Errors, corrected: Errors, free: Errors) -> str:
    """Say what to do if the correction is not expected to reduce both errors."""
    (vertical, normal), before, with_free = (
        [f"{1000.0 * error:.1f}" for error in (errors.rms_mm, errors.normal_rms_mm)]
        for errors in (corrected, plain, free)
    )
    text = (
        f"{effect.texture}: the correction does not reduce both errors: the vertical error is {vertical} instead of "
        f"{before[0]} µm, and the error along the normal is {normal} instead of {before[1]} µm"
    )
    if effect.relief_rule == "formula" and free.is_below(corrected):
        both = " and ".join(with_free)
        return f"{text}. With a free relief they are {both} µm (tacbench printer-model --relief free)"
    return text if corrected.rms_mm < plain.rms_mm else f"{text}; print the plain file"
