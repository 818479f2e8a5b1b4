"""The facts of a report about the runs themselves: the presses, the print records and the quality of the data."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.tables import Shown, frame_of
from tacbench_cad.lab.analysis.variance.cells import parts_of
from tacbench_cad.lab.runs.checking import RunReport
from tacbench_cad.lab.runs.printrecord import FIELDS, SCORES, PrintRecord
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

#: The largest number of simulated parts that the page names.
_MAX_PARTS = 6
#: The counts in the table of the quality of each run.
_COUNTS = ("planned", "presses", "out_of_band", "references", "stationary")


def title(collection: Collection) -> str:
    """Return the title of the page: the number of presses and of prints, labels or run folders."""
    of = f"on {counted(len(collection.runs), 'print')}"
    if not collection.has("print"):
        labels, folders = counted(len(collection.textures), "label"), counted(len(collection.runs), "run folder")
        of = f"of {labels}" if collection.has("label") else f"in {folders}"
    return f"{counted(len(collection), press_words(collection)[0])} {of}"


def press_words(collection: Collection) -> tuple[str, str]:
    """Return the singular and the plural of the word for a frame: press, or sample if the protocol is unknown."""
    return ("sample", "samples") if collection.info.protocol is None else ("press", "presses")


def prints_in_words(collection: Collection) -> str:
    """Return a phrase with the number of prints of each printer-filament."""
    groups: dict[str, dict[str, set[int | str | None]]] = defaultdict(lambda: defaultdict(set))
    for run in collection.runs:
        printed = run.info.printed
        groups[printed.combination][printed.texture or UNKNOWN].add(printed.copy)
    parts = []
    for combination in collection.combinations:
        counts = sorted({len(copies) for copies in groups[combination].values()})
        prints = counted(counts[0], "print") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} prints"
        if not collection.has("print"):
            prints = "an unknown number of prints"
        textures = counted(len(groups[combination]), "texture")
        known = {name: value for name, value in parts_of(combination).items() if value != UNKNOWN}
        on = f" on {known['printer']}" if "printer" in known else ""
        parts.append(f"{prints} of {textures}{on}" + (f" in {known['filament']}" if "filament" in known else ""))
    return "; ".join(parts)


def unknown_names(collection: Collection) -> list[str]:
    """Return the names of unknown facts of imported runs; an empty list for other runs."""
    if collection.info.protocol is not None:
        return []
    names = ("label", "session", "print", "printer", "filament", "position", "force", "repeat")
    unknown = [name for name in names if not collection.has(name)]
    return unknown + (["formula", "size"] if all(run.info.printed.block is None for run in collection.runs) else [])


def unknown_in_words(collection: Collection) -> str:
    """Return a sentence that names the unknown facts of imported runs; an empty string if there are none."""
    unknown = unknown_names(collection)
    return f"Not recorded, and therefore unknown: {', '.join(unknown)}." if unknown else ""


def simulated_in_words(simulated: Sequence[str]) -> str:
    """Return a sentence that says which parts of the data were simulated; an empty string for real data."""
    parts = list(dict.fromkeys(part for text in simulated for part in text.split("; ")))
    more = f"; and {len(parts) - _MAX_PARTS} more (see run.json)" if len(parts) > _MAX_PARTS else ""
    return f"Simulated data, not from a real sensor: {'; '.join(parts[:_MAX_PARTS])}{more}." if parts else ""


def sampling_in_words(sampling: Tolerance | SampleGrid) -> str:
    """Return a phrase that says how the mesh of a block's surface was made."""
    if isinstance(sampling, Tolerance):
        return f"within {sampling.mm:g} mm of the formula"
    return f"on a grid of {sampling.nx} x {sampling.ny} samples"


def forces_in_words(collection: Collection) -> str:
    """Return a sentence about the force, or the depth, at which the blocks were pressed."""
    protocol = collection.info.protocol
    if protocol is None:
        known = [f"{value:.6g}" for level, value in sorted(collection.pressing.levels.items()) if value is not None]
        return f"The forces were {', '.join(known)} N; the measured forces are unknown." if known else ""
    if protocol.targets.contact == "depth":
        depths = ", ".join(f"{protocol.targets.depths_mm[level - 1]:g}" for level in collection.levels)
        how = {
            "gauge": "detected by the force gauge",
            "sensor": "detected by a change of the sensor's frames",
            "taught": "taught by hand",
        }
        return (
            f"The sensor's highest point was moved {depths} mm below first contact ({how[protocol.targets.touch]}). "
            "No force was controlled, so the frames cannot be compared with frames at the paper's forces."
        )
    targets = protocol.targets
    forces = ", ".join(f"{targets.forces_n[n - 1]:.6g} ± {targets.bands_n[n - 1]:.3g}" for n in collection.levels)
    measured: dict[int, list[float]] = defaultdict(list)
    for row in (row for run in collection.runs for row in run.rows):
        if row.measured_force_n is not None and row.force_level is not None:
            measured[row.force_level].append(row.measured_force_n)
    text = f"Target forces were {forces} N"
    if all(len(measured[level]) > 1 for level in collection.levels):
        of_levels = (measured[level] for level in collection.levels)
        shown = ", ".join(f"{np.mean(values):.4f} (SD {np.std(values, ddof=1):.2g})" for values in of_levels)
        text += f"; measured just before the frame was taken: {shown} N"
    return text + "."


