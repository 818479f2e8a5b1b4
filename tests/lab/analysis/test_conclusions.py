"""Test the answers to the main questions with studies whose true answers are known."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.studies import noise_image, texture_image

pytest.importorskip("sklearn")

from tacbench_cad import lab
from tacbench_cad.lab.analysis.conclusions import IS_REPEATABLE, MORE_ALIKE, PRINTS_DIFFER, WHICH_TEXTURES
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock

DrawFrame = Callable[[PrintedBlock, Press | None, np.random.Generator], Frame]
MakeStudy = Callable[..., pd.DataFrame]

ONE = (("ender-3", "pla-plus"),)
SHAPE = (40, 40)
#: Standard deviations of the frames between textures and between repeats.
TEXTURE, REPEAT = 10.0, 0.5


def frames(prints: float, **others: float) -> DrawFrame:
    """Return a function that draws frames with a standard deviation between prints, which may depend on the printer."""

    def image(printed: PrintedBlock, press: Press | None, rng: np.random.Generator) -> Frame:
        texture = np.random.default_rng(int(printed.object_label)).standard_normal(SHAPE)
        own = np.random.default_rng(list(printed.name.encode())).standard_normal(SHAPE)
        between = others.get(printed.printer, prints)
        return 50.0 + TEXTURE * texture + between * own + REPEAT * rng.standard_normal(SHAPE)

    return image


def answers_about(make_study: MakeStudy, between: float, **plan: object) -> dict[str, Any]:
    """Return the answers by their questions; if a question has several answers, the last of them."""
    values = {"prints": ONE, "copies": 4, "textures": (1, 2, 3), "still": 0, "shape": SHAPE, "units": "kPa"}
    study = make_study(**{"image": frames(between), **values, **plan})
    return {answer.question: answer for answer in lab.variance(study).answers.itertuples()}


def test_a_printer_with_similar_prints_is_repeatable(make_study: MakeStudy) -> None:
    result = answers_about(make_study, 1.0, levels=(1, 2))
    repeatable, differ = result[IS_REPEATABLE], result[PRINTS_DIFFER]
    # The true differences between the three textures are known.
    means = [TEXTURE * np.random.default_rng(number).standard_normal(SHAPE) for number in (1, 2, 3)]
    apart = np.mean([np.mean((a - b) ** 2) / 2.0 for a, b in combinations(means, 2)])
    expected = 100.0 / float(np.sqrt(apart))
    assert repeatable.figure == pytest.approx(expected, rel=0.05)
    assert repeatable.low < expected < repeatable.high
    assert (repeatable.about, repeatable.answer) == ("ender-3 pla-plus", "yes, below 30 %")
    assert differ.figure == pytest.approx(1.0 + (1.0 / REPEAT) ** 2, rel=0.1)
    assert differ.low > 1.0 and differ.answer == "yes"


def test_a_printer_whose_prints_differ_like_textures_is_not_repeatable(make_study: MakeStudy) -> None:
    result = answers_about(make_study, TEXTURE)[IS_REPEATABLE]
    assert result.figure == pytest.approx(100.0, rel=0.15) and result.answer == "no, above 30 %"


def test_equal_prints_are_not_shown_to_differ(make_study: MakeStudy) -> None:
    result = answers_about(make_study, 0.0)
    differ = result[PRINTS_DIFFER]
    assert differ.low == 1.0 and differ.high < 1.2
    assert differ.answer.startswith("not shown; at most 1.")
    assert result[IS_REPEATABLE].low == 0.0 and result[IS_REPEATABLE].answer == "yes, below 30 %"


@pytest.mark.parametrize(
    ("plan", "reason"),
    [
        ({"copies": 1}, "cannot be said: there is only one print of each texture; press at least two"),
        ({"textures": (1,)}, "cannot be said: there are no differences between textures to compare with"),
    ],
)
def test_an_impossible_answer_has_a_reason(make_study: MakeStudy, plan: dict[str, object], reason: str) -> None:
    result = answers_about(make_study, 1.0, **plan)[IS_REPEATABLE]
    assert pd.isna(result.figure) and result.answer == reason


def test_one_repeat_gives_no_answer_about_prints(make_study: MakeStudy) -> None:
    study = make_study(still=0)
    answers = lab.variance(study[study["repeat"] == 1]).answers
    assert set(answers.loc[answers["question"] != MORE_ALIKE, "answer"]) == {
        "cannot be said: there is only one repeat; press each position at least twice"
    }


TWO = (("ender", "pla"), ("bambu", "pla"))


def test_the_printer_with_more_similar_prints_is_named(make_study: MakeStudy) -> None:
    result = answers_about(make_study, 1.0, prints=TWO, image=frames(1.0, ender=4.0))[MORE_ALIKE]
    assert result.about == "both printers" and result.answer.startswith("bambu pla (p 0.")
    assert result.figure == pytest.approx(16.0, rel=0.2) and pd.isna(result.low) and pd.isna(result.high)


@pytest.mark.parametrize(
    ("plan", "answer"),
    [({}, "not shown (p 0."), ({"textures": (1,), "copies": 2}, "cannot be said: too few prints")],
)
def test_equal_printers_and_too_few_prints_have_no_winner(
    make_study: MakeStudy, plan: dict[str, object], answer: str
) -> None:
    assert answers_about(make_study, 1.0, prints=TWO, **plan)[MORE_ALIKE].answer.startswith(answer)


def textures(make_study: MakeStudy, image: DrawFrame, **settings: Any) -> pd.DataFrame:
    study = make_study(copies=3, textures=(1, 2, 3), still=0, image=image)
    how = lab.ClassificationSettings(**{"components": 5, "hold_out": ("copy",), **settings})
    return lab.classify(study, lab.Pixels(resolution=0.5), how, trials=1).answers


@pytest.mark.usefixtures("few_trees", "single_thread")
def test_textures_on_unseen_prints_are_distinguished_or_not(make_study: MakeStudy) -> None:
    result = textures(make_study, texture_image)
    assert result["about"].tolist() == ["texture-1", "texture-2", "texture-3"]
    assert set(result["answer"]) == {"yes"} and (result["low"] > 50.0).all()
    assert "yes" not in set(textures(make_study, noise_image)["answer"])
    none = textures(make_study, texture_image, hold_out=("press",)).iloc[0]
    assert (none["question"], none["answer"]) == (
        WHICH_TEXTURES,
        "cannot be said: hold-out level copy was not computed",
    )


def test_the_shown_tables_begin_with_the_answers(make_study: MakeStudy) -> None:
    name, first = next(iter(lab.variance(make_study(still=0)).shown()))
    assert name == "printer_answers"
    assert first.frame["question"].tolist() == [IS_REPEATABLE, "", PRINTS_DIFFER, "", MORE_ALIKE]
