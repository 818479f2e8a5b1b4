"""Test the sentences of a report and the recommended steps for answers of every kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd
import pytest

pytest.importorskip("sklearn")

from tacbench_cad.lab.analysis.classification.accuracy import ALL
from tacbench_cad.lab.analysis.classification.classification import Classification, ClassificationRecord
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.conclusions import IS_REPEATABLE, RIGHT, WHICH_TEXTURES, Answer, answer_table
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.report.summary import (
    listed,
    next_steps,
    pressed_sentence,
    printing_sentence,
    quality_sentence,
    summary,
    textures_sentence,
)
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.variance.cells import FRAMES
from tacbench_cad.lab.analysis.variance.result import Variance
from tacbench_cad.lab.runs.checking import Finding, RunReport
from tacbench_cad.spec.protocol import PressGrid

ENDER, BAMBU = ("ender-3", "pla-plus"), ("bambu-p1p", "pla-minus")
ONE_PLACE = PressGrid(x_mm=(4.0,), y_mm=(18.0,))
PUBLISH = 'the data set together with this report: run "tacbench publish".'


@pytest.fixture(scope="module")
def design(make_study: Callable[..., pd.DataFrame]) -> Design:
    """Return a study of two copies of two textures from each of two printers that is not marked as simulated."""
    return Design.of(make_study(prints=(ENDER, BAMBU), grid=ONE_PLACE, still=1))


def reports(design: Design, *kinds: str, **fields: Any) -> tuple[RunReport, ...]:
    """Return the check's report of each run; all findings belong to the first run."""
    findings = tuple(Finding(kind=kind, where=f"{i}.png", text="is wrong") for i, kind in enumerate(kinds))
    of_runs = [RunReport(folder=run.folder, name="", simulated=(), planned=2, presses=2) for run in design.runs]
    return (replace(of_runs[0], findings=findings, **fields), *of_runs[1:])


def repeatable(about: str, answer: str, figure: float | None = None) -> Answer:
    ends = {} if figure is None else {"low": figure / 2.0, "high": figure * 2.0}
    return Answer(question=IS_REPEATABLE, about=about, figure=figure, answer=answer, **ends)


def variance(design: Design, *rows: Answer, floor_from: str = FRAMES) -> Variance:
    of_cell = {"force_level": 1, "variance": 4.0, "low": 3.0, "high": 5.0, "noise_alone": 1.0, "floor_from": floor_from}
    cells = [
        {"printer": printer, "filament": filament, "texture": texture, "prints": 2, "presses": 4, **of_cell}
        for printer, filament in (ENDER, BAMBU)
        for texture in design.textures
    ]
    tables = {"variance": pd.DataFrame(cells), "printer_answers": answer_table(rows)}
    how = {"feature": Pixels(), "protocol": "paper", "ddof": 0, "seed": 0, "maps": {}, "means": {}}
    return Variance(design=design, tables=tables, outside=None, left_out=(), **how)


def classification(design: Design, hold_out: str, recall: Sequence[float], *rows: Answer) -> Classification:
    """Return a classification with the given accuracies and answers, without predictions."""
    who = {"estimator": "forest", "train_on": "the others", "tested_on": ALL, "hold_out": hold_out}
    score = {**who, "accuracy": sum(recall) / 2.0, "low": 0.25, "high": 0.875}
    first, second = design.textures
    fractions = [(first, first, recall[0]), (first, second, 1.0 - recall[0])]
    fractions += [(second, second, recall[1]), (second, first, 1.0 - recall[1])]
    about = {"features": "", "summary": "frames", "units": "counts", "sensor": "", "simulated": (), "data": ""}
    record = ClassificationRecord(
        settings=ClassificationSettings(), trials=1, textures=design.textures, notes=(), **about
    )
    result = Classification(record=record, predictions=pd.DataFrame())
    confusion = pd.DataFrame([{**who, "texture": a, "predicted": b, "fraction": c} for a, b, c in fractions])
    vars(result).update(table=pd.DataFrame([score]), confusion=confusion, answers=answer_table(rows))
    return result


def texture_answer(texture: str, answer: str, figure: float | None) -> Answer:
    ends = {} if figure is None else {"low": figure - 10.0, "high": figure + 5.0}
    return Answer(question=WHICH_TEXTURES, about=texture, figure=figure, unit=RIGHT, answer=answer, **ends)


@pytest.fixture
def complete(design: Design) -> Results:
    """Return the results of a study without missing information and without problems."""
    rows = [repeatable(name, "yes, below 30 %", 12.5) for name in ("ender-3 pla-plus", "Bambu P1P PLA-")]
    apart = [texture_answer(texture, "yes", 90.0) for texture in design.textures]
    return Results(
        design=design,
        reports=reports(design),
        variance=variance(design, *rows),
        classifications=(classification(design, "copy", (0.9, 0.9), *apart),),
    )


def test_summary_of_a_complete_study(complete: Results) -> None:
    assert summary(complete) == {
        "What was pressed": "8 prints of 2 textures on ender-3 pla-plus and Bambu P1P PLA- were pressed 16 times "
        "(1 position, 0.08 N, 2 repeats).",
        "Data quality": "All 16 planned presses are present; the check found no problem; sensor noise alone causes "
        "25 % of the variance.",
        "Printing": "Are the prints repeatable, with a standard deviation between prints below 30 % of that between "
        "textures? ender-3 pla-plus: yes, below 30 % (12.5 %; 6.25 to 25 %); Bambu P1P PLA-: yes, below 30 % (12.5 %; "
        "6.25 to 25 %).",
        "Telling apart": "A random forest predicts 90.0 % (25 to 87.5 %) of the presses correctly, on unseen prints "
        "(chance: 50.0 %). Textures: told apart: 1 and 2.",
        "What to do next": f"Publish {PUBLISH}",
    }


