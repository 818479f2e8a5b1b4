"""The files of a comparison of two sensors: its table and its figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.lab.analysis.classification.splits import shown_level
from tacbench_cad.lab.analysis.compare import ALL_TEXTURES, Comparison
from tacbench_cad.lab.analysis.tables import write_csv

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write ``comparison.csv`` and ``comparison`` as PNG and PDF.

    Args:
        comparison: The comparison.
        folder: The folder, which must exist.

    Raises:
        InputError: A file cannot be written.
        MissingToolError: matplotlib is not installed.
    """
    from tacbench_cad.lab.analysis.figures import save, styled

    path = write_csv(folder / "comparison.csv", comparison.table, comparison.simulated)
    with styled():
        return [path, *save(draw_comparison(comparison), folder / "comparison", comparison.simulated)]


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw the accuracies on the left, and the differences of the recall of each texture on the right."""
    from tacbench_cad.lab.analysis.figures import COLOURS, INK, PAGE_IN, new_figure

    levels = list(dict.fromkeys(row.hold_out for row in comparison.rows))
    shown = {level: shown_level(level, comparison.unknown_groups) for level in levels}
    textures = comparison.a.record.textures
    figure = new_figure(PAGE_IN, 0.9 + max(2.4, 0.42 * len(levels) * max(1, len(textures) // 3)))
    accuracies, recall = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    whole = {row.hold_out: row for row in comparison.rows if row.texture == ALL_TEXTURES}
    for i, hold_out in enumerate(levels):
        for j, accuracy in enumerate((whole[hold_out].accuracy_a, whole[hold_out].accuracy_b)):
            accuracies.plot(i + 0.16 * (j - 0.5), 100.0 * accuracy, "os"[j], color=COLOURS[j], markersize=5.0)
    accuracies.axhline(100.0 / len(textures), color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    accuracies.annotate("chance", (-0.48, 100.0 / len(textures)), ha="left", va="bottom", fontsize=7.0)
    accuracies.set_xticks(
        range(len(levels)), [text.replace("-", "-\n").replace(", ", ",\n") for text in shown.values()]
    )
    accuracies.set(xlim=(-0.5, len(levels) - 0.5), ylim=(0.0, 104.0), ylabel="accuracy (%)")
    accuracies.set_title("by hold-out level", loc="left")
    step = 0.8 / len(levels)
    labels = [ALL_TEXTURES, *textures]
    for i, hold_out in enumerate(levels):
        for row in (row for row in comparison.rows if row.hold_out == hold_out):
            y = labels.index(row.texture) + (i - (len(levels) - 1) / 2.0) * step
            colour = COLOURS[(i + 2) % (len(COLOURS) - 1)]
            if row.low is not None and row.high is not None:
                recall.plot([100.0 * row.low, 100.0 * row.high], [y, y], color=colour, linewidth=1.0)
            recall.plot(100.0 * row.difference, y, "o", color=colour, markersize=3.5)
        recall.plot([], [], "o-", color=COLOURS[(i + 2) % (len(COLOURS) - 1)], markersize=3.5, label=shown[hold_out])
    recall.axvline(0.0, color=INK, linewidth=0.8)
    recall.set_yticks(range(len(labels)), [label.removeprefix("texture-") for label in labels])
    recall.set(xlabel="recall, B minus A (percentage points)", ylabel="texture")
    recall.invert_yaxis()
    recall.set_title(f"difference with 95 % interval over {comparison.units}", loc="left")
    for j, side in enumerate((comparison.a, comparison.b)):
        accuracies.plot([], [], "os"[j], color=COLOURS[j], markersize=5.0, label=f"{'AB'[j]}: {side.name}")
    handles = [*accuracies.get_legend_handles_labels()[0], *recall.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside upper left", ncols=4)
    return figure
