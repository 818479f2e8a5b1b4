"""The tables of a variance result for readers: fewer digits, a column for each texture or force level."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd

from tacbench_cad.lab.analysis.tables import Shown, records
from tacbench_cad.lab.analysis.variance.cells import (
    ALL_LEVELS,
    CELL,
    REPEATS,
    Level,
    cells_of,
    name_of,
    short_texture,
    shown_levels,
    squared,
)
from tacbench_cad.lab.analysis.variance.components import LIMIT_FACTOR, PRECISION
from tacbench_cad.lab.analysis.variance.variance_data import VarianceData
from tacbench_cad.util.text import interval, short

_COMPONENTS = {"texture": "texture", "printer": "printer-filament", "print": "print", "repeat": "repeat on one print"}


def level_table(result: VarianceData, level: Level) -> Shown:
    """Return the variance table at one level: a few rows for each printer-filament, a column for each texture."""
    design, by_key = result.design, cells_of(result.table[result.table["force_level"] == level])
    largest = max(cell.variance for cell in by_key.values())
    decimals = 2 if largest <= 0.0 else min(12, max(0, 2 - math.floor(math.log10(largest))))

    def number(value: float) -> str:
        # + 0.0 removes the sign of -0
        return "" if math.isnan(value) else f"{round(value, decimals) + 0.0:.{decimals}f}"

    lines: dict[str, Callable[[Any], str]] = {
        "noise alone": lambda cell: number(cell.noise_alone),
        "floor removed (ddof 1)": lambda cell: number(cell.floor_removed),
        "95 % interval": lambda cell: "" if math.isnan(cell.low) else interval(cell.low, cell.high),
        "the paper": lambda cell: "" if math.isnan(cell.published) else f"{cell.published:g}",
    }
    what, title = "variance", "variance"
    if result.protocol == "as-published":
        what, title = "variance of repeats", "variance of the repeats on one print"
    rows: list[dict[str, str]] = []
    for combination in design.combinations:
        keys = ((texture, (level, (combination, texture))) for texture in design.textures)
        cells = {short_texture(texture): by_key[key] for texture, key in keys if key in by_key}
        if not cells:
            continue
        counts = {name: _range([getattr(cell, name) for cell in cells.values()]) for name in ("prints", "presses")}
        values = {texture: number(cell.variance) for texture, cell in cells.items()}
        rows.append({"printer, filament": name_of(combination), "": what, **values, **counts})
        bound = any(cell.floor_from == REPEATS for cell in cells.values())
        for name, text in lines.items():
            texts = {texture: text(cell) for texture, cell in cells.items()}
            if any(texts.values()):
                rows.append({"": f"{name}, at most" if bound and name == "noise alone" else name, **texts})
    columns = ["printer, filament", "", *map(short_texture, design.textures), "prints", "presses"]
    title = f"{title}, {design.level_name(level)} ({squared(result.units)}{_kind(result)}, ddof {result.ddof})"
    return Shown(title, pd.DataFrame(rows, columns=columns))


def _kind(result: VarianceData) -> str:
    """Return what the numbers are, in a few words, for titles."""
    settings, kind = result.settings, ""
    if result.units == "counts":
        kind = f"; {'colour' if settings.get('colour') else 'grey'}, full size"
        if result.protocol == "as-published":
            kind = f"; grey not rounded, {100.0 * settings['resolution']:g} % of the size"
    kind += "; series of moving frames" if settings["series"] else ""
    kind += f"; {result.feature.words.title}" if result.feature.words.title else ""
    return kind + (f"; inside {settings['roi']}" if settings["roi"] else "")


def component_table(result: VarianceData) -> Shown:
    """Return the components and ISO 5725's standard deviations, with a column for each level."""
    by_key = {(row["force_level"], row["component"]): row for row in records(result.tables["components"])}
    levels = shown_levels(result.table)
    rows = {text: [_component(by_key[level, name]) for level in levels] for name, text in _COMPONENTS.items()}
    for name in PRECISION:
        variances = [by_key[level, name]["variance"] for level in levels]
        deviations = [None if variance is None else math.sqrt(variance) for variance in variances]
        rows[f"{name} SD ({result.units})"] = [
            "" if sd is None else f"{short(sd)} (limit {short(LIMIT_FACTOR * sd)})" for sd in deviations
        ]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=list(map(result.design.level_name, levels)))
    title = f"variance components of the nested design ({squared(result.units)}, unbiased) and ISO 5725"
    return Shown(title, frame.reset_index(names=""))


def _component(row: Mapping[str, Any]) -> str:
    """Return a component with its interval, or the reason why there is none."""
    if row["variance"] is None:
        return str(row["note"] or "not estimated")
    ends = f" ({interval(row['low'], row['high'])})" if row["low"] is not None else ""
    includes = f", with {row['includes'].replace(' ', ', ')}" if row["includes"] else ""
    return f"{short(row['variance'])}{ends}{includes}"


def permutation_table(result: VarianceData) -> Shown:
    """Return the permutation tests over all force levels, or at each level if no test is over all."""
    table = result.tables["permutation"]
    pooled = table[table["force_level"] == ALL_LEVELS]
    table = pooled if len(pooled) else table
    frame = pd.DataFrame(
        {
            "force": table["force_level"].map(result.design.level_name),
            "first": table["first"].map(name_of),
            "second": table["second"].map(name_of),
            "prints": table["prints_first"].astype(str) + ", " + table["prints_second"].astype(str),
            "ratio": table["ratio"].map(short, na_action="ignore"),
            "p": table["p"].map(short),
            "p for all pairs": table["p_holm"].map(short),
            "smallest possible p": table["least_p"].map(short),
        }
    )
    return Shown("do two printers have the same variance between prints? (permutation test of prints)", frame)


def seating_table(result: VarianceData) -> Shown:
    """Return the variance of each cell with and without differences in placement, and the largest offsets."""
    table = result.tables["registration"]
    figures = {"variance": "variance", "seating": "seating", "without seating": "variance_without_seating"}
    offsets = table[["x_mm", "y_mm"]].abs()
    cells = table.assign(**offsets).groupby(list(CELL), sort=False, as_index=False)
    largest = cells.agg({**dict.fromkeys(figures.values(), "first"), "x_mm": "max", "y_mm": "max"})
    frame = pd.DataFrame(
        {
            "force": largest["force_level"].map(result.design.level_name),
            **{name: largest[name] for name in ("printer", "filament", "texture")},
            **{head: largest[name].map(short) for head, name in figures.items()},
            **{
                f"largest offset {axis} (mm)": largest[f"{axis}_mm"].map("{:.3f}".format, na_action="ignore")
                for axis in "xy"
            },
        }
    )
    title = "registration: the part of the variance that differences in placement explain (not in the paper)"
    return Shown(title, frame)


def _range(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"
