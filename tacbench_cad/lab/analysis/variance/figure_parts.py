"""Parts that several figures of the variance table share: levels, combinations, titles and colour scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tacbench_cad.lab.analysis.variance.cells import (
    Level,
    name_of,
    short_texture,
    shown_levels,
)
from tacbench_cad.lab.analysis.variance.result import VarianceResult
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def squared_unit(result: VarianceResult) -> str:
    """Return the unit of a variance for labels."""
    return f"{result.units}$^2$"


def compared_levels(result: VarianceResult) -> tuple[Level, ...]:
    """Return the levels at which figures compare prints: those with two prints of a texture, maybe their mean."""
    singles = sorted(set().union(*result.sums.values()))
    with_prints = [
        level for level in singles if any(cell.prints > 1 for cell in result.cells if cell.force_level == level)
    ]
    if len(with_prints) in (0, len(singles)):
        return shown_levels(result.cells)
    return tuple(with_prints)


def compared(result: VarianceResult) -> list[str]:
    """Return the combinations that figures compare: those with two prints of a texture, or all if there are none.

    A single print shows how well the sensor repeats, but not how prints differ.
    """
    if result.protocol == "as-published":
        return list(dict.fromkeys(cell.combination for cell in result.cells))
    prints: dict[str, int] = {}
    for cell in result.cells:
        prints[cell.combination] = max(prints.get(cell.combination, 0), cell.prints)
    most = max(prints.values())
    return [combination for combination in result.collection.combinations if prints.get(combination, 0) > (most > 1)]


def panel_title(result: VarianceResult, level: Level) -> str:
    """Return the title of a panel: its level, and the number of combinations that are not shown."""
    count = len({cell.combination for cell in result.cells}) - len(compared(result))
    hidden = f" ({counted(count, 'printer-filament')} with one print not shown)" if count else ""
    return f"{result.collection.pressing.level_name(level)}{hidden}"


def name_panels(panels: Any, textures: Sequence[str], combinations: Sequence[str]) -> None:
    """Name the columns of panels by texture, the rows by printer and filament."""
    for axes, texture in zip(panels[0], textures, strict=True):
        axes.set_title(f"texture {short_texture(texture)}" if short_texture(texture).isdigit() else texture)
    for axes, combination in zip(panels[:, 0], combinations, strict=True):
        name = "\n".join(name_of(combination).rsplit(" ", 1))
        axes.set_ylabel(name, rotation=0, ha="right", va="center", labelpad=6.0)


def colour_bar(figure: Figure, label: str, **options: Any) -> None:
    """Add the colour scale of all pictures of a figure, if there are any."""
    pictures = [picture for axes in figure.axes for picture in axes.images]
    if pictures:
        bar = figure.colorbar(pictures[-1], ax=figure.axes, pad=0.01, **options)
        bar.set_label(label)
        bar.outline.set_linewidth(0.5)
