"""The figures of the first screen of a report: a summary, and a frame of each texture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.conclusions import TOLD_APART
from tacbench_cad.lab.analysis.figures import COLOURS, INK, PAGE_IN, new_figure, save, styled
from tacbench_cad.lab.analysis.report.facts import press_words
from tacbench_cad.lab.analysis.report.results import UNSEEN, Results
from tacbench_cad.lab.analysis.tables import records
from tacbench_cad.lab.analysis.variance.cells import name_of, short_texture
from tacbench_cad.lab.analysis.variance.variance_figures import MAX_OVER_ESTIMATE, draw_point, log_axes, look_of
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.util.errors import CheckFailedError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The names of the figures' files.
SUMMARY, FRAMES = "summary", "frames"
#: The largest number of frames in the figure, the number of frames in a row, and the longer side of each, in pixels.
MAX_FRAMES, _COLUMNS, _SIDE_PX = 24, 6, 240


def draw_summary(results: Results, folder: Path) -> str:
    """Draw the variance of each texture, and how often each texture is predicted correctly.

    Returns:
        The caption; empty if there is nothing to draw.
    """
    panels = {}
    if results.level is not None and any(cell.variance > 0.0 for cell in results.cells_at(results.level)):
        panels["variance over prints and repeats, by texture"] = _draw_variance
    if results.confusion:
        panels[f"{press_words(results.collection)[1]} predicted correctly, by texture"] = _draw_recall
    if not panels:
        return ""
    with styled():
        figure = new_figure(PAGE_IN, 2.5)
        for axes, draw in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.values(), strict=True):
            draw(axes, results)
            axes.set_xlabel("texture")
            if len(results.collection.textures) > 10:
                axes.tick_params(axis="x", rotation=90, labelsize=5.5)
        handles = [handle for axes in figure.axes for handle in axes.get_legend_handles_labels()[0]]
        if handles:
            figure.legend(handles=handles, loc="outside upper left", ncols=5, fontsize=6.5)
        save(figure, folder / SUMMARY, results.collection.simulated)
    intervals = bool(results.textures[["low", "recall_low"]].notna().to_numpy().any())
    bars = " Bars: 95 % intervals with prints as their unit." if intervals else ""
    return f"{'; '.join(panels).capitalize()}.{bars}"


def _draw_variance(axes: Axes, results: Results) -> None:
    """Draw the variance of each texture and printer at the quoted level, and the variance from sensor noise alone."""
    assert results.variance is not None and results.level is not None  # because there are cells
    study, cells = results.collection, results.cells_at(results.level)
    step = 0.8 / len(study.combinations)
    top = MAX_OVER_ESTIMATE * max(cell.variance for cell in cells)
    for i, combination in enumerate(study.combinations):
        for cell in (cell for cell in cells if cell.combination == combination):
            x = study.textures.index(cell.texture) + (i - (len(study.combinations) - 1) / 2.0) * step
            draw_point(axes, cell, x, step, look_of(i), top)
        if study.has("printer") or study.has("filament"):
            axes.plot([], [], **look_of(i), linestyle="", markersize=4.0, label=name_of(combination))
    if any(cell.noise_alone for cell in cells):
        axes.plot([], [], color=INK, linewidth=1.0, label="sensor noise alone")
    log_axes(axes, [short_texture(texture) for texture in study.textures])
    axes.set_ylabel(f"variance ({results.variance.unit.replace('^2', '$^2$')})")
    axes.set_title(study.pressing.level_name(results.level), loc="left")


def _draw_recall(axes: Axes, results: Results) -> None:
    """Draw how many presses of each texture the first estimator predicts correctly at the quoted hold-out level."""
    assert results.leak_free is not None  # because there is a confusion matrix
    names = results.collection.textures
    rows = {row["texture"]: row for row in records(results.textures)}
    for x, row in enumerate(rows[name] for name in names):
        if row["recall"] is None:
            continue
        if row["recall_low"] is not None:
            axes.plot([x, x], [100.0 * row["recall_low"], 100.0 * row["recall_high"]], color=COLOURS[2], linewidth=1.2)
        axes.plot(x, 100.0 * row["recall"], "o", color=COLOURS[2], markersize=4.5)
    lines = {"chance": results.leak_free.chance}
    if results.hold_out == UNSEEN:
        lines["told apart if above"] = TOLD_APART
    for i, (label, fraction) in enumerate(lines.items()):
        axes.axhline(100.0 * fraction, color=INK, linewidth=0.7, linestyle=((0, (1, 2)), (0, (5, 3)))[i], label=label)
    axes.set_xticks(range(len(names)), [short_texture(name) for name in names])
    axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(0.0, 103.0), ylabel="predicted correctly (%)")
    axes.set_title(results.shown_hold_out.removeprefix("on "), loc="left")


def draw_frames(results: Results, folder: Path) -> str:
    """Draw a frame of each texture at the largest force.

    Returns:
        The caption; empty if no frame can be drawn.
    """
    textures = results.collection.textures
    level = results.collection.levels[-1]
    bad = {(r.folder, finding.where) for r in results.reports for finding in r.findings}
    frames, faulty = {}, []
    for name in textures[:MAX_FRAMES]:
        for frame, is_good in _readable_frame(results.collection, name, level, bad):
            frames[name] = frame
            faulty += [] if is_good else [name]
    if not frames:
        return ""
    columns = min(_COLUMNS, len(frames))
    rows = math.ceil(len(frames) / columns)
    ratio = max(frame.shape[0] / frame.shape[1] for frame in frames.values())
    width = min(PAGE_IN / columns, 1.8)
    with styled():
        figure = new_figure(width * columns, rows * (min(1.5, ratio) * width + 0.2))
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0.0, hspace=0.0)
        values = np.concatenate([frame.ravel() for frame in frames.values()])
        scale = {"vmin": np.nanmin(values), "vmax": np.nanmax(values)}
        if values.dtype == np.uint8:
            scale = {"vmin": 0, "vmax": 255, "cmap": "gray"}
        for axes, (name, frame) in zip(panels, frames.items(), strict=False):
            axes.imshow(frame[..., ::-1] if frame.ndim == 3 else frame, **scale)
            axes.set_title(name, fontsize=7.0, pad=2.0)
        for axes in panels:
            axes.set_axis_off()
        save(figure, folder / FRAMES, results.collection.simulated)
    study = results.collection
    at = f" at {study.pressing.level_name(level)}" if level and study.has("force") else ""
    caption = f"A frame of each texture: the first {press_words(study)[0]}{at} without a problem."
    without = [name for name in textures[:MAX_FRAMES] if name not in frames]
    caption += f" All frames of {', '.join(faulty)} have a finding of the check." if faulty else ""
    caption += f" No frame of {', '.join(without)} can be read." if without else ""
    return caption + (f" The first {MAX_FRAMES} of {len(textures)} are shown." if len(textures) > MAX_FRAMES else "")


def _readable_frame(
    study: Collection, texture: str, level: int, bad: set[tuple[Path, str]]
) -> Iterator[tuple[Frame, bool]]:
    """Yield a frame of a texture that can be drawn, reduced in size, and whether it is without a finding.

    It is the first frame without a finding, or the first of all that can be read; nothing if there is none.
    """
    import cv2

    def is_bad(at: int) -> bool:
        return (study.runs[int(study.run[at])].folder, study.paths(at)[0]) in bad

    for at in sorted(np.flatnonzero((study.texture == texture) & (study.level == level)).tolist(), key=is_bad):
        try:
            frame = study.frame(at)
        except CheckFailedError:
            continue
        if frame.ndim == 2 or is_image(frame):
            frame = frame if is_image(frame) else frame.astype(np.float32)
            factor = min(1.0, _SIDE_PX / max(frame.shape[:2]))
            small = cv2.resize(frame, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else frame
            yield small, not is_bad(at)
        return
