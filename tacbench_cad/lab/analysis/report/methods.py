"""The methods of a study in words that can go into a paper, and how the paper's open points were read."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.report.cite import PAPER, PROGRAM
from tacbench_cad.lab.analysis.variance.view import VarianceView
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.text import counted


@dataclass(frozen=True, kw_only=True)
class OpenPoint:
    """An open point of the paper and how it was read.

    Args:
        point: What the text leaves open.
        taken: What was taken here.
        option: What leads to the other reading.
    """

    point: str
    taken: str
    option: str


def design_text(collection: Collection) -> str:
    """What was pressed on what, and how: a paragraph."""
    first = collection.info
    protocol, block = first.protocol, first.printed.block
    x, y = block.size_mm
    sampling = (
        f"within {block.sampling.mm:g} mm of the formula"
        if isinstance(block.sampling, Tolerance)
        else f"on a grid of {block.sampling.nx} x {block.sampling.ny} samples"
    )
    sentences = [
        f"Blocks with {counted(len(collection.textures), 'texture')} ({', '.join(collection.textures)}; preset "
        f"{block.preset}, scale {block.scale:g}, {x:.4g} x {y:.4g} x {block.height_mm:.4g} mm, made {sampling}) [1, 2] "
        f"were printed as follows: {prints_text(collection)}."
    ]
    sentences += [_press_text(collection), _forces_text(collection)]
    if protocol.stationary_frames:
        sentences.append(
            f"At the start and at the end of each block: {counted(protocol.stationary_frames, 'reading')} without "
            "motion in contact, and as many without contact."
        )
    shape = " x ".join(map(str, first.frame_shape or ())) or "unknown"
    sentences.append(
        f"Sensor: {first.sensor.get('name', 'not named')} (readings of shape {shape} in {collection.units}); stage: "
        f"{_devices(collection, 'stage')}; force gauge: {_devices(collection, 'gauge')}. The holder's top lay "
        f"{first.holder.rim_mm:g} mm below the blocks' highest point."
    )
    return " ".join(sentences)


def prints_text(collection: Collection) -> str:
    """The prints of each printer-filament, in words."""
    groups: dict[str, dict[str, set[int]]] = defaultdict(lambda: defaultdict(set))
    for run in collection.runs:
        printed = run.info.printed
        groups[printed.combination][printed.texture].add(printed.copy)
    parts = []
    for combination in collection.combinations:
        counts = sorted({len(copies) for copies in groups[combination].values()})
        prints = counted(counts[0], "print") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} prints"
        parts.append(
            f"{prints} of {counted(len(groups[combination]), 'texture')} on {combination.replace('_', ' in ')}"
        )
    return "; ".join(parts)


def variance_text(view: VarianceView) -> str:
    """How the variance table was computed: a paragraph."""
    settings = view.settings
    images = "images" if view.collection.units == "counts" else "readings"
    grey = "" if settings.colour or images != "images" else " (BT.601)"
    colour = f"{images} in colour" if settings.colour else f"grey {images}{grey}" if grey else images
    size = "at full size" if settings.resolution == 1.0 else f"at {settings.resolution:.3g} of their width and height"
    sources = sorted({cell.floor_from for cell in view.cells if cell.floor_from})
    return (
        f"The variance table was computed on {colour} {size}: variance of each pixel over prints and repeats at each "
        f"position (ddof = {settings.ddof}), then the mean over pixels and positions, for each force; the pooled "
        f"figure is the mean of the forces' figures. The noise floor comes from {' and '.join(sources) or 'nowhere'}. "
        "The 95 % intervals have prints as their unit (fiducial generalized confidence intervals of the nested design, "
        "with the effective number of independent pixels estimated from the prints). Components are nested "
        "analysis-of-variance estimates (repeat within print, print within printer, printer, texture). Printers were "
        "compared by permuting prints, with p values adjusted for all pairs of a force (Holm). Seed of all random "
        f"numbers: {settings.seed}."
    )


def software_text(collection: Collection) -> str:
    """The last sentences: program, what was simulated."""
    sentences = [f"Everything was computed with tacbench-cad {__version__} [2]."]
    if collection.simulated:
        sentences.insert(0, f"These are simulated data ({'; '.join(collection.simulated)}).")
    return " ".join(sentences)


def references_text() -> tuple[str, ...]:
    """The references that the paragraphs name, in their order."""
    return (f"[1] {PAPER.text}", f"[2] {PROGRAM.text}")


def open_points(collection: Collection, colour: bool, ddof: int) -> tuple[OpenPoint, ...]:
    """Where the paper's text leaves something open, and what was taken."""
    info = collection.info
    spacing = {
        "even": "18 to 23 mm in 1.25 mm steps",
        "1mm": "18 to 22 mm in 1 mm steps",
    }.get(info.grid_spacing, f"the study's own grid, {counted(len(info.protocol.grid.positions_mm), 'position')}")
    presets = {"paper": "the text's 23.3 x 30 mm", "released": "the released files' 29.3 x 30 mm"}
    levels = ", ".join(map(str, collection.levels))
    return (
        OpenPoint(
            point="size and scale of the block: the text's numbers cannot all hold",
            taken=f"preset {info.printed.block.preset}: {presets.get(info.printed.block.preset, 'its own size')}",
            option="tacbench make --preset paper|released",
        ),
        OpenPoint(point='"5 equally spaced 1 mm positions between 18 and 23 mm"', taken=spacing, option="grid_spacing"),
        OpenPoint(
            point="variance of grey or colour images",
            taken="colour" if colour else "grey (BT.601)",
            option="--colour",
        ),
        OpenPoint(point="divisor of the variance (ddof)", taken=str(ddof), option="--ddof 0|1"),
        OpenPoint(
            point="force of the 300 images of a cell",
            taken=f"each of the levels {levels}, and their mean",
            option="force_level in variance.csv",
        ),
    )


