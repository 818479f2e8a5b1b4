"""The figures of the first screen of a report: a summary, and a frame of each texture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.conclusions import TOLD_APART
from tacbench_cad.lab.analysis.figures import COLOURS, INK, PAGE_IN, new_figure, save, styled
from tacbench_cad.lab.analysis.report.facts import press_words
from tacbench_cad.lab.analysis.report.results import UNSEEN, Results
from tacbench_cad.lab.analysis.variance.cells import short_texture
from tacbench_cad.lab.analysis.variance.figure_parts import squared_unit
from tacbench_cad.lab.analysis.variance.variance_figures import MAX_OVER_ESTIMATE, table_legend, table_panel
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.press_table import read_frame
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
    if (results.cells["variance"] > 0.0).any():
        panels["variance over prints and repeats, by texture"] = _draw_variance
    if results.confusion:
        panels[f"{press_words(results.design)[1]} predicted correctly, by texture"] = _draw_recall
    if not panels:
        return ""
    handles: list[Any] = []
    with styled():
        figure = new_figure(PAGE_IN, 2.5)
        for axes, draw in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.values(), strict=True):
            handles += draw(axes, results)
            axes.set_xlabel("texture")
            if len(results.design.textures) > 10:
                axes.tick_params(axis="x", rotation=90, labelsize=5.5)
        figure.legend(handles=handles, loc="outside upper left", ncols=5, fontsize=6.5)
        save(figure, folder / SUMMARY, results.design.simulated)
    intervals = bool(results.textures[["low", "recall_low"]].notna().to_numpy().any())
    bars = " Bars: 95 % intervals with prints as their unit." if intervals else ""
    return f"{'; '.join(panels).capitalize()}.{bars}"


def _draw_variance(axes: Axes, results: Results) -> list[Any]:
    """Draw the variance of each texture and printer at the quoted level; return the handles of the legend."""
    variance, level, combinations = results.variance, results.level, results.design.combinations
    assert variance is not None and level is not None  # because there are cells
    table_panel(axes, variance, level, combinations, MAX_OVER_ESTIMATE * results.cells["variance"].max())
    axes.set_ylabel(f"variance ({squared_unit(variance)})")
    axes.set_title(results.design.level_name(level), loc="left")
    return table_legend(variance, combinations)


def _draw_recall(axes: Axes, results: Results) -> list[Any]:
    """Draw how many presses of each texture the first estimator predicts correctly at the quoted hold-out level."""
    assert results.leak_free is not None  # because there is a confusion matrix
    names = results.design.textures
    rows = results.textures.dropna(subset="recall").drop_duplicates("texture")
    places = [names.index(name) for name in rows["texture"]]
    recall, low, high = (100.0 * rows[name].astype(float) for name in ("recall", "recall_low", "recall_high"))
    axes.vlines(places, low, high, color=COLOURS[2], linewidth=1.2)
    axes.plot(places, recall, "o", color=COLOURS[2], markersize=4.5)
    line: dict[str, Any] = {"color": INK, "linewidth": 0.7}
    chance = results.leak_free.record.chance
    handles = [axes.axhline(100.0 * chance, **line, linestyle=(0, (1, 2)), label="chance")]
    if results.hold_out == UNSEEN:
        apart = "told apart if above"
        handles.append(axes.axhline(100.0 * TOLD_APART, **line, linestyle=(0, (5, 3)), label=apart))
    axes.set_xticks(range(len(names)), [short_texture(name) for name in names])
    axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(0.0, 103.0), ylabel="predicted correctly (%)")
    axes.set_title(results.shown_hold_out.removeprefix("on "), loc="left")
    return handles


def draw_frames(results: Results, folder: Path) -> str:
    """Draw a frame of each texture at the largest force.

    Returns:
        The caption; empty if no frame can be drawn.
    """
    design = results.design
    textures, level = design.textures[:MAX_FRAMES], design.levels[-1]
    bad = {str(report.folder.absolute() / finding.where) for report in results.reports for finding in report.findings}
    presses = design.presses[design.presses["level"] == level]
    presses = presses.assign(bad=presses["frame"].isin(bad)).sort_values("bad", kind="stable")
    found = {name: _first_frame(presses[presses["texture"] == name]) for name in textures}
    frames = {name: frame for name, frame in found.items() if frame is not None}
    if not frames:
        return ""
    with styled():
        _draw_sheet(frames, folder / FRAMES, design.simulated)
    at = f" at {design.level_name(level)}" if level and design.has("force") else ""
    caption = f"A frame of each texture: the first {press_words(design)[0]}{at} without a problem, if there is one."
    if len(frames) < len(textures):
        caption += f" No frame of {', '.join(name for name in textures if name not in frames)} can be read."
    more = f" The first {MAX_FRAMES} of {len(design.textures)} are shown."
    return caption + (more if len(design.textures) > MAX_FRAMES else "")


def _first_frame(presses: pd.DataFrame) -> Frame | None:
    """Return the first frame that can be read, reduced in size; None if it cannot be drawn."""
    import cv2

    for path in presses["frame"]:
        try:
            frame = read_frame(path)
        except CheckFailedError:
            continue
        if frame.ndim != 2 and not is_image(frame):
            return None
        frame = frame if is_image(frame) else frame.astype(np.float32)
        factor = min(1.0, _SIDE_PX / max(frame.shape[:2]))
        return np.asarray(cv2.resize(frame, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA))
    return None


def _draw_sheet(frames: Mapping[str, Frame], stem: Path, simulated: Sequence[str]) -> None:
    """Draw frames beside each other, with the same colour scale."""
    columns = min(_COLUMNS, len(frames))
    rows = math.ceil(len(frames) / columns)
    ratio = max(frame.shape[0] / frame.shape[1] for frame in frames.values())
    width = min(PAGE_IN / columns, 1.8)
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
    save(figure, stem, simulated)
