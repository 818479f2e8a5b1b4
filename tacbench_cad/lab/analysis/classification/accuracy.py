"""The accuracies of estimators, with intervals whose units are prints and other held-out groups.

All tables are computed from the predictions, which have a row for each tested frame and the columns
:data:`PREDICTIONS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW, correlation_of, interval_of
from tacbench_cad.lab.analysis.classification.hold_out import shown_level, unit_name
from tacbench_cad.lab.analysis.conclusions import RIGHT, TOLD_APART, WHICH_TEXTURES, Answer, answer_table
from tacbench_cad.lab.analysis.tables import Shown, intervals, percent, records

#: ``tested_on`` of a row that contains a whole hold-out level, not a single held-out group.
ALL = "all"
#: The columns that name a row: how it was trained, and on what it was tested.
WHO = ["estimator", "train_on", "hold_out"]
#: The columns of the predictions: the estimator; the training data; the held-out group; the hold-out level, or
#: ``train``, ``test`` or ``unseen`` in the paper's protocol; the trial, from 1; the run and the number of the press;
#: the unit of the interval to which it belongs at this level; the copy of the frame; its texture; and the predicted
#: one.
PREDICTIONS = [
    *("estimator", "train_on", "tested_on", "hold_out", "trial"),
    *("run", "press", "unit", "augmentation", "texture", "predicted"),
]
#: The columns of the accuracies.
SCORES = [
    *("estimator", "train_on", "tested_on", "hold_out", "accuracy", "standard_deviation", "low", "high"),
    *("units", "trials", "images"),
]


def _tallied(predictions: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each press of one hold-out level: the numbers of tests and of correct predictions."""
    right = predictions.assign(right=predictions["texture"] == predictions["predicted"])
    first = dict.fromkeys(["texture", "unit", "tested_on"], "first")
    tallied = right.groupby(["run", "press"], sort=False).agg({"right": ["size", "sum"], **first})
    tallied.columns = pd.Index(["tries", "correct", *first])
    return tallied.reset_index()


def scores(predictions: pd.DataFrame, unknown_groups: Sequence[str] = ()) -> pd.DataFrame:
    """Return the accuracies: for each hold-out level (or column of the paper) the total, then each held-out group.

    All rows of a level have intervals from one correlation of the presses of a unit. The unit of a group's interval is
    the print; if prints are unknown, it is the recording, or else the sample.

    Args:
        predictions: The predictions.
        unknown_groups: See :attr:`.Design.unknown_groups`.

    Returns:
        ``accuracy`` is the fraction of tested rows that were predicted correctly, over all trials, and
        ``standard_deviation`` that of the trials' accuracies; ``units`` is the number and the name of the interval's
        units, ``24 prints``; and ``images`` is the number of different presses. What is unknown is missing.
    """
    rows = []
    for keys, level in predictions.groupby(WHO, sort=False):
        presses, right = _tallied(level), level["texture"] == level["predicted"]
        for group in dict.fromkeys([ALL, *presses["tested_on"]]):
            mine, part = presses, right
            name, unit = unit_name(str(keys[2]), unknown_groups), presses["unit"].to_numpy()
            if group != ALL:
                mine, part = presses[presses["tested_on"] == group], right[level["tested_on"] == group]
                name = unit_name("copy", unknown_groups)
                unit = presses["run"].to_numpy() if name != "samples" else np.arange(len(presses))
            correlation = correlation_of(presses["correct"], presses["tries"], unit, presses["texture"].to_numpy())
            accuracy, sizes = float(part.mean()), np.unique(unit[mine.index], return_counts=True)[1]
            trials = part.groupby(level["trial"]).mean()
            ends = (accuracy, trials.std(), *interval_of(accuracy, sizes, correlation))
            rows.append((*keys[:2], group, keys[2], *ends, f"{len(sizes)} {name}", len(trials), len(mine)))
    return pd.DataFrame(rows, columns=SCORES).astype({"low": float, "high": float})


def confusion(predictions: pd.DataFrame, textures: Sequence[str]) -> pd.DataFrame:
    """Return how often each texture was predicted as each texture at each hold-out level, over all trials.

    ``fraction`` is the part of the rows of a texture; it is missing for a texture that was not tested.
    """
    names, parts = list(textures), []
    for keys, level in predictions.groupby(WHO, sort=False):
        estimator, train_on, hold_out = map(str, keys)
        counts = pd.crosstab(level["texture"], level["predicted"]).reindex(index=names, columns=names, fill_value=0)
        long = counts.reset_index().melt(id_vars="texture", value_name="count")
        totals = long.groupby("texture")["count"].transform("sum")
        long["fraction"] = long["count"] / totals.where(totals > 0)
        parts.append(long.assign(estimator=estimator, train_on=train_on, hold_out=hold_out))
    return pd.concat(parts, ignore_index=True)[[*WHO, "texture", "predicted", "count", "fraction"]]


