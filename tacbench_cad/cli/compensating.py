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
        for what, size, relief, rms in (
            ("formula", effect.size_mm, effect.relief_mm, 0.0),
            ("print of the plain file", effect.plain_size_mm, effect.plain_relief_mm, effect.plain_rms_mm),
            ("print of this file", effect.corrected_size_mm, effect.corrected_relief_mm, effect.corrected_rms_mm),
        ):
            name = effect.texture if what == "formula" else ""
            deviation = "-" if rms is None else f"{1000.0 * rms:.1f}"
            rows.append((name, what, *(f"{side:.3f}" for side in size), f"{relief:.3f}", deviation))
    heads = ("texture", "", ">x (mm)", ">y (mm)", ">height (mm)", ">relief (mm)", ">deviation, rms (µm)")
    print_table(f"expected prints, by the model {effects[0].model}", heads, rows)
    for effect in effects:
        if not effect.waves:
            print_lines(f"{effect.texture} is not a sum of waves: only its sides and its height are corrected")
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
