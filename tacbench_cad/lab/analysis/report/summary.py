"""The first screen of a report: five sentences with the main numbers of its tables, and the next steps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.splits import shown_level
from tacbench_cad.lab.analysis.conclusions import IS_REPEATABLE, REPEATABLE
from tacbench_cad.lab.analysis.report.facts import press_words, unknown_names
from tacbench_cad.lab.analysis.report.results import UNSEEN, Results
from tacbench_cad.lab.analysis.tables import percent, records
from tacbench_cad.lab.analysis.variance.cells import FRAMES, name_of, short_texture
from tacbench_cad.lab.runs.checking import RunReport
from tacbench_cad.lab.runs.quality import JUDGED
from tacbench_cad.util.text import counted, interval, short

#: The largest number of names in a sentence; the sentence only counts the others.
_MAX_NAMES = 3
#: A row of a table of answers.
Row = Mapping[str, Any]
_ESTIMATORS = {"forest": "A random forest", "network": "A network"}
_UNSAID = "cannot be said: "
#: The words of the sentence about the textures, by the first words of the answer.
_TOLD_APART = {"yes": "told apart", "no": "not told apart", "unclear": "unclear", _UNSAID: "no print held out"}


def summary(results: Results) -> dict[str, str]:
    """Return the five sentences; the keys are their topics."""
    first, *others = next_steps(results)
    more = f" {counted(len(others), 'more step')} below." if others else ""
    return {
        "What was pressed": pressed_sentence(results),
        "Data quality": quality_sentence(results),
        "Printing": printing_sentence(results),
        "Telling apart": textures_sentence(results),
        "What to do next": first + more,
    }


def listed(words: Iterable[object], limit: int = _MAX_NAMES) -> str:
    """Join words as in a sentence: ``a, b and c``; ``a, b, c and 4 more`` if there are more than ``limit + 1``."""
    names = [str(word) for word in words]
    if len(names) > limit + 1:
        names = [*names[:limit], f"{len(names) - limit} more"]
    return " and ".join([*([", ".join(names[:-1])] if len(names) > 1 else []), *names[-1:]])


def pressed_sentence(results: Results) -> str:
    """Return the sentence about the presses. For imported samples it contains only the known facts."""
    study = results.collection
    names = [name_of(combination) for combination in study.combinations]
    on = f" on {listed(names)}" if study.has("printer") or study.has("filament") else ""
    prints = f"{counted(len(study.runs), 'print')} of " if study.has("print") else ""
    levels = [study.pressing.level_name(level) for level in study.levels]
    positions = len(study.pressing.positions_mm)
    if study.info.protocol is not None:
        textures = counted(len(study.textures), "texture")
        how = f"{counted(positions, 'position')}, {listed(levels, 4)}, {counted(study.pressing.repeats, 'repeat')}"
        verb = "was" if len(study.runs) == 1 else "were"
        return f"{prints}{textures}{on} {verb} pressed {counted(len(study), 'time')} ({how})."
    what = f"{prints}{counted(len(study.textures), 'label')}{on}" if study.has("label") else f"unlabelled objects{on}"
    where = f", at {counted(positions, 'position')}" if study.has("position") else ""
    where += f", {listed(levels, 4)}" if study.has("force") else ""
    unknown = unknown_names(study)
    end = f"; the {listed(unknown, 9)} {_were(len(unknown))} not recorded" if unknown else ""
    return f"{counted(len(study), 'sample')} of {what}{where} {_were(len(study))} imported{end}."


def quality_sentence(results: Results) -> str:
    """Return the sentence about completeness, the problems that the check found, and the noise in the variance."""
    reports = results.reports
    present, planned = sum(report.presses for report in reports), sum(report.planned for report in reports)
    if results.collection.info.protocol is None:
        parts = [f"{counted(present, 'sample')} {_were(present)} checked"]
    elif present == planned:
        parts = [f"All {planned:,} planned presses are present" if planned > 1 else "The planned press is present"]
    else:
        parts = [f"{present:,} of {planned:,} planned presses are present"]
    outside = sum(report.out_of_band for report in reports)
    if outside:
        parts.append(f"in {outside:,} of them the force is outside its band")
    findings = Counter(finding.kind for report in reports for finding in report.findings)
    if findings:
        kinds = listed(f"{kind} {count:,}" for kind, count in findings.most_common())
        runs = f"{len(_with_findings(reports)):,} of {counted(len(reports), 'run')}"
        parts.append(f"the check found {counted(findings.total(), 'problem')} in {runs} ({kinds})")
    else:
        parts.append("the check found no problem")
    table = results.textures
    known = table[table["noise_alone"].notna() & (table["variance"] > 0.0)]
    if len(known) and results.variance:
        fraction = float(known["noise_alone"].sum() / known["variance"].sum())
        bound = "" if results.variance.floor_sources == [FRAMES] else "at most "
        parts.append(f"sensor noise alone causes {bound}{min(100.0, 100.0 * fraction):.0f} % of the variance")
    elif results.variance:
        parts.append("how much of the variance is sensor noise is unknown")
    return f"{'; '.join(parts)}."


def printing_sentence(results: Results) -> str:
    """Return the sentence that says whether each printer is repeatable."""
    if results.variance is None:
        return f"Nothing can be said about the prints: {results.no_variance}."
    answers = []
    for row in _printer_rows(results):
        ends = "no interval" if row["low"] is None else f"{interval(row['low'], row['high'])} %"
        figure = "" if row["figure"] is None else f" ({short(row['figure'])} %; {ends})"
        answers.append(f"{row['about']}: {row['answer']}{figure}")
    return (
        "Are the prints repeatable, with a standard deviation between prints below "
        f"{100.0 * REPEATABLE:g} % of that between textures? {'; '.join(answers)}."
    )


def textures_sentence(results: Results) -> str:
    """Return the sentences that say which textures can be told apart on prints that training has not seen."""
    if results.leak_free is None:
        of = " without leakage" if results.classifications else ""
        return f"Nothing was classified{of}" + (f": {results.no_classification}." if results.no_classification else ".")
    score = results.score(results.hold_out)
    if score is None:
        return "The classification has no accuracy."
    name = results.leak_free.record.estimators[0]
    ends = TOO_FEW if score["low"] is None else f"{interval(100 * score['low'], 100 * score['high'])} %"
    text = (
        f"{_ESTIMATORS.get(name, name)} predicts {percent(score['accuracy'])} % ({ends}) of the "
        f"{press_words(results.collection)[1]} correctly, {results.shown_hold_out} "
        f"(chance: {percent(results.leak_free.chance)} %)."
    )
    if shown_level(results.hold_out, results.collection.unknown_groups) != results.hold_out:
        text += " This is too high if similar samples are on both sides of the split."
    if results.hold_out != UNSEEN:
        reason = str(results.texture_answers.get("", {}).get("answer", "")).removeprefix(_UNSAID)
        return f"{text} Nothing can be said about prints that training has not seen: {reason}."
    parts = [
        f"{what}: {listed(textures, 6)}"
        for word, what in _TOLD_APART.items()
        if (
            textures := [
                short_texture(t) for t, row in results.texture_answers.items() if row["answer"].startswith(word)
            ]
        )
    ]
    return f"{text} Textures: {'; '.join(parts)}."


def next_steps(results: Results) -> list[str]:
    """Return the next steps, the most urgent first. The last step is the one for a finished study."""
    steps = list(_open_steps(results))
    if results.collection.simulated:
        return [*steps, 'These data are simulated: press real prints with "tacbench acquire".']
    publish = "Then publish" if steps else "Publish"
    return [*steps, f'{publish} the data set together with this report: run "tacbench publish".']


def _open_steps(results: Results) -> Iterator[str]:
    study = results.collection
    planned = study.info.protocol is not None
    found = _with_findings(results.reports)
    judged = [report for report in found if all(finding.kind in JUDGED for finding in report.findings)]
    repair = "repair them or press again" if planned else "repair them"
    look = "compare these frames with the others of their run; only you can tell whether they are wrong"
    for reports, advice in (([report for report in found if report not in judged], repair), (judged, look)):
        if reports:
            many = f"{len(reports):,} runs (listed below under data quality)"
            runs = reports[0].folder.name if len(reports) == 1 else many
            yield f'Look at the problems of {runs} with "tacbench check-runs"; {advice}.'
    if results.no_variance:
        yield f"There is no variance table: {results.no_variance}."
    if results.no_classification:
        yield f"There is no classification: {results.no_classification}."
    if planned and study.pressing.repeats == 1:
        yield (
            "Press each position at least twice: without repeats, differences between prints cannot be separated from "
            "chance."
        )
    prints = {c: max(len(set(study.copy[study.combination == c].tolist())), 1) for c in study.combinations}
    answers = {row["about"]: str(row["answer"]) for row in _printer_rows(results)}
    single = [c for c in study.combinations if study.has("print") and prints[c] == 1]
    if single:
        yield (
            f"Print and press each texture at least twice more on {_printers(single)}: one print does not show how "
            "much prints differ."
        )
    unclear = [c for c in study.combinations if answers.get(name_of(c), "").startswith("unclear")]
    if unclear:
        counts = listed(sorted({prints[c] for c in unclear}))
        yield (
            f"Press more prints of each texture on {_printers(unclear)}: a clear answer needs more than {counts} "
            "prints."
        )
    for combination in study.combinations:
        if answers.get(name_of(combination), "").startswith("no,"):
            yield (
                f"Find out why the prints of {name_of(combination)} differ: compare their print records and the maps "
                "below, and separate differences in placement from differences in printing with "
                '"tacbench variance --register".'
            )
    unseen = {texture: str(row["answer"]) for texture, row in results.texture_answers.items() if texture}
    open_textures = [short_texture(texture) for texture, answer in unseen.items() if answer.startswith("unclear")]
    if open_textures:
        yield f"Press more prints of texture {listed(open_textures, 6)}: the interval is too wide for a clear answer."
    for texture, answer in unseen.items():
        others = {name: value for name, value in results.confusion.get(texture, {}).items() if name != texture}
        if answer == "no" and others:
            other = max(others, key=lambda name: others[name])
            yield (
                f"{texture} is often predicted as {other} ({percent(others[other])} % of its presses): try more "
                "positions or a larger force, or use only one of the two."
            )
    if planned and results.variance and results.variance.floor_sources != [FRAMES]:
        yield "Record stationary frames in contact (stationary_frames in the study file): they give the noise floor."
    if results.leak_free and results.hold_out != UNSEEN and not study.has("print"):
        yield (
            "Import the samples again with their prints and sessions (--columns print=COLUMN,session=COLUMN): only "
            "then can the classifier be tested on prints and sessions that training has not seen."
        )
    if not results.classifications and not results.no_classification:
        yield ("Write the report with a classification: this report does not say which textures can be told apart.")
    unfilled = sum(bool(report.empty_fields) for report in results.reports)
    if planned and unfilled and not study.simulated:
        yield (
            f"Fill in the empty fields of {counted(unfilled, 'print record')} (print.toml) while somebody still knows "
            "the values."
        )


def _printer_rows(results: Results) -> list[Row]:
    """Return the answers to the question whether each printer is repeatable."""
    rows = records(results.variance.tables["printer_answers"]) if results.variance else []
    return [row for row in rows if row["question"] == IS_REPEATABLE]


def _with_findings(reports: Sequence[RunReport]) -> list[RunReport]:
    return [report for report in reports if report.findings]


def _printers(combinations: Sequence[str]) -> str:
    return listed(map(name_of, combinations))


def _were(count: int) -> str:
    return "was" if count == 1 else "were"
