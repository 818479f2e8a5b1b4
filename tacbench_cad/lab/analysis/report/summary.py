"""The first screen of a report: five sentences with the main numbers of its tables, and the next steps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.conclusions import IS_REPEATABLE, REPEATABLE
from tacbench_cad.lab.analysis.report.facts import press_words, prints_by_group, unknown_names
from tacbench_cad.lab.analysis.report.results import UNSEEN, Results
from tacbench_cad.lab.analysis.tables import percent, records
from tacbench_cad.lab.analysis.variance.cells import FRAMES, name_of, short_texture
from tacbench_cad.lab.runs.quality import JUDGED
from tacbench_cad.util.text import counted, interval, short

#: The largest number of names in a sentence; the sentence only counts the others.
_MAX_NAMES = 3
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
    """Return the sentence about the presses. For other people's samples it contains only the known facts."""
    design = results.design
    on = f" on {listed(map(name_of, design.combinations))}" if design.has("printer") or design.has("filament") else ""
    count = design.presses["run"].nunique()
    prints = f"{counted(count, 'print')} of " if design.has("print") else ""
    levels = listed(map(design.level_name, design.levels), 4)
    positions = counted(len(design.positions_mm), "position")
    if design.planned:
        how = f"{positions}, {levels}, {counted(design.repeats, 'repeat')}"
        textures = counted(len(design.textures), "texture")
        return f"{prints}{textures}{on} {_were(count)} pressed {counted(len(design), 'time')} ({how})."
    labels = counted(len(design.textures), "label")
    what = f"{prints}{labels}{on}" if design.has("label") else f"unlabelled objects{on}"
    where = f", at {positions}" * design.has("position") + f", {levels}" * design.has("force")
    unknown = unknown_names(design)
    end = f"; the {listed(unknown, 9)} {_were(len(unknown))} not recorded" if unknown else ""
    return f"{counted(len(design), 'sample')} of {what}{where} {_were(len(design))} imported{end}."


def quality_sentence(results: Results) -> str:
    """Return the sentence about completeness, the problems that the check found, and the noise in the variance."""
    reports = results.reports
    present, planned = sum(report.presses for report in reports), sum(report.planned for report in reports)
    parts = [f"{present:,} of {planned:,} planned presses are present"]
    if not results.design.planned:
        parts = [f"{counted(present, 'sample')} {_were(present)} checked"]
    elif present == planned:
        parts = [f"All {planned:,} planned presses are present" if planned > 1 else "The planned press is present"]
    outside = sum(report.out_of_band for report in reports)
    parts += [f"in {outside:,} of them the force is outside its band"] if outside else []
    findings = Counter(finding.kind for report in reports for finding in report.findings)
    problem = "no problem"
    if findings:
        kinds = listed(f"{kind} {count:,}" for kind, count in findings.most_common())
        found = sum(bool(report.findings) for report in reports)
        problem = f"{counted(findings.total(), 'problem')} in {found:,} of {counted(len(reports), 'run')} ({kinds})"
    parts.append(f"the check found {problem}")
    known = results.textures.dropna(subset="noise_alone")
    known = known[known["variance"] > 0.0]
    if len(known) and results.variance:
        fraction = float(known["noise_alone"].sum() / known["variance"].sum())
        bound = "" if results.floor_sources == {FRAMES} else "at most "
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
    score = results.score
    if results.leak_free is None or score is None:
        of = " without leakage" if results.classifications else ""
        return f"Nothing was classified{of}" + (f": {results.no_classification}." if results.no_classification else ".")
    name = results.leak_free.settings.estimators[0]
    ends = TOO_FEW if score["low"] is None else f"{interval(100 * score['low'], 100 * score['high'])} %"
    text = (
        f"{_ESTIMATORS.get(name, name)} predicts {percent(score['accuracy'])} % ({ends}) of the "
        f"{press_words(results.design)[1]} correctly, {results.shown_hold_out} "
        f"(chance: {percent(results.leak_free.record.chance)} %)."
    )
    if results.may_leak:
        text += " This is too high if similar samples are on both sides of the split."
    if results.hold_out != UNSEEN:
        reason = str(results.texture_answers.get("", {}).get("answer", "")).removeprefix(_UNSAID)
        return f"{text} Nothing can be said about prints that training has not seen: {reason}."
    parts = [(what, _textures(results, word)) for word, what in _TOLD_APART.items()]
    return f"{text} Textures: {'; '.join(f'{what}: {names}' for what, names in parts if names)}."