def devices_in_words(collection: Collection, what: str) -> str:
    """Return the names of the stages, or of the force gauges, of all runs."""
    devices = [getattr(run.info, what) for run in collection.runs]
    words = ["simulated" if d.get("simulated") else str(d.get("identity") or "not recorded") for d in devices]
    return ", ".join(dict.fromkeys(words))


def design_table(collection: Collection) -> pd.DataFrame:
    """Return the numbers of prints and presses of each printer-filament and texture at each force level."""
    rows = []
    for combination in collection.combinations:
        for texture in collection.textures:
            there = (collection.combination == combination) & (collection.texture == texture)
            if there.any():
                presses = Counter(collection.level[there].tolist())
                counts = {f"presses_level_{level}": presses[level] for level in collection.levels}
                prints = len(np.unique(collection.copy[there])) if collection.has("print") else None
                rows.append({**parts_of(combination), "texture": texture, "prints": prints, **counts})
    return pd.DataFrame(rows)


def record_tables(collection: Collection) -> dict[str, Any]:
    """Return tables of the print records of a study.

    Returns:
        A dict with five entries. ``total`` is the number of readable records; ``all`` is a table of all their fields;
        ``empty`` is a table of the fields that are empty in some records; ``alike`` is a table of the other fields
        with one row for all equal records; ``damaged`` is a list of errors, one for each unreadable record.
    """
    printed: list[tuple[str, PrintRecord]] = []
    damaged: list[str] = []
    for run in collection.runs:
        try:
            printed.append((run.info.printed.name, run.print_record))
        except InputError as error:
            damaged.append(str(error))
    rows = [{"run": name, **{field: _plain(record.values.get(field)) for field in FIELDS}} for name, record in printed]
    empty = Counter(field for _, record in printed for field in record.empty)
    filled = [field for field in FIELDS if any(record.values.get(field) for _, record in printed)]
    alike = Counter(tuple(row[field] for field in filled) for row in rows if filled)
    expected = {field: "; ".join(SCORES.get(field, (FIELDS[field],))) for field in empty}
    of_empty = [(field, expected[field], count, len(printed)) for field, count in empty.items()]
    return {
        "total": len(printed),
        "all": frame_of(rows, ("run", *FIELDS)),
        "empty": Shown(
            "Empty fields of the print records",
            pd.DataFrame(of_empty, columns=["field", "expected content", "empty in", "of records"]),
        ),
        "alike": Shown(
            "Print records; equal records share a row",
            pd.DataFrame([(*values, count) for values, count in alike.items()], columns=[*filled, "prints"]),
        ),
        "damaged": damaged,
    }


def quality_table(reports: Iterable[RunReport]) -> pd.DataFrame:
    """Return a table with the result of `tacbench check-runs` for each run."""
    rows = [
        {**{name: getattr(of, name) for name in _COUNTS}, "run": of.name, "findings": len(of.findings)}
        for of in reports
    ]
    return frame_of(rows, ("run", *_COUNTS, "findings"))


def findings_table(reports: Iterable[RunReport], limit: int | None = None) -> pd.DataFrame:
    """Return the findings of all runs, at most ``limit`` of each run."""
    findings = [{"run": report.name, **to_plain(finding)} for report in reports for finding in report.findings[:limit]]
    return frame_of(findings, ("run", "kind", "where", "text"))


def open_points(collection: Collection, colour: bool, ddof: int) -> Shown:
    """Return the points that the paper's text leaves open, the choice made here, and the option of the other choice.

    Points that are unknown for imported runs have no row.
    """
    info = collection.info
    positions = counted(len(collection.pressing.positions_mm), "position")
    spacing = {"even": "18 to 23 mm in 1.25 mm steps", "1mm": "18 to 22 mm in 1 mm steps"}
    block, placed = info.printed.block, collection.has("position")
    preset = block.preset if block else ""
    sizes = {"paper": "23.3 x 30 mm as in the text", "released": "29.3 x 30 mm as in the released files"}
    levels = ", ".join(map(str, collection.levels))
    rows = (
        block
        and (
            "size and scale of the block: the numbers in the text contradict each other",
            f"preset {preset}: {sizes.get(preset, 'its own size')}",
            "tacbench make --preset paper|released",
        ),
        info.protocol
        and (
            '"5 equally spaced 1 mm positions between 18 and 23 mm"',
            spacing.get(info.grid_spacing or "", f"the study's own grid, {positions}"),
            "grid_spacing",
        ),
        placed
        and (
            "samples of the variance: all prints and repeats (text) or the repeats on one print (notebooks)",
            "both, in separate tables",
            "tacbench variance --protocol paper|as-published",
        ),
        placed and ("variance of grey or colour images", "colour" if colour else "grey (BT.601)", "--colour"),
        placed and ("divisor of the variance (ddof)", str(ddof), "--ddof 0|1"),
        placed
        and (
            "force of the 300 images of a cell",
            f"each of the levels {levels}, and their mean; protocol as-published: level {collection.levels[0]}",
            "--force-level",
        ),
    )
    heads = ["open point", "choice in this report", "option of the other choice"]
    return Shown("Choices in this report", pd.DataFrame([row for row in rows if row], columns=heads))


def _plain(entry: Any) -> Any:
    return "; ".join(map(str, entry)) if isinstance(entry, list) else entry