def test_values_of_a_texture_are_in_the_first_row(complete: Results) -> None:
    table = complete.shown_textures
    assert table.texts[:2] == [
        ["texture-1", "ender-3 pla-plus", "2", "4", "4", "3 to 5", "1", "90.0", "80 to 95"],
        ["", "Bambu P1P PLA-", "2", "4", "4", "3 to 5", "1", "", ""],
    ]
    assert table.heads[-2] == "predicted correctly, on unseen prints (%)"
    assert complete.textures["recall_low"].tolist() == [0.8] * 4


@pytest.mark.parametrize(
    ("words", "text"),
    [((), ""), ("a", "a"), ("ab", "a and b"), ("abcd", "a, b, c and d"), ("abcde", "a, b, c and 2 more")],
)
def test_words_are_joined_to_a_list(words: str, text: str) -> None:
    assert listed(words) == text


@pytest.mark.parametrize(
    ("kinds", "fields", "text"),
    [
        (
            ("dark", "gap", "dark"),
            {"presses": 1},
            "15 of 16 planned presses are present; the check found 3 problems in 1 of 8 ",
        ),
        (("dark", "gap", "dark"), {}, "in 1 of 8 runs (dark 2 and gap 1); sensor noise"),
        ((), {"out_of_band": 3}, "are present; in 3 of them the force is outside its band; the check found no problem"),
    ],
)
def test_quality(complete: Results, kinds: tuple[str, ...], fields: dict[str, int], text: str) -> None:
    bad = replace(complete, reports=reports(complete.design, *kinds, **fields))
    assert text in quality_sentence(bad)
    if kinds:
        run = complete.design.runs[0].folder.name
        assert next_steps(bad)[0].startswith(f'Look at the problems of {run} with "tacbench check-runs"')
        assert next_steps(bad)[-1] == f"Then publish {PUBLISH}"


def test_frames_that_only_look_different_are_not_to_be_left_out_unseen(complete: Results) -> None:
    (step, *_) = next_steps(replace(complete, reports=reports(complete.design, "blurred", "saturated")))
    assert step.endswith("only you can tell whether they are wrong.")
    (step, *_) = next_steps(replace(complete, reports=reports(complete.design, "blurred", "checksum")))
    assert step.endswith("repair them or press again.")


@pytest.mark.parametrize(
    ("answer", "step"),
    [
        ("no, above 30 %", "Find out why"),
        ("unclear", "Press more prints of each texture"),
        ("cannot be said: there is only one repeat; press each position at least twice", ""),
    ],
)
def test_printers(complete: Results, answer: str, step: str) -> None:
    figure = None if answer.startswith("cannot") else 60.0
    rows = repeatable("ender-3 pla-plus", "yes, below 30 %", 10.0), repeatable("Bambu P1P PLA-", answer, figure)
    results = replace(complete, variance=variance(complete.design, *rows))
    assert f"; Bambu P1P PLA-: {answer}" in printing_sentence(results)
    steps = next_steps(results)[:-1]
    assert [step] == [text[: len(step)] for text in steps] if step else not steps
    assert all("Bambu P1P PLA-" in text for text in steps)


def test_confused_and_unclear_textures(complete: Results, design: Design) -> None:
    first, second = design.textures
    rows = texture_answer(first, "no", 30.0), texture_answer(second, "unclear", 60.0)
    results = replace(complete, classifications=(classification(design, "copy", (0.3, 0.6), *rows),))
    assert textures_sentence(results).endswith("(chance: 50.0 %). Textures: not told apart: 1; unclear: 2.")
    assert [step.partition(":")[0] for step in next_steps(results)[:-1]] == [
        "Press more prints of texture 2",
        "texture-1 is often predicted as texture-2 (70.0 % of its presses)",
    ]


def test_without_unseen_prints_the_easier_hold_out_level_is_named(complete: Results, design: Design) -> None:
    reason = Answer(
        question=WHICH_TEXTURES, about="", answer="cannot be said: level copy is left out: one copy; add one"
    )
    results = replace(complete, classifications=(classification(design, "press", (0.5, 0.7), reason),))
    sentence = textures_sentence(results)
    assert sentence.startswith(
        "A random forest predicts 60.0 % (25 to 87.5 %) of the presses correctly, held out: press"
    )
    assert sentence.endswith("prints that training has not seen: level copy is left out: one copy; add one.")
    assert results.shown_textures.heads[-1] == "predicted correctly, held out: press (%)"


def test_missing_results_have_their_reason(design: Design) -> None:
    nothing = Results(design=design, reports=reports(design), no_variance="it needs x; get it", no_classification="y")
    assert printing_sentence(nothing) == "Nothing can be said about the prints: it needs x; get it."
    assert textures_sentence(nothing) == "Nothing was classified: y."


def test_simulated_data_are_not_published(make_study: Callable[..., pd.DataFrame]) -> None:
    presses = make_study(simulated="a formula", copies=1, textures=(1,), prints=(ENDER,), grid=ONE_PLACE, still=0)
    single = Design.of(presses)
    results = Results(design=single, reports=reports(single), variance=variance(single, floor_from=""))
    assert pressed_sentence(results).startswith("1 print of 1 texture on ender-3 pla-plus was pressed 2 times")
    assert [step.partition(" ")[0] for step in next_steps(results)] == ["Press", "Record", "These"]
    assert "sensor noise alone causes at most 25 % of the variance" in quality_sentence(results)
