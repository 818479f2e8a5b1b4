"""Parts that several figures of the variance table share: levels, combinations, titles and colour scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, Level, name_of, short_texture, shown_levels
from tacbench_cad.lab.analysis.variance.variance_data import VarianceData
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def squared_unit(result: VarianceData) -> str:
    """Return the unit of a variance for labels."""
    return f"{result.units}$^2$"


def compared_levels(result: VarianceData) -> tuple[Level, ...]:
    """Return the levels at which figures compare prints: those with two prints of a texture, maybe their mean."""
    singles = result.table[result.table["force_level"] != ALL_LEVELS].groupby("force_level")["prints"].max()
    with_prints = singles.index[singles > 1].tolist()
    return shown_levels(result.table) if len(with_prints) in (0, len(singles)) else tuple(with_prints)


def compared(result: VarianceData) -> list[str]:
    """Return the combinations that figures compare: those with two prints of a texture, or all if there are none.

    A single print shows how well the sensor repeats, but not how prints differ.
    """
    prints = result.table.groupby(result.table["printer"] + "_" + result.table["filament"])["prints"].max()
    least = 2 if prints.max() > 1 and result.protocol == "paper" else 1
    return [combination for combination in result.design.combinations if prints.get(combination, 0) >= least]


def panel_title(result: VarianceData, level: Level) -> str:
    """Return the title of a panel: its level, and the number of combinations that are not shown."""
    count = len(result.table[["printer", "filament"]].drop_duplicates()) - len(compared(result))
    hidden = f" ({counted(count, 'printer-filament')} with one print not shown)" if count else ""
    return f"{result.design.level_name(level)}{hidden}"


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
