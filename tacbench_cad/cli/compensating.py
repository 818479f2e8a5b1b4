"""Tables of the expected effect of a correction for a printer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tacbench_cad.cli.common import print_lines, print_table
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.spec.compensation import Effect

#: The number of waves that the table shows. The JSON document has all of them.
MAX_WAVES = 12


def show_effects(effects: Sequence[Effect]) -> None:
    """Print the expected prints of plain and corrected files, and the waves with the largest errors."""
    rows = []
    for effect in effects:
        plain = (effect.plain_rms_mm, effect.plain_normal_rms_mm)
        corrected = (effect.corrected_rms_mm, effect.corrected_normal_rms_mm)
        for what, size, relief, deviations in (
            ("formula", effect.size_mm, effect.relief_mm, (None, None)),
            ("print of the plain file", effect.plain_size_mm, effect.plain_relief_mm, plain),
            ("print of this file", effect.corrected_size_mm, effect.corrected_relief_mm, corrected),
        ):
            name = effect.texture if what == "formula" else ""
            rms = ("" if each is None else f"{1000.0 * each:.1f}" for each in deviations)
            rows.append((name, what, *(f"{side:.3f}" for side in size), f"{relief:.3f}", *rms))
    heads = (
        *("texture", "", ">x (mm)", ">y (mm)", ">height (mm)", ">relief (mm)"),
        *(">vertical error, rms (µm)", ">along the normal (µm)"),
    )
    print_table(f"expected prints, by the model {effects[0].model}", heads, rows)
    for effect in effects:
        if not effect.waves:
            print_lines(f"{effect.texture} is not a sum of waves: only its sides and its height are corrected")
        if not effect.helps:
            print_lines(
                f"{effect.texture}: the correction does not help, because most of the deviation comes from waves that "
                "are narrower than the nozzle; print the plain file"
            )
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
