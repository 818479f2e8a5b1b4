"""What a report says of the runs themselves: what was pressed, the print records, the quality of the data."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.tables import Column, Table
from tacbench_cad.lab.analysis.variance.cells import parts_of
from tacbench_cad.lab.runs.checking import RunReport
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.spec.printrecord import FIELDS, SCORES, PrintRecord
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

#: Simulated parts that the page names.
_MAX_PARTS = 6


def title(collection: Collection) -> str:
    """The title of the page: how many presses of what."""
    of = f"on {counted(len(collection.runs), 'print')}"
    if not collection.has("print"):
        labels, folders = counted(len(collection.textures), "label"), counted(len(collection.runs), "run folder")
        of = f"of {labels}" if collection.has("label") else f"in {folders}"
    return f"{counted(len(collection), press_words(collection)[0])} {of}"


def press_words(collection: Collection) -> tuple[str, str]:
    """What a reading is of, one and several: a press of a protocol, or, where none is known, a sample."""
    return ("sample", "samples") if collection.info.protocol is None else ("press", "presses")


def prints_in_words(collection: Collection) -> str:
    """The prints of each printer-filament."""
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
    """What is unknown of imported runs; nothing of others."""
    if collection.info.protocol is not None:
        return []
    names = ("label", "print", "printer", "filament", "position", "force", "repeat")
    unknown = [name for name in names if not collection.has(name)]
    return unknown + (["formula", "size"] if all(run.info.printed.block is None for run in collection.runs) else [])


def unknown_in_words(collection: Collection) -> str:
    """A sentence that names what is unknown of imported runs; empty where nothing is."""
    unknown = unknown_names(collection)
    return f"Unknown, because nobody recorded it: {', '.join(unknown)}." if unknown else ""


def simulated_in_words(simulated: Sequence[str]) -> str:
    """A sentence that says what of the data was simulated; empty for real data."""
    parts = list(dict.fromkeys(part for text in simulated for part in text.split("; ")))
    more = f"; and {len(parts) - _MAX_PARTS} more (see run.json)" if len(parts) > _MAX_PARTS else ""
    return f"Simulated data, not a real sensor's: {'; '.join(parts[:_MAX_PARTS])}{more}." if parts else ""


def sampling_in_words(sampling: Tolerance | SampleGrid) -> str:
    """How a block's surface was made."""
    if isinstance(sampling, Tolerance):
        return f"within {sampling.mm:g} mm of the formula"
    return f"on a grid of {sampling.nx} x {sampling.ny} samples"


def forces_in_words(collection: Collection) -> str:
    """How hard, or how deep, the blocks were pressed: a sentence."""
    protocol = collection.info.protocol
    if protocol is None:
        known = [f"{value:.6g}" for level, value in sorted(collection.pressing.levels.items()) if value is not None]
        return f"The forces were {', '.join(known)} N; which forces were reached is unknown." if known else ""
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
    measured: dict[int, list[float]] = defaultdict(list)
    for row in (row for run in collection.runs for row in run.rows):
        if row.measured_force_n is not None and row.force_level is not None:
            measured[row.force_level].append(row.measured_force_n)
    text = f"Target forces were {forces} N"
    if all(len(measured[level]) > 1 for level in collection.levels):
        of_levels = (measured[level] for level in collection.levels)
        shown = ", ".join(f"{np.mean(values):.4f} (SD {np.std(values, ddof=1):.2g})" for values in of_levels)
        text += f"; measured just before the reading: {shown} N"
    return text + "."


def devices_in_words(collection: Collection, what: str) -> str:
    """The stages, or gauges, of all runs."""
    devices = [getattr(run.info, what) for run in collection.runs]
    words = ["simulated" if d.get("simulated") else str(d.get("identity") or "not recorded") for d in devices]
    return ", ".join(dict.fromkeys(words))


def design_table(collection: Collection) -> Table:
    """Prints and presses of each printer-filament and texture at each force level."""
    rows = []
    for combination in collection.combinations:
        for texture in collection.textures:
            there = (collection.combination == combination) & (collection.texture == texture)
            if there.any():
                presses = Counter(collection.level[there].tolist())
                counts = {f"presses_level_{level}": presses[level] for level in collection.levels}
                prints = len(np.unique(collection.copy[there])) if collection.has("print") else None
                rows.append({**parts_of(combination), "texture": texture, "prints": prints, **counts})
    levels = [Column(f"presses_level_{n}", head=f"presses, level {n}" if n else "presses") for n in collection.levels]
    return Table.of((*_columns("printer", "filament", "texture", "prints"), *levels), rows, "Prints and presses")


