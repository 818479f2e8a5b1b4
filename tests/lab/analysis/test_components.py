"""Test variance components: expected coefficients, unbiasedness, agreement with other programs, unbalanced designs."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from tacbench_cad.lab.analysis.variance.components import (
    LEVELS,
    LIMIT_FACTOR,
    Component,
    NestedSums,
    component_rows,
    components,
    precision,
)
from tacbench_cad.util.types import Floats, Ints

TRUE = (4.0, 2.0, 1.0, 0.5)


def groups_of(labels: Ints) -> list[Ints]:
    """Return the group of each press at each depth: all, texture, printer, print, press."""
    named = [np.unique(labels[:, :depth], axis=0, return_inverse=True)[1].reshape(-1) for depth in (1, 2, 3)]
    return [np.zeros(len(labels), dtype=np.int64), *named, np.arange(len(labels))]


def sums_of_squares(values: ArrayLike, labels: ArrayLike) -> NestedSums:
    """Return the nested sums of squares of presses in memory, computed in two passes."""
    pixels, names = np.asarray(values, dtype=np.float64), np.asarray(labels)
    means = [
        np.stack([pixels[groups == group].mean(axis=0) for group in range(groups.max() + 1)])[groups]
        for groups in groups_of(names)
    ]
    squares = [float(((fine - coarse) ** 2).sum(axis=0).mean()) for coarse, fine in itertools.pairwise(means)]
    return NestedSums.of(names, squares)


def balanced(textures: int, printers: int, prints: int, repeats: int) -> Ints:
    design = itertools.product(range(textures), range(printers), range(prints), range(repeats))
    return np.array([row[:3] for row in design])


def simulated(labels: Ints, pixels: int, rng: np.random.Generator) -> Floats:
    values = np.zeros((len(labels), pixels))
    for groups, true in zip(groups_of(labels)[1:], TRUE, strict=True):
        values += math.sqrt(true) * rng.standard_normal((groups.max() + 1, pixels))[groups]
    return values + 100.0


def variances(labels: Ints, values: Floats) -> list[float | None]:
    return [component.variance for component in components(sums_of_squares(values, labels))]


UNBALANCED = np.delete(balanced(3, 3, 3, 3), [1, 2, 4, 9, 10, 11, 12, 30, 31, 54, 55, 56, 57, 58, 80], axis=0)


@pytest.mark.parametrize("labels", [balanced(3, 3, 2, 2), UNBALANCED], ids=["balanced", "unbalanced"])
def test_the_estimates_are_unbiased(labels: Ints) -> None:
    # Independent pixels act as independent studies; the mean over 40,000 of them approximates the expectation.
    values = simulated(labels, 40_000, np.random.default_rng(1))
    for estimate, true, name in zip(variances(labels, values), TRUE, LEVELS, strict=True):
        assert estimate == pytest.approx(true, rel=0.03 if name != "texture" else 0.05), name


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(*[st.integers(0, 2)] * 3), min_size=2, max_size=25))
def test_coefficients_equal_the_expected_sums_of_squares(rows: list[tuple[int, int, int]]) -> None:
    labels = np.array(rows)
    # The exact expectation for unit component l is the trace of the sum of squares with that component's covariance.
    sums = sums_of_squares(np.eye(len(labels)), labels)
    for depth, groups in enumerate(groups_of(labels)[1:]):
        indicator = (groups[:, None] == np.unique(groups)[None, :]).astype(float)
        unit = sums_of_squares(indicator, labels).squares * indicator.shape[1]
        np.testing.assert_allclose(unit, sums.coefficients[:, depth], atol=1e-9)


def test_the_parts_add_up_to_the_total_sum_of_squares() -> None:
    values = simulated(UNBALANCED, 7, np.random.default_rng(2))
    total = ((values - values.mean(axis=0)) ** 2).sum(axis=0).mean()
    assert sums_of_squares(values, UNBALANCED).squares.sum() == pytest.approx(total, rel=1e-12)


def test_pooling_positions_of_a_balanced_design_is_their_mean() -> None:
    labels, rng = balanced(2, 2, 2, 2), np.random.default_rng(3)
    places = [sums_of_squares(simulated(labels, 50, rng), labels) for _ in range(3)]
    pooled = [component.variance for component in components(places[0] + places[1] + places[2])]
    estimates = np.array([[component.variance for component in components(sums)] for sums in places], dtype=np.float64)
    means = estimates.mean(axis=0)
    np.testing.assert_allclose(np.array(pooled, dtype=float), means, rtol=1e-12)


def test_copies_numbered_alike_on_two_printers_are_different_prints() -> None:
    labels = balanced(2, 2, 3, 2)
    renumbered = labels.copy()
    renumbered[:, 2] += 10 * renumbered[:, 1] + 100 * renumbered[:, 0]
    values = simulated(labels, 5, np.random.default_rng(4))
    assert variances(labels, values) == variances(renumbered, values)


def test_agrees_with_the_mixed_model_of_statsmodels() -> None:
    pandas = pytest.importorskip("pandas")
    formula = pytest.importorskip("statsmodels.formula.api")
    labels = balanced(5, 3, 3, 2)
    values = simulated(labels, 1, np.random.default_rng(11))
    ours = variances(labels, values)
    assert (
        min(estimate for estimate in ours if estimate is not None) > 0.0
    )  # REML equals ANOVA if no component is cut at 0
    frame = pandas.DataFrame(labels, columns=["texture", "printer", "copy"]).astype(str).assign(y=values[:, 0])
    frame["printer"] = frame["texture"] + frame["printer"]
    frame["copy"] = frame["printer"] + frame["copy"]
    model = formula.mixedlm(
        "y ~ 1",
        frame,
        groups="texture",
        re_formula="1",
        vc_formula={"printer": "0 + C(printer)", "print": "0 + C(copy)"},
    )
    fit = model.fit(reml=True, method=["lbfgs", "powell"])
    by_name = dict(zip(model.exog_vc.names, fit.vcomp, strict=True))
    theirs = [float(fit.cov_re.iloc[0, 0]), by_name["printer"], by_name["print"], fit.scale]
    np.testing.assert_allclose(np.array(ours, dtype=float), theirs, rtol=2e-3)


def test_agrees_with_the_intraclass_correlation_of_pingouin() -> None:
    pandas = pytest.importorskip("pandas")
    pingouin = pytest.importorskip("pingouin")
    labels = balanced(1, 1, 8, 3)
    values = simulated(labels, 1, np.random.default_rng(5))
    result = {component.name: component.variance for component in components(sums_of_squares(values, labels))}
    assert result["print"] is not None and result["repeat"] is not None
    frame = pandas.DataFrame({"print": labels[:, 2], "repeat": np.tile(range(3), 8), "y": values[:, 0]})
    table = pingouin.intraclass_corr(frame, targets="print", raters="repeat", ratings="y")
    theirs = float(table.set_index("Type").loc["ICC(1,1)", "ICC"])
    assert result["print"] / (result["print"] + result["repeat"]) == pytest.approx(theirs, abs=1e-6)


def test_a_negative_estimate_is_kept_next_to_a_truncated_one() -> None:
    labels = balanced(1, 1, 2, 2)
    result = {
        component.name: component for component in components(sums_of_squares([[1.0], [3.0], [3.0], [1.0]], labels))
    }
    assert result["print"].variance == pytest.approx(-1.0)
    assert result["print"].truncated == 0.0
    assert "negative" in result["print"].note
    deviations = precision(tuple(result.values()))
    assert deviations["repeatability"] == deviations["intermediate"] == pytest.approx(math.sqrt(2.0))
    assert LIMIT_FACTOR == 2.8


@pytest.mark.parametrize(
    ("labels", "missing", "includes"),
    [
        (balanced(1, 2, 3, 2), {"texture": "only one texture; no estimate"}, {}),
        (
            balanced(3, 1, 3, 2),
            {"printer": "only one printer-filament; included in the component of the texture"},
            {"texture": ("printer",)},
        ),
        (
            balanced(3, 2, 1, 2),
            {"print": "only one print of each block; included in the component of the printer"},
            {"printer": ("print",)},
        ),
        (
            balanced(3, 2, 2, 1),
            {"repeat": "only one repeat; included in the component of the print"},
            {"print": ("repeat",)},
        ),
        (balanced(1, 1, 4, 1), {"texture": "only one texture", "repeat": "only one repeat"}, {"print": ("repeat",)}),
    ],
)
def test_a_level_with_one_member_is_reported_and_merged_into_the_next_coarser_level(
    labels: Ints, missing: dict[str, str], includes: dict[str, tuple[str, ...]]
) -> None:
    result = {
        component.name: component
        for component in components(sums_of_squares(simulated(labels, 3, np.random.default_rng(6)), labels))
    }
    for name, reason in missing.items():
        assert result[name].variance is None and result[name].truncated is None
        assert result[name].note.startswith(reason)
    for name, finer in includes.items():
        assert result[name].includes == finer


def test_merged_components_are_unbiased() -> None:
    labels = balanced(3, 3, 1, 2)
    result = {
        component.name: component.variance
        for component in components(sums_of_squares(simulated(labels, 40_000, np.random.default_rng(7)), labels))
    }
    assert result["printer"] == pytest.approx(TRUE[1] + TRUE[2], rel=0.03)
    assert result["repeat"] == pytest.approx(TRUE[3], rel=0.03)


def test_a_single_press_has_no_component() -> None:
    result = components(sums_of_squares([[1.0, 2.0]], [[0, 0, 0]]))
    assert [component.variance for component in result] == [None] * 4
    assert precision(result)["reproducibility"] is None


def test_constant_frames_have_components_of_zero() -> None:
    labels = balanced(2, 2, 2, 2)
    assert variances(labels, np.full((len(labels), 4), 7.0)) == [0.0] * 4


def test_reproducibility_needs_the_printers() -> None:
    def make_components(**values: float | None) -> tuple[Component, ...]:
        return tuple(Component(name=name, variance=values.get(name), dof=1) for name in LEVELS)

    deviations = precision(make_components(texture=9.0, printer=3.0, print=2.0, repeat=4.0))
    assert deviations == {"repeatability": 2.0, "intermediate": pytest.approx(math.sqrt(6.0)), "reproducibility": 3.0}
    assert precision(make_components(print=2.0, repeat=4.0))["reproducibility"] is None


def test_rows_have_the_columns_of_the_csv_file() -> None:
    result = components(sums_of_squares(simulated(UNBALANCED, 3, np.random.default_rng(8)), UNBALANCED))
    rows = component_rows(2, result, {"print": (0.5, 3.0)})
    assert [row["component"] for row in rows] == [*LEVELS, "repeatability", "intermediate", "reproducibility"]
    columns = {"force_level", "component", "variance", "truncated", "low", "high", "degrees_of_freedom"}
    assert all(set(row) == columns | {"includes", "note"} for row in rows)
    assert (rows[2]["low"], rows[2]["high"]) == (0.5, 3.0)
    assert rows[4]["variance"] == pytest.approx(rows[3]["truncated"])
