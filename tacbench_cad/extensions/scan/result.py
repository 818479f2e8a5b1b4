"""The result of a scan: all numbers about a print, as a table, as JSON, and compared with the limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from tacbench_cad import __version__
from tacbench_cad.extensions.scan.cloud import Cloud
from tacbench_cad.extensions.scan.comparison import Views
from tacbench_cad.extensions.scan.deviations import Summary, TopMap, WallPoints
from tacbench_cad.extensions.scan.estimates import Estimate, ScanFit, WaveEstimate
from tacbench_cad.extensions.scan.limits import Limits, Verdict, verdict
from tacbench_cad.extensions.scan.record import KIND, SCHEMA
from tacbench_cad.spec import Block, Extrema
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.text import counted, short

#: The source of the noise: the fit's residuals, a second scan of the print, or the scan of a flat plate.
NoiseSource = Literal["residuals", "repeat", "flat"]
_NOISE_WORDS = {"residuals": "estimated from this scan", "repeat": "from the repeated scan", "flat": "from the flat"}


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The noise of the scanner in the map of the top.

    Args:
        rms_mm: The root mean square of the noise of a cell.
        source: Where the number comes from.
    """

    rms_mm: float
    source: NoiseSource

    def fraction(self, whole: Summary | None) -> float | None:
        """Return the fraction of the top's mean square that is noise, at most 1; None if it is unknown."""
        if whole is None or not math.isfinite(self.rms_mm):
            return None
        return min(1.0, (self.rms_mm / whole.rms_mm) ** 2) if whole.rms_mm > 0.0 else 1.0


