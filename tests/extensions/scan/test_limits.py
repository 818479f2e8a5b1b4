"""The limits of a print, from options and files, and the verdict."""

from __future__ import annotations

from pathlib import Path

import pytest

from tacbench_cad.extensions.scan.limits import NAMES, Limits, limits_of, verdict
from tacbench_cad.util.errors import InputError


def test_a_file_changes_the_defaults_and_later_words_change_the_file(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text('[limits]\ntop_95_mm = 0.1\nwall_outward_mm = "none"\n', encoding="utf-8")
    limits = limits_of([str(path), "top_95_mm=0.2"])
    assert (limits.top_95_mm, limits.wall_outward_mm) == (0.2, None)
    assert limits.pin_shift_px == Limits().pin_shift_px


@pytest.mark.parametrize(
    ("word", "message"),
    [("top_rms=1", "top_rms_mm"), ("top_rms_mm=x", "number"), ("top_rms_mm=-1", "at least 0"), ("nan", "NAME=VALUE")],
)
def test_a_wrong_limit_is_refused(word: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        limits_of([word])


def test_the_verdict_names_what_exceeds_its_limit() -> None:
    limits = limits_of(["top_rms_mm=0.05"])
    values = {"pin_shift_px": 0.05, "top_rms_mm": 0.06, "unseen_fraction": 0.1}
    result = verdict(values, limits)
    assert not result.ok
    assert str(result).startswith("beyond the limits: rms deviation of the top 60 µm (limit 50 µm)")
    assert str(result).endswith("distance outside of the nominal walls unknown")
    good = verdict({**values, "top_rms_mm": 0.04}, limits)
    assert good.ok and str(good).startswith("within the limits: ")
    nothing = verdict(values, limits_of([f"{name}=none" for name in NAMES]))
    assert nothing.ok and str(nothing) == "no limits were set"
