"""The expected effect of a correction: the print of the plain file and that of the corrected file."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tacbench_cad.extensions.printer_models.correction import MAX_FACTOR, Corrected, corrected_for
from tacbench_cad.extensions.printer_models.model import PrinterModel, ReliefRule
from tacbench_cad.extensions.printer_models.prediction import Errors, Print, is_correctable
from tacbench_cad.spec import WaveSum


@dataclass(frozen=True, kw_only=True)
class PredictedWave:
    """A wave of a formula, as it is printed from a plain and from a corrected file.

    Args:
        wavelength_mm: The wavelength.
        direction_deg: The angle between the x axis and the direction in which the height changes.
        amplitude_mm: The amplitude in the formula.
        plain_mm: The amplitude in the print of a plain file.
        file_mm: The amplitude in the corrected file.
        corrected_mm: The amplitude in the print of the corrected file.
        note: Why the wave is not completely corrected; empty if it is.
    """

    wavelength_mm: float
    direction_deg: float
    amplitude_mm: float
    plain_mm: float
    file_mm: float
    corrected_mm: float
    note: str


@dataclass(frozen=True, kw_only=True)
class Effect:
    """The expected effect of a correction.

    Args:
        block: The name of the corrected block.
        texture: The name of the texture.
        model: The name of the printer model.
        relief_rule: Its rule for the relief of corrected prints.
        size_mm: The sides and the height of the formula's block.
        plain_size_mm: The sides and the height of a print of the plain file.
        corrected_size_mm: The sides and the height of a print of the corrected file.
        file_size_mm: The sides and the height of the corrected file.
        relief_mm: The relief of the formula.
        plain_relief_mm: The relief of a print of the plain file.
        corrected_relief_mm: The relief of a print of the corrected file.
        plain: The predicted errors of a print of the plain file; None if the texture is not a sum of waves.
        corrected: The same for the corrected file.
        free: The same for a file that is corrected with a free relief.
        waves: The waves, by decreasing amplitude; empty if the texture is not a sum of waves.
    """

    block: str
    texture: str
    model: str
    relief_rule: ReliefRule
    size_mm: tuple[float, float, float]
    plain_size_mm: tuple[float, float, float]
    corrected_size_mm: tuple[float, float, float]
    file_size_mm: tuple[float, float, float]
    relief_mm: float
    plain_relief_mm: float
    corrected_relief_mm: float
    plain: Errors | None
    corrected: Errors | None
    free: Errors | None
    waves: tuple[PredictedWave, ...]

    @property
    def helps(self) -> bool:
        """Whether the correction is expected to reduce the vertical error and the error along the normal."""
        return self.plain is None or self.corrected is None or self.corrected.is_below(self.plain)


def effect_of(correction: Corrected) -> Effect:
    """Return the expected effect of a correction."""
    block, model = correction.print, correction.model
    plain, corrected = Print(file=block, model=model), Print(file=correction.file, model=model)
    waves: tuple[PredictedWave, ...] = ()
    errors: list[Errors | None] = [None] * 3
    design, file = block.surface, corrected.file.surface
    if isinstance(design, WaveSum) and isinstance(file, WaveSum):
        free = Print(file=corrected_for(block, replace(model, relief_rule="free")).file, model=model)
        errors = [each.errors(block) for each in (plain, corrected, free)]
        can = is_correctable(design, model).tolist()
        rows = zip(design.waves, file.waves, plain.surface.waves, corrected.surface.waves, can, strict=True)
        waves = tuple(
            PredictedWave(
                wavelength_mm=2.0 * math.pi / math.hypot(wave.f, wave.g),
                direction_deg=math.degrees(math.atan2(wave.g, wave.f)),
                amplitude_mm=abs(wave.amplitude),
                plain_mm=abs(before.amplitude),
                file_mm=abs(changed.amplitude),
                corrected_mm=abs(after.amplitude),
                note=_note(abs(changed.amplitude / wave.amplitude), wave.f, wave.g, model, correctable),
            )
            for wave, changed, before, after, correctable in rows
            if wave.amplitude and (wave.f or wave.g)
        )
    return Effect(
        block=correction.file.name,
        texture=block.texture.name,
        model=model.name,
        relief_rule=model.relief_rule,
        size_mm=(*block.size_mm, block.height_mm),
        plain_size_mm=(*plain.size_mm, plain.height_mm),
        corrected_size_mm=(*corrected.size_mm, corrected.height_mm),
        file_size_mm=(*corrected.file.size_mm, corrected.file.height_mm),
        relief_mm=block.relief_mm,
        plain_relief_mm=plain.relief_mm,
        corrected_relief_mm=corrected.relief_mm,
        plain=errors[0],
        corrected=errors[1],
        free=errors[2],
        waves=tuple(sorted(waves, key=lambda wave: -wave.amplitude_mm)),
    )


def _note(factor: float, f: float, g: float, model: PrinterModel, correctable: bool) -> str:
    if not correctable:
        narrow = math.hypot(f, g) > math.pi / model.nozzle_mm
        return "narrower than the nozzle" if narrow else "lost by the printer"
    return f"limit {MAX_FACTOR:g}" if not 1.001 / MAX_FACTOR < factor < 0.999 * MAX_FACTOR else ""