def counts_rows(collection: Collection) -> list[dict[str, object]]:
    """What there is: prints and presses of each printer-filament and texture at each force level."""
    rows: list[dict[str, object]] = []
    for combination in collection.combinations:
        for texture in collection.textures:
            there = (collection.combination == combination) & (collection.texture == texture)
            if there.any():
                printer, filament = combination.split("_", 1)
                levels = collection.level[there]
                counts = {f"presses_level_{level}": int((levels == level).sum()) for level in collection.levels}
                copies = len(set(collection.copy[there].tolist()))
                rows.append({"printer": printer, "filament": filament, "texture": texture, "prints": copies, **counts})
    return rows


def _press_text(collection: Collection) -> str:
    protocol = collection.info.protocol
    grid = protocol.grid
    order = "in the same order" if protocol.order == "paper" else f"in random order (seed {protocol.seed})"
    return (
        f"Each block was pressed at {counted(len(grid.positions_mm), 'position')} ({len(grid.x_mm)} x "
        f"{len(grid.y_mm)}; x from {grid.x_mm[0]:g} to {grid.x_mm[-1]:g} mm, y from {grid.y_mm[0]:g} to "
        f"{grid.y_mm[-1]:g} mm of the block), {order}, {counted(protocol.repeats, 'time')} at each force: "
        f"{counted(len(collection), 'press')} in all."
    )


def _forces_text(collection: Collection) -> str:
    protocol = collection.info.protocol
    if protocol.contact == "depth":
        depths = ", ".join(f"{protocol.depths_mm[level - 1]:g}" for level in collection.levels)
        how = {
            "gauge": "found by the force gauge",
            "sensor": "found by a change of the sensor",
            "taught": "taught by hand",
        }
        return (
            f"The sensor's summit went {depths} mm below first touch ({how[protocol.touch]}); no force was controlled, "
            "so the readings cannot be compared with those at the paper's forces."
        )
    forces = ", ".join(f"{protocol.forces_n[n - 1]:.6g} ± {protocol.bands_n[n - 1]:.3g}" for n in collection.levels)
    measured = [_measured(collection, level) for level in collection.levels]
    text = f"Target forces were {forces} N"
    if all(force is not None for force in measured):
        shown = ", ".join(f"{mean:.4f} (SD {sd:.2g})" for mean, sd in (force for force in measured if force))
        text += f"; measured just before the reading: {shown} N"
    return text + "."


def _measured(collection: Collection, level: int) -> tuple[float, float] | None:
    """Mean and standard deviation of the measured force, None where it was not measured."""
    forces = [
        row.measured_force_n
        for run in collection.runs
        for row in run.rows
        if row.force_level == level and row.measured_force_n is not None
    ]
    return (float(np.mean(forces)), float(np.std(forces, ddof=1))) if len(forces) > 1 else None


def _devices(collection: Collection, what: str) -> str:
    """The stages, or gauges, of all runs in words."""
    devices = [run.info.stage if what == "stage" else run.info.gauge for run in collection.runs]
    words = [
        "simulated" if device.get("simulated") else str(device.get("identity") or "not recorded") for device in devices
    ]
    return ", ".join(dict.fromkeys(words))