@dataclass(frozen=True, kw_only=True)
class PrintOrigin:
    """What is known about the print. Unknown values are None.

    Args:
        printer: The printer.
        filament: The filament.
        copy: The copy.
        nozzle_mm: The diameter of the nozzle.
        printed_from: The name of the block in the printed file, if it differs from the block.
    """

    printer: str | None = None
    filament: str | None = None
    copy: int | str | None = None
    nozzle_mm: float | None = None
    printed_from: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanResult:
    """A scan compared with its formula.

    Args:
        cloud: The scan.
        block: The block.
        fit: The fit of the scan to the block.
        top: The map of the top.
        walls: The deviations of the walls.
        noise: The noise in the map.
        limits: The limits.
        origin: The printer and the filament.
        roughness: The ISO 25178 parameters, by the surface that they describe; empty if they were not computed.
        notes: Sentences about the scan that a reader has to know.
        comparison: The comparison with the G-code of the print; None if there is none.
    """

    cloud: Cloud
    block: Block
    fit: ScanFit
    top: TopMap
    walls: WallPoints
    noise: Noise
    limits: Limits = field(default_factory=Limits)
    origin: PrintOrigin = field(default_factory=PrintOrigin)
    roughness: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    comparison: Views | None = None

    @cached_property
    def verdict(self) -> Verdict:
        """The numbers compared with the limits."""
        return verdict(self._limited, self.limits)

    @cached_property
    def _limited(self) -> dict[str, float | None]:
        top, walls = self.top.summary, self.walls.summary
        scales = [e.value for e in map(self._known, ("scale_x", "scale_y", "scale_z")) if e is not None]
        ratios = [wave.amplitude_ratio for wave in self.fit.waves if wave.determined and not wave.is_scale_reference]
        extrema = (self.top.peaks, self.top.valleys)
        count = sum(each.count for each in extrema)
        skew = self._known("skew_xy")
        return {
            "pin_shift_px": self.top.pin_shift_px,
            "top_rms_mm": top.rms_mm if top else None,
            "top_95_mm": top.within_95_mm if top else None,
            "top_largest_mm": top.largest_mm if top else None,
            "wall_95_mm": walls.within_95_mm if walls else None,
            "wall_outward_mm": self.walls.outward_95_mm,
            "scale_error": max((abs(scale - 1.0) for scale in scales), default=None),
            "skew_deg": abs(math.degrees(math.atan(skew.value))) if skew else None,
            "height_error_mm": None if self.height_error_mm is None else abs(self.height_error_mm),
            "lost_fraction": sum(each.missed for each in extrema) / count if count else None,
            "amplitude_error": max((abs(ratio - 1.0) for ratio in ratios), default=None),
            "unseen_fraction": 1.0 - self.top.seen_fraction,
        }

    def _known(self, name: str) -> Estimate | None:
        return next((p for p in self.fit.parameters if p.name == name and p.determined), None)

    @property
    def height_error_mm(self) -> float | None:
        """How much higher the print is than the block; None if the scan does not show its lower end."""
        base = self._known("base_mm")
        if base is None:
            return None
        return base.value + float(self.fit.pose.stretch[2, 2]) * self.block.relief_mm - self.block.height_mm

    def as_dict(self) -> dict[str, Any]:
        """Return the values for JSON: lengths in mm, fractions from 0 to 1."""
        top = self.top
        return {
            "kind": KIND,
            "schema": SCHEMA,
            "version": __version__,
            "file": self.cloud.source,
            "simulated": self.cloud.simulated,
            "block": self.block.name,
            **to_plain(self.origin),
            "geometry": self._geometry,
            "ok": self.verdict.ok,
            "verdict": str(self.verdict),
            "checks": [{**to_plain(check), "ok": check.ok} for check in self.verdict.checks],
            "fit": self.fit.fit,
            "points": len(self.cloud),
            "points_used": int(self.fit.used.sum()),
            "half_turn": self.fit.half_turn,
            "seen_fraction": top.seen_fraction,
            "cell_mm": top.cell_mm,
            "parameters": [_finite(parameter, PARAMETER_COLUMNS) for parameter in self.fit.parameters],
            "height_error_mm": self.height_error_mm,
            "top": to_plain(top.summary),
            "walls": to_plain(self.walls.summary),
            "wall_outward_mm": self.walls.outward_95_mm,
            "pin_shift_px": top.pin_shift_px,
            "peaks": to_plain(top.peaks),
            "valleys": to_plain(top.valleys),
            "layer_mm": top.layer_mm,
            "noise": {**to_plain(self.noise), "fraction": self.noise.fraction(top.summary)},
            "waves": [wave_row(wave) for wave in self.fit.waves],
            "roughness": to_plain(self.roughness),
            "notes": list(self.notes),
            **({} if self.comparison is None else {"comparison": self.comparison.as_dict()}),
        }

    @property
    def _geometry(self) -> dict[str, Any]:
        block = self.block
        sides = [*block.size_mm, block.height_mm]
        return {"size_mm": sides, "base_mm": block.base_mm, "datum_mm": block.datum_mm, "relief_mm": block.relief_mm}

    def rows(self) -> Iterator[tuple[str, str, str]]:
        """Yield the rows of the table: the name, the value, and its interval or a remark."""
        turn = "" if self.fit.half_turn == "decided" else "the scan does not show a half turn"
        yield "points", f"{int(self.fit.used.sum()):,} of {len(self.cloud):,} used", turn
        yield "top scanned", f"{100.0 * self.top.seen_fraction:.0f} %", f"cells of {self.top.cell_mm:.2g} mm"
        for parameter in self.fit.parameters:
            if row := _parameter_row(parameter):
                yield row
        if self.height_error_mm is not None:
            height_mm = self.height_error_mm + self.block.height_mm
            yield "height", f"{height_mm:.3f} mm", _um(self.height_error_mm, "+.0f")
        yield from _summary_rows("top", self.top.summary)
        if (fraction := self.noise.fraction(self.top.summary)) is not None:
            words = f"{short(100.0 * fraction)} % of the mean square, {_NOISE_WORDS[self.noise.source]}"
            yield "  scanner's noise, rms", f"{short(1000.0 * self.noise.rms_mm)} µm", words
        yield from _summary_rows("walls", self.walls.summary)
        if self.walls.outward_95_mm is not None:
            yield "  outside of the nominal walls", _um(self.walls.outward_95_mm, "+z.0f"), "95 % of the points"
        yield "crests lost", *_extrema_cells(self.top.peaks, -1.0)
        yield "valleys filled", *_extrema_cells(self.top.valleys, 1.0)
        if self.top.pin_shift_px is not None:
            yield "shift of the sensor's pins, rms", f"{short(self.top.pin_shift_px)} px", "of a TacTip, computed"
        for surface, values in self.roughness.items():
            heights = ", ".join(short(values[name]) for name in ("sa_um", "sq_um", "sz_um"))
            shape = f"{short(values['ssk'])}, {short(values['sku'])}, {short(values['sdr_percent'])} %"
            yield f"{surface}: Sa, Sq, Sz", f"{heights} µm", "ISO 25178"
            yield "  Ssk, Sku, Sdr", shape, ""


def _um(mm: float, form: str = ".0f") -> str:
    return f"{1000.0 * mm:{form}} µm"


