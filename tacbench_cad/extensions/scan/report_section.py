"""The section of a report on scan and touch.

Does a print that deviates more from its formula also differ more from other prints when it is pressed?

The deviation is that of ``scan.json`` in the run folder. The difference is the mean square between a print's frames
and those of the other prints of its texture, printer and filament. Textures differ much in both numbers. Therefore the
logarithms of both are taken relative to their mean over the prints of a texture, printer and filament, and only then
ranked over all prints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.extensions.scan.estimates import HALF_WIDTH
from tacbench_cad.extensions.scan.record import SCAN_FILE, ScanRecord, read_scan_record
from tacbench_cad.lab.analysis import (
    ALL_LEVELS,
    Design,
    ReportSection,
    Results,
    Shown,
    Variance,
)
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted, interval, short

#: The title of the section, and the name of its table.
TITLE, TABLE_FILE = "Scan and touch", "scans.csv"
#: The two numbers of the scan that are compared with the presses.
SCANNED = {"top_rms_mm": "the deviation from the formula", "pin_shift_px": "the computed shift of the pins"}
#: The smallest number of prints beyond one for each group, from which a correlation has an interval.
MIN_FREE = 5


@dataclass(frozen=True, kw_only=True)
class RankCorrelation:
    """A rank correlation over prints.

    Args:
        prints: The number of prints.
        groups: The number of groups of prints with the same texture, printer and filament.
        value: Spearman's coefficient; None if there are too few prints.
        low: The lower end of its interval of 95 %.
        high: The upper end of its interval of 95 %.
    """

    prints: int
    groups: int
    value: float | None = None
    low: float | None = None
    high: float | None = None


def report_section(results: Results) -> ReportSection:
    """Return the section of a report, which is empty if no print was scanned.

    Args:
        results: The results of the report.
    """
    table, damaged = scan_table(results.design, results.variance)
    parts: list[str | list[str] | Shown] = ["Scans that cannot be read:", damaged] if damaged else []
    if table.empty:
        return ReportSection(title=TITLE, parts=parts)
    parts += [
        "The deviation is that of a scan of the print from its formula. The difference from other prints is the mean "
        "square between the frames of the print and those of the other prints of its texture, printer and filament; it "
        "contains sensor noise.",
        *(answer(table, name) for name in SCANNED),
        Shown("Scans of the prints", _shown(table)),
    ]
    return ReportSection(title=TITLE, parts=parts, tables={TABLE_FILE: table})


def _shown(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table of the page."""
    return pd.DataFrame(
        {
            **{name: table[name] for name in ("run", "texture", "printer", "filament")},
            "deviation, rms (µm)": (1000.0 * table["top_rms_mm"].astype(float)).map(short, na_action="ignore"),
            "shift of the pins (px)": table["pin_shift_px"].map(short, na_action="ignore"),
            "top scanned (%)": (100.0 * table["seen_fraction"].astype(float)).map("{:.0f}".format, na_action="ignore"),
            "difference from other prints": table["from_others"].map(short, na_action="ignore"),
            "simulated scan": table["scan_simulated"],
        }
    )


def scan_table(design: Design, variance: Variance | None) -> tuple[pd.DataFrame, list[str]]:
    """Return a table with a row for each print that was scanned, and the errors of unreadable records.

    Args:
        design: The design of the study.
        variance: The variance table; None if there is none.
    """
    distances = _distances(variance)
    rows: list[dict[str, Any]] = []
    damaged: list[str] = []
    presses = design.first_steps.drop_duplicates("folder").set_index("folder")
    for run in design.runs:
        path = run.folder / SCAN_FILE
        if not path.is_file():
            continue
        try:
            record = read_scan_record(path, ScanRecord, within=run.folder)
        except InputError as error:
            damaged.append(str(error))
            continue
        printed = presses.loc[str(run.folder)]
        made = {name: printed[name] for name in ("printer", "filament", "texture")}
        rows.append(
            {
                **made,
                "run": run.folder.name,
                "top_rms_mm": record.top_rms_mm,
                "pin_shift_px": record.pin_shift_px,
                "seen_fraction": record.seen_fraction,
                "from_others": distances.get((*made.values(), printed["print_number"])),
                "scan_simulated": "yes" if record.simulated else "",
            }
        )
    return pd.DataFrame(rows), damaged


def _distances(variance: Variance | None) -> dict[Any, float]:
    """Return the mean distance of each print from the others over the force levels."""
    table = variance.tables.get("print_distances") if variance else None
    if table is None:
        return {}
    known = table[(table["force_level"] != ALL_LEVELS) & table["from_others"].notna()]
    print_of = known.astype({"from_others": float}).groupby(["printer", "filament", "texture", "copy"])
    return dict(print_of["from_others"].mean())


def rank_correlation(table: pd.DataFrame, name: str) -> RankCorrelation:
    """Return the rank correlation of a number of the scan and the difference from other prints.

    Args:
        table: The table of the scans.
        name: The column of the number.
    """
    from scipy.stats import spearmanr

    numbers = table[[name, "from_others"]].astype(float)
    numbers = numbers[(numbers > 0.0).all(axis=1)]
    made = [table[column] for column in ("texture", "printer", "filament")]
    several = numbers[numbers.groupby(made, dropna=False)[name].transform("size") > 1]
    logarithms = several.apply(np.log)
    groups = logarithms.groupby(made, dropna=False)
    relative = (logarithms - groups.transform("mean")).to_numpy()
    count, free = len(several), len(several) - groups.ngroups
    if free < MIN_FREE or np.ptp(relative, axis=0).min() < 1e-12:
        return RankCorrelation(prints=count, groups=groups.ngroups)
    value = float(spearmanr(relative).statistic)
    # Fisher's z with the standard error of Bonett and Wright (2000) for ranks. Each group costs a mean.
    error = math.sqrt((1.0 + value**2 / 2.0) / (free - 2))
    middle = math.atanh(max(-1.0 + 1e-12, min(1.0 - 1e-12, value)))
    low, high = (math.tanh(middle + sign * HALF_WIDTH * error) for sign in (-1.0, 1.0))
    return RankCorrelation(prints=count, groups=groups.ngroups, value=value, low=low, high=high)


def answer(table: pd.DataFrame, name: str) -> str:
    """Return a sentence that says whether prints that deviate more differ more when they are pressed."""
    result, what = rank_correlation(table, name), SCANNED[name]
    if result.value is None:
        return (
            f"Too few prints to compare {what} with the presses: {counted(result.prints, 'scanned print')} with "
            f"another scanned print of the same texture, printer and filament, in {counted(result.groups, 'group')}. "
            f"There must be {MIN_FREE} prints more than groups."
        )
    of = f"rank correlation {result.value:+.2f}, 95 % interval {interval(result.low, result.high, signed=True)}"
    ending = f"({of}, {result.prints} prints in {counted(result.groups, 'group')})."
    assert result.low is not None and result.high is not None
    if result.low > 0.0:
        return f"Prints differ more from other prints of their texture, the larger {what} is {ending}"
    if result.high < 0.0:
        return f"Prints differ less from other prints of their texture, the larger {what} is {ending}"
    return f"No relation can be shown between {what} and the differences between prints {ending}"