def next_steps(results: Results) -> list[str]:
    """Return the next steps, the most urgent first. The last step is the one for a finished study."""
    steps = list(_open_steps(results))
    if results.design.simulated:
        return [*steps, 'These data are simulated: press real prints with "tacbench acquire".']
    publish = "Then publish" if steps else "Publish"
    return [*steps, f'{publish} the data set together with this report: run "tacbench publish".']


def _open_steps(results: Results) -> Iterator[str]:
    design = results.design
    found = [report for report in results.reports if report.findings]
    judged = [report for report in found if all(finding.kind in JUDGED for finding in report.findings)]
    repair = "repair them or press again" if design.planned else "repair them"
    look = "compare these frames with the others of their run; only you can tell whether they are wrong"
    for reports, advice in (([report for report in found if report not in judged], repair), (judged, look)):
        if reports:
            many = f"{len(reports):,} runs (listed below under data quality)"
            runs = reports[0].folder.name if len(reports) == 1 else many
            yield f'Look at the problems of {runs} with "tacbench check-runs"; {advice}.'
    if design.planned and design.repeats == 1:
        yield "Press each position at least twice: without repeats, prints cannot be separated from chance."
    yield from _printer_steps(results)
    if names := _textures(results, "unclear"):
        yield f"Press more prints of texture {names}: the interval is too wide for a clear answer."
    for texture, row in results.texture_answers.items():
        others = {name: value for name, value in results.confusion.get(texture, {}).items() if name != texture}
        if row["answer"] == "no" and others:
            other = max(others, key=lambda name: others[name])
            yield (
                f"{texture} is often predicted as {other} ({percent(others[other])} % of its presses): try more "
                "positions or a larger force, or use only one of the two."
            )
    if design.planned and results.variance and results.floor_sources != {FRAMES}:
        yield "Record stationary frames in contact (stationary_frames in the study file): they give the noise floor."


def _printer_steps(results: Results) -> Iterator[str]:
    """Yield the steps that the numbers of prints and the answers about the printers suggest."""
    of_textures = prints_by_group(results.design, "combination", "texture")["copy"].nunique()
    answers = {row["about"]: str(row["answer"]) for row in _printer_rows(results)}
    for combination, prints in of_textures.groupby(level=0, observed=True).max().items():
        name = name_of(str(combination))
        answer = answers.get(name, "")
        if prints == 1 and results.design.has("print"):
            yield f"Press at least two more prints of each texture on {name}: one does not show how much prints differ."
        elif answer.startswith("unclear"):
            yield f"Press more prints of each texture on {name}: a clear answer needs more than {prints} prints."
        elif answer.startswith("no,"):
            yield (
                f"Find out why the prints of {name} differ: compare their print records and the maps below, and "
                'separate differences in placement from differences in printing with "tacbench variance --register".'
            )


def _printer_rows(results: Results) -> list[Mapping[str, Any]]:
    """Return the answers to the question whether each printer is repeatable."""
    rows = records(results.variance.answers) if results.variance else []
    return [row for row in rows if row["question"] == IS_REPEATABLE]


def _textures(results: Results, word: str) -> str:
    """Return the textures whose answer begins with a word; an empty text if there is none."""
    answers = results.texture_answers.items()
    return listed((short_texture(name) for name, row in answers if name and row["answer"].startswith(word)), 6)


def _were(count: int) -> str:
    return "was" if count == 1 else "were"
