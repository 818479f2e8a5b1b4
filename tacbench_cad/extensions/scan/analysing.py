"""From a scan to its result: find the block, fit the scan, and compute all numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from tacbench_cad.extensions.scan.cloud import Cloud, HeightGrid
from tacbench_cad.extensions.scan.deviations import TopMap, noise_of_flat, noise_of_repeat, top_map, wall_points
from tacbench_cad.extensions.scan.estimates import Fit
from tacbench_cad.extensions.scan.fitting import fit_scan, identify
from tacbench_cad.extensions.scan.limits import Limits
from tacbench_cad.extensions.scan.result import Noise, PrintOrigin, ScanResult
from tacbench_cad.extensions.scan.roughness import roughness
from tacbench_cad.spec import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.packages import why_missing
from tacbench_cad.util.text import counted
from tacbench_cad.util.types import Floats

#: The usual layer height of slicers, in mm.
LAYER_MM = 0.2
#: A plate whose points scatter more than those of the print by this factor is not flat.
_MAX_FLAT = 3.0
#: Receives progress updates: the step, and the fraction of it that is done.
Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """The options of an analysis.

    Args:
        fit: What is fitted besides the pose.
        layer_mm: The height of a layer, from which a crest counts as lost.
        limits: The limits of the verdict.
        origin: What is known about the print.
        repeat: A second scan of the same print, for the noise; None for no such scan.
        flat: The scan of a flat plate by the same scanner, for the noise.
        notes: Sentences about the file.
    """

    fit: Fit = "scale"
    layer_mm: float = LAYER_MM
    limits: Limits = field(default_factory=Limits)
    origin: PrintOrigin = field(default_factory=PrintOrigin)
    repeat: Cloud | None = None
    flat: Cloud | None = None
    notes: tuple[str, ...] = ()


def analyse(
    cloud: Cloud, blocks: Sequence[Block], options: ScanOptions | None = None, progress: Progress = lambda *_: None
) -> ScanResult:
    """Compare a scan with its formula.

    Args:
        cloud: The scan.
        blocks: The blocks that the scan may show.
        options: The options; None for the defaults.
        progress: Receives progress updates.

    Raises:
        InputError: The scan shows none of the blocks, or too little of one; or the second scan has the same points, or
            the plate is not flat.
    """
    chosen = options or ScanOptions()
    if chosen.repeat is not None and chosen.flat is not None:
        raise InputError("flat", chosen.flat.source, "cannot be combined with a repeated scan; leave out one of them")
    if chosen.repeat is not None and np.array_equal(chosen.repeat.points_mm, cloud.points_mm):
        raise InputError("repeat", chosen.repeat.source, "has the same points as the scan; scan the print once more")
    progress("finding the block", 0.0)
    block, fit = identify(cloud, blocks) if len(blocks) != 1 else (blocks[0], None)
    if fit is None or fit.fit != chosen.fit:
        fit = fit_scan(cloud, block, chosen.fit, progress=progress)
    progress("computing the deviation", 0.0)
    top = top_map(cloud, block, fit, layer_mm=chosen.layer_mm)
    noise = _noise(cloud, block, top, chosen, progress)
    progress("computing the roughness", 0.0)
    surfaces, missing = _roughness(top)
    notes = [*chosen.notes, *missing]
    if fit.alternatives:
        others = counted(len(fit.alternatives), "other pose")
        notes.append(
            f"The scan fits the block in {others} as well, after half a turn or after a shift by a wavelength: scan a "
            "keyed corner, a wall, or more of the top."
        )
    return ScanResult(
        cloud=cloud,
        block=block,
        fit=fit,
        top=top,
        walls=wall_points(cloud, block, fit),
        noise=noise,
        limits=chosen.limits,
        origin=chosen.origin,
        roughness=surfaces,
        notes=tuple(notes),
    )


def _noise(cloud: Cloud, block: Block, top: TopMap, options: ScanOptions, progress: Progress) -> Noise:
    if options.repeat is not None:
        progress("fitting the repeated scan", 0.0)
        again = fit_scan(options.repeat, block, options.fit, progress=progress)
        second = top_map(options.repeat, block, again, layer_mm=options.layer_mm, cell_mm=top.cell_mm)
        return Noise(rms_mm=noise_of_repeat(top, second), source="repeat")
    if options.flat is not None:
        single = noise_of_flat(options.flat)
        if 0.0 < _MAX_FLAT * top.noise_mm < single:
            allowed = (
                f"its points are {1000.0 * single:.3g} µm (rms) from their plane, but those of the scan only "
                f"{1000.0 * top.noise_mm:.3g} µm from the print; scan a flat plate in the same way as the print"
            )
            raise InputError("flat", options.flat.source, allowed)
        return Noise(rms_mm=top.noise_rms_mm * single / top.noise_mm if top.noise_mm > 0.0 else single, source="flat")
    return Noise(rms_mm=top.noise_rms_mm, source="residuals")


def _roughness(top: TopMap) -> tuple[dict[str, dict[str, object]], tuple[str, ...]]:
    """Return the ISO 25178 parameters of the top and of its error, and why they are missing."""
    reason = why_missing("surfalize")
    if reason:
        return {}, (f"No roughness by ISO 25178: {reason}.",)
    steps = (float(top.x_mm[1] - top.x_mm[0]), float(top.y_mm[1] - top.y_mm[0]))
    surfaces: dict[str, dict[str, object]] = {}
    for name, heights in (("texture", top.printed_mm), ("residual", top.height_error_mm)):
        try:
            values = roughness(HeightGrid(heights_mm=_cropped(np.where(top.inside, heights, np.nan)).T, step_mm=steps))
        except InputError as error:
            return surfaces, (f"No roughness by ISO 25178: {error}.",)
        surfaces[name] = asdict(values)
    return surfaces, ()


def _cropped(heights: Floats) -> Floats:
    known = np.isfinite(heights)
    (i,), (j,) = np.nonzero(known.any(axis=1)), np.nonzero(known.any(axis=0))
    return heights[i[0] : i[-1] + 1, j[0] : j[-1] + 1] if len(i) else np.full((1, 1), math.nan)