def texture_answers(
    predictions: pd.DataFrame, textures: Sequence[str], unknown_groups: Sequence[str], notes: Sequence[str]
) -> pd.DataFrame:
    """Return the answer for each texture: can the first estimator tell it apart on a print never seen in training?

    Args:
        predictions: The predictions with the leak-free protocol.
        textures: The textures.
        unknown_groups: See :attr:`.Design.unknown_groups`.
        notes: The notes of the classification, with the reasons why hold-out levels were left out.
    """
    mine = predictions[predictions["estimator"] == predictions["estimator"].iloc[0]]
    mine = mine[mine["hold_out"] == "copy"]
    if mine.empty:
        reason = next((note for note in notes if "level copy" in note), "hold-out level copy was not computed")
        return answer_table([Answer(question=WHICH_TEXTURES, about="", answer=f"cannot be said: {reason}")])
    table = scores(mine.assign(tested_on=mine["texture"]), unknown_groups)
    of_texture, answers = {row["tested_on"]: row for row in records(table)}, []
    for texture in textures:
        answer, row = "unclear", of_texture.get(texture)
        ends = {} if row is None else {name: row[name] and 100.0 * row[name] for name in ("low", "high")}
        if row is None:
            answer = "cannot be said: none of its prints was held out"
        elif row["low"] is None:
            answer = f"unclear: {TOO_FEW}"
        elif row["low"] > TOLD_APART or row["high"] < TOLD_APART:
            answer = "yes" if row["low"] > TOLD_APART else "no"
        if row is not None:
            ends |= {"figure": 100.0 * row["accuracy"], "unit": RIGHT}
        answers.append(Answer(question=WHICH_TEXTURES, about=texture, answer=answer, **ends))
    return answer_table(answers)


def beside_paper(table: pd.DataFrame) -> pd.DataFrame:
    """Return the accuracies with the protocol as-published beside those of the paper's table, in %.

    Args:
        table: The accuracies from :func:`scores`. The paper's ``unseen`` is beside ``all copies``.
    """
    printed = {
        ("_".join(row.train_on), row.model, column): value
        for row in published.CLASSIFICATION
        for column, value in (("train", row.train), ("test", row.test), ("all copies", row.unseen))
    }
    mine = table[["estimator", "train_on", "hold_out"]].assign(ours=100.0 * table["accuracy"])
    keys = zip(mine["train_on"], mine["estimator"], mine["hold_out"], strict=True)
    return mine.assign(paper=[printed.get(key, np.nan) for key in keys])


def shown_beside_paper(table: pd.DataFrame) -> Shown:
    """Return the rows of :func:`beside_paper` as a table for readers, with a row for each training combination."""
    wide = table.pivot(index=["estimator", "train_on"], columns="hold_out", values=["ours", "paper"])
    wide.columns = pd.Index([f"{column[1]}, {column[0]}" for column in wide.columns])
    title = "your results beside the paper's table, in % (computed as in the authors' notebooks; other copies: "
    return Shown(title + "without copy 1)", wide.dropna(axis="columns", how="all").round(2).reset_index())


def shown_scores(table: pd.DataFrame, unknown_groups: Sequence[str], title: str, parameter: str = "") -> Shown:
    """Return a table of accuracies for readers.

    Args:
        table: The accuracies from :func:`scores`.
        unknown_groups: See :attr:`.Design.unknown_groups`.
        title: The title.
        parameter: The setting of a sweep, whose column is ``value``.
    """
    columns: dict[str, Any] = {
        "estimator": table["estimator"],
        "held out": [shown_level(level, unknown_groups) for level in table["hold_out"]],
        "trained on": table["train_on"],
        **({parameter: table["value"].map("{:g}".format)} if parameter else {"tested on": table["tested_on"]}),
        "accuracy": table["accuracy"].map(percent),
        "standard deviation": table["standard_deviation"].map(percent),
        "95 % interval": intervals(table, empty=TOO_FEW),
        **{name: table[name] for name in ("units", "trials", "images")},
    }
    if table["standard_deviation"].isna().all():
        del columns["standard deviation"]
    return Shown(title, pd.DataFrame(columns))


def recall_table(table: pd.DataFrame, unknown_groups: Sequence[str]) -> Shown:
    """Return the recall of each texture at each hold-out level, from the rows of :func:`confusion`."""
    right = table[table["texture"] == table["predicted"]]
    recall = right.pivot_table(index=WHO, columns="texture", values="fraction", sort=False, dropna=False)
    frame = recall.map(percent).dropna(how="all").reset_index()
    frame["hold_out"] = [shown_level(level, unknown_groups) for level in frame["hold_out"]]
    names = {"hold_out": "held out", "train_on": "trained on"}
    return Shown("recall of each texture (%)", frame.rename(columns=names).rename_axis(columns=None))