def record_tables(collection: Collection) -> dict[str, Any]:
    """The print records of a study.

    Returns:
        ``total``: how many can be read; ``all``: every field of each; ``empty``: the fields that are empty in some;
        ``alike``: what the others say, alike prints together; ``damaged``: why the rest cannot be read.
    """
    records: list[tuple[str, PrintRecord]] = []
    damaged: list[str] = []
    for run in collection.runs:
        try:
            records.append((run.info.printed.name, run.print_record))
        except InputError as error:
            damaged.append(str(error))
    rows = [{"run": name, **{field: _plain(record.values.get(field)) for field in FIELDS}} for name, record in records]
    empty = Counter(field for _, record in records for field in record.empty)
    filled = [field for field in FIELDS if any(record.values.get(field) for _, record in records)]
    alike = Counter(tuple(row[field] for field in filled) for row in rows if filled)
    return {
        "total": len(records),
        "all": Table.of(_columns("run", *FIELDS), rows),
        "empty": _table(
            "Empty fields of the print records",
            ("field", "what belongs there", "empty in", "of records"),
            ((field, "; ".join(SCORES.get(field, (FIELDS[field],))), n, len(records)) for field, n in empty.items()),
        ),
        "alike": _table(
            "What the print records say, alike prints together",
            (*filled, "prints"),
            ((*values, count) for values, count in alike.items()),
        ),
        "damaged": damaged,
    }


def quality_table(reports: Iterable[RunReport]) -> Table:
    """What `tacbench check-runs` says of each run."""
    counts = _columns("planned", "presses", "out_of_band", "references", "stationary")
    findings = Column("findings", source=lambda report: len(report.findings))
    return Table.of((Column("run", source="name"), *counts, findings), reports, "Runs with something to look at")


def findings_table(reports: Iterable[RunReport], most: int | None = None) -> Table:
    """The findings of all runs, or at most so many of each."""
    findings = [{"run": report.name, **to_plain(finding)} for report in reports for finding in report.findings[:most]]
    return Table.of(_columns("run", "kind", "where", "text"), findings, f"Findings, at most {most} of a run")


def open_points(collection: Collection, colour: bool, ddof: int) -> Table:
    """Where the paper's text leaves something open, what was taken, and what leads to the other reading.

    What is unknown of imported runs was not taken in any way, and has no row.
    """
    info = collection.info
    positions = counted(len(collection.pressing.positions_mm), "position")
    spacing = {"even": "18 to 23 mm in 1.25 mm steps", "1mm": "18 to 22 mm in 1 mm steps"}
    block, placed = info.printed.block, collection.has("position")
    preset = block.preset if block else ""
    sizes = {"paper": "the text's 23.3 x 30 mm", "released": "the released files' 29.3 x 30 mm"}
    levels = ", ".join(map(str, collection.levels))
    rows = (
        block
        and (
            "size and scale of the block: the text's numbers cannot all hold",
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
            "variance of what: the text has all prints and repeats, the notebooks the repeats on one print",
            "both, each by itself",
            "tacbench variance --protocol paper|as-published",
        ),
        placed and ("variance of grey or colour images", "colour" if colour else "grey (BT.601)", "--colour"),
        placed and ("divisor of the variance (ddof)", str(ddof), "--ddof 0|1"),
        placed
        and (
            "force of the 300 images of a cell",
            f"each of the levels {levels}, and their mean; as published: level {collection.levels[0]}",
            "--force-level",
        ),
    )
    heads = ("what is open", "taken here", "the other reading")
    return _table("How it was read here", heads, (row for row in rows if row))


def _columns(*names: str) -> tuple[Column, ...]:
    return tuple(Column(name) for name in names)


def _table(title: str, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    records: list[Mapping[str, Any]] = [dict(zip(heads, row, strict=True)) for row in rows]
    return Table(columns=_columns(*heads), rows=tuple(records), title=title)


def _plain(entry: Any) -> Any:
    return "; ".join(map(str, entry)) if isinstance(entry, list) else entry