#: The numbers of a parameter.
PARAMETER_COLUMNS = ("name", "value", "standard_error", "low", "high", "determined")
#: The columns of ``waves.csv``.
WAVE_COLUMNS = (
    *("wavelength_mm", "direction_deg", "amplitude_mm", "amplitude_ratio", "standard_error", "ratio_low", "ratio_high"),
    *("phase_deg", "phase_low_deg", "phase_high_deg", "determined"),
)


def wave_row(wave: WaveEstimate) -> dict[str, Any]:
    """Return a printed wave as plain values with the keys of :data:`WAVE_COLUMNS`; None for an unknown number."""
    return _finite(wave, WAVE_COLUMNS)


def _finite(estimate: Estimate | WaveEstimate, names: tuple[str, ...]) -> dict[str, Any]:
    """Return some values of an estimate, with None for numbers that are not finite."""
    values = {name: getattr(estimate, name) for name in names}
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


_FACES = {"base": "base below the lowest valley", "wall": "walls, outside of the scaled block"}


def _parameter_row(parameter: Estimate) -> tuple[str, str, str] | None:
    """Return the row of a parameter of the print; None for one of the pose."""
    kind, _, axis = parameter.name.partition("_")
    if kind not in ("scale", "skew", "base", "wall"):
        return None
    name = f"{kind} along {axis}" if kind == "scale" else f"skew {axis}" if kind == "skew" else _FACES[kind]
    if not parameter.determined:
        return name, "not determined", "the scan does not show it"
    low, high = parameter.low, parameter.high
    if kind == "scale":
        shrinkage = f"{100.0 * (1.0 - parameter.value):+z.3f} % shrinkage ({100.0 * (1.0 - high):+z.3f} to "
        return name, f"{parameter.value:.5f}", f"{shrinkage}{100.0 * (1.0 - low):+z.3f})"
    if kind == "skew":
        value, low, high = (math.degrees(math.atan(number)) for number in (parameter.value, low, high))
        return name, f"{value:+z.3f} degrees", f"{low:+z.3f} to {high:+z.3f}"
    if kind == "wall":
        value, low, high = (1000.0 * number for number in (parameter.value, low, high))
        return name, f"{value:+z.1f} µm", f"{low:+z.1f} to {high:+z.1f}"
    return name, f"{parameter.value:z.4f} mm", f"{low:z.4f} to {high:z.4f}"


def _summary_rows(name: str, summary: Summary | None) -> Iterator[tuple[str, str, str]]:
    if summary is None:
        yield name, "not scanned", ""
        return
    yield f"{name}: deviation, rms", _um(summary.rms_mm), f"mean {_um(summary.mean_mm, '+z.0f')}"
    yield "  95 % are within", _um(summary.within_95_mm), f"largest {_um(summary.largest_mm)}"


def _extrema_cells(extrema: Extrema, above: float) -> tuple[str, str]:
    if extrema.count == 0:
        return "none seen", ""
    mean, worst = (round(1000.0 * above * error) for error in (extrema.mean_mm, extrema.worst_mm))
    return f"{extrema.missed} of {extrema.count}", f"mean error {mean:+d} µm, worst {worst:+d} µm"


def wave_table(waves: tuple[WaveEstimate, ...]) -> list[tuple[str, ...]]:
    """Return the rows of the table of printed waves, beginning with the largest wave of the formula."""
    rows: list[tuple[str, ...]] = []
    for wave in sorted(waves, key=lambda wave: -wave.amplitude_mm):
        first = (f"{wave.wavelength_mm:.2f}", f"{wave.direction_deg:+z.0f}", f"{1000.0 * wave.amplitude_mm:.0f}")
        ratio, phase = f"{wave.ratio_low:.3f} to {wave.ratio_high:.3f}", f"{wave.phase_low_deg:+z.1f}"
        printed = (
            f"{wave.amplitude_ratio:.3f}",
            "sets the scale" if wave.is_scale_reference else ratio,
            f"{wave.phase_deg:+z.1f}",
            "sets the position" if wave.is_shift_reference else f"{phase} to {wave.phase_high_deg:+z.1f}",
        )
        rows.append((*first, *(printed if wave.determined else ("not determined", "", "", ""))))
    return rows


def described(result: ScanResult) -> str:
    """Return a title: what was scanned, and whether it was simulated."""
    simulated = "simulated scan of " if result.cloud.simulated else ""
    return f"{simulated}{result.block.name}, {counted(len(result.cloud), 'point')}"
