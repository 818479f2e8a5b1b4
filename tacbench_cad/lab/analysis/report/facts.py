"""The facts of a report about the runs themselves: the presses, the print records and the quality of the data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd

from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.tables import frame_of
from tacbench_cad.lab.analysis.variance.cells import parts_of
from tacbench_cad.lab.runs.checking import RunReport
from tacbench_cad.lab.runs.printrecord import FIELDS, SCORES
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

#: The largest number of simulated parts that the page names.
_MAX_PARTS = 6
#: The counts in the table of the quality of each run.
_COUNTS = ("planned", "presses", "out_of_band", "references", "stationary")
_TOUCHES = {
    "gauge": "detected by the force gauge",
    "sensor": "detected by a change of the sensor's frames",
    "taught": "taught by hand",
}


def title(design: Design) -> str:
    """Return the title of the page: the number of presses and of prints, labels or folders."""
    folders = design.presses["run"].nunique()
    of = f"in {counted(folders, 'folder')}"
    if design.has("print"):
        of = f"on {counted(folders, 'print')}"
    elif design.has("label"):
        of = f"of {counted(len(design.textures), 'label')}"
    return f"{counted(len(design), press_words(design)[0])} {of}"


def press_words(design: Design) -> tuple[str, str]:
    """Return the singular and the plural of the word for a frame: press, or sample if the protocol is unknown."""
    return ("press", "presses") if design.planned else ("sample", "samples")


def prints_by_group(design: Design, *by: str) -> Any:
    """Return the presses grouped by texture and combination, in the order of the study.

    Args:
        design: The design of the study.
        by: ``texture`` and ``combination``; the first is the slowest.
    """
    orders = {"texture": design.textures, "combination": design.combinations}
    ordered = {name: pd.Categorical(design.first_steps[name], orders[name], ordered=True) for name in by}
    return design.first_steps.assign(**ordered).groupby(list(by), observed=True)


def prints_in_words(design: Design) -> str:
    """Return a phrase with the number of prints of each printer-filament."""
    of_textures = prints_by_group(design, "combination", "texture")["copy"].nunique()
    parts = []
    for combination, prints in of_textures.groupby("combination", observed=True):
        low, high = prints.min(), prints.max()
        count = counted(int(low), "print") if low == high else f"{low} to {high} prints"
        count = count if design.has("print") else "an unknown number of prints"
        known = {name: value for name, value in parts_of(str(combination)).items() if value != UNKNOWN}
        on = f" on {known['printer']}" if "printer" in known else ""
        on += f" in {known['filament']}" if "filament" in known else ""
        parts.append(f"{count} of {counted(len(prints), 'texture')}{on}")
    return "; ".join(parts)


def unknown_names(design: Design) -> list[str]:
    """Return the names of unknown facts of other people's frames; an empty list for planned presses."""
    names = ("label", "session", "print", "printer", "filament", "position", "force", "repeat")
    unknown = [name for name in names if not design.has(name)]
    unknown += ["formula", "size"] * bool(design.presses["preset"].isna().all())
    return [] if design.planned else unknown


def simulated_in_words(simulated: Sequence[str]) -> str:
    """Return a sentence that says which parts of the data were simulated; an empty string for real data."""
    parts = list(dict.fromkeys(part for text in simulated for part in text.split("; ")))
    more = f"; and {len(parts) - _MAX_PARTS} more (see run.json)" if len(parts) > _MAX_PARTS else ""
    return f"Simulated data, not from a real sensor: {'; '.join(parts[:_MAX_PARTS])}{more}." if parts else ""


def forces_in_words(design: Design) -> str:
    """Return a sentence about the force, or the depth, at which the blocks were pressed."""
    targets = design.protocol.targets if design.protocol else None
    if targets is None:
        known = [f"{value:.6g}" for _, value in sorted(design.level_values.items()) if value is not None]
        return f"The forces were {', '.join(known)} N; the measured forces are unknown." if known else ""
    if targets.contact == "depth":
        depths = ", ".join(f"{targets.depths_mm[level - 1]:g}" for level in design.levels)
        return (
            f"The sensor's highest point was moved {depths} mm below first contact ({_TOUCHES[targets.touch]}). No "
            "force was controlled, so the frames cannot be compared with frames at the paper's forces."
        )
    forces = ", ".join(f"{targets.forces_n[n - 1]:.6g} ± {targets.bands_n[n - 1]:.3g}" for n in design.levels)
    measured = design.first_steps.groupby("level")["measured_force_n"].agg(["count", "mean", "std"])
    text = f"Target forces were {forces} N"
    if measured["count"].min() > 1:
        shown = ", ".join(f"{row['mean']:.4f} (SD {row['std']:.2g})" for _, row in measured.iterrows())
        text += f"; measured just before the frame was taken: {shown} N"
    return text + "."


def devices_in_words(design: Design, what: str) -> str:
    """Return the names of the stages, or of the force gauges, of all runs."""
    devices = [getattr(run.info, what) for run in design.runs]
    words = ["simulated" if d.get("simulated") else str(d.get("identity") or "not recorded") for d in devices]
    return ", ".join(dict.fromkeys(words))


def design_table(design: Design) -> pd.DataFrame:
    """Return the numbers of prints and presses of each printer-filament and texture at each force level."""
    groups = prints_by_group(design, "combination", "texture")
    counts: pd.DataFrame = groups["level"].value_counts().unstack(fill_value=0)
    table = counts.sort_index(axis="columns").add_prefix("presses_level_")
    table.insert(0, "prints", groups["copy"].nunique() if design.has("print") else None)
    table = table.reset_index()
    parts = [parts_of(name) for name in table.pop("combination")]
    return pd.concat([pd.DataFrame(parts), table], axis="columns")


def print_records(design: Design) -> tuple[pd.DataFrame, list[str]]:
    """Return the print records of a study, and the errors of unreadable records."""
    rows, damaged = list[dict[str, Any]](), list[str]()
    for run in design.runs:
        try:
            values = run.print_record.values
        except InputError as error:
            damaged.append(str(error))
            continue
        photos = "; ".join(map(str, values.get("photos", []))) or None
        rows.append({**dict.fromkeys(FIELDS), **values, "photos": photos, "run": run.info.printed.name})
    return frame_of(rows, ("run", *FIELDS)), damaged


def record_fields(records: pd.DataFrame) -> pd.DataFrame:
    """Return a table of the fields of print records: their values, and how often they are empty."""
    rows = []
    for name, meaning in FIELDS.items():
        counts = records[name].dropna().astype(str).value_counts()
        of_values = counts.items()
        values = "; ".join(str(value) if count == len(records) else f"{value} ({count})" for value, count in of_values)
        empty = len(records) - int(counts.sum())
        rows.append((name, values, empty, "; ".join(SCORES.get(name, (meaning,))) if empty else ""))
    return pd.DataFrame(rows, columns=["field", "content (number of records)", "empty in", "expected content"])


def quality_table(reports: Iterable[RunReport]) -> pd.DataFrame:
    """Return a table with the result of `tacbench check-runs` for each run."""
    rows = [
        {**{name: getattr(of, name) for name in _COUNTS}, "run": of.name, "findings": len(of.findings)}
        for of in reports
    ]
    return frame_of(rows, ("run", *_COUNTS, "findings"))


def findings_table(reports: Iterable[RunReport]) -> pd.DataFrame:
    """Return the findings of all runs."""
    findings = [{"run": report.name, **to_plain(finding)} for report in reports for finding in report.findings]
    return frame_of(findings, ("run", "kind", "where", "text"))
