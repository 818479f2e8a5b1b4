"""Test the comparison of a firmware's settings with those that a press rig needs."""

from __future__ import annotations

import pytest

from tacbench_cad.lab.rig.firmware_settings import FirmwareSetting, grbl_settings, marlin_settings
from tacbench_cad.lab.rig.marlin_replies import soft_end_stops
from tacbench_cad.lab.study.spec import StageSettings

#: The settings of a CNC machine after a fresh installation of GRBL 1.1h.
DEFAULTS = {
    1: 25, 10: 1, 13: 0, 20: 0, 21: 0, 22: 0, 23: 0, 27: 1, 100: 250, 101: 250, 102: 250, 110: 500, 111: 500, 112: 500,
    120: 10, 121: 10, 122: 10, 130: 200, 131: 200, 132: 200,
}  # fmt: skip
PREPARED = {
    **DEFAULTS, 1: 255, 20: 1, 21: 1, 22: 1, 23: 3, 100: 800, 101: 800, 102: 1600, 110: 1200, 111: 1200, 112: 1200,
    120: 100, 121: 100, 122: 100, 132: 45,
}  # fmt: skip
LIMITS = ((-199.0, -1.0), (-199.0, -1.0), (-44.0, -1.0))


def checked(values: dict[int, float], limits: tuple[tuple[float, float], ...] = LIMITS) -> dict[str, FirmwareSetting]:
    stage = StageSettings(driver="grbl", limits_mm=limits)  # type: ignore[arg-type]
    return {row.name: row for row in grbl_settings(values, counts_from_switch=True, stage=stage)}


def test_a_fresh_grbl_needs_four_changes() -> None:
    rows = checked(dict(DEFAULTS))
    assert [row.change for row in rows.values() if row.change] == ["$1=255", "$22=1", "$20=1", "$21=1"]
    assert all(rows[f"${number}"].reason.startswith("this is GRBL's default") for number in (100, 101, 102))
    assert "1200 mm/min" in rows["$110"].reason and "short steps" in rows["$122"].reason
    assert set(rows) == {f"${number}" for number in DEFAULTS if number != 10}


def test_a_prepared_grbl_needs_none() -> None:
    assert [row for row in checked(dict(PREPARED)).values() if row.change or row.reason] == []


@pytest.mark.parametrize(
    ("number", "value", "change"),
    [(23, 7, "$23=3"), (27, 0.1, "$27=1"), (13, 1, "$13=0"), (21, 0, "$21=1"), (22, 2, "$22=3"), (22, 32, "$22=33")],
)
def test_wrong_settings_have_a_command_and_a_reason(number: int, value: float, change: str) -> None:
    row = checked({**PREPARED, number: value})[f"${number}"]
    assert row.change == change and row.reason


@pytest.mark.parametrize("value", [1, 3, 33, 127])
def test_homing_of_grblhal_is_bit_0_of_a_field(value: int) -> None:
    row = checked({**PREPARED, 22: value})["$22"]
    assert (row.value, row.change, row.reason) == (str(value), "", "")


@pytest.mark.parametrize(
    ("limits", "axis", "reason"),
    [
        (((0.0, 200.0), *LIMITS[1:]), 0, "this build allows only -200 to 0"),
        ((*LIMITS[:2], (-44.0, 0.0)), 2, "the end stop closes at 0, so end them at -1"),
        ((*LIMITS[:2], (-60.0, -1.0)), 2, "longer than the travel"),
    ],
)
def test_limits_are_compared_with_the_travel(limits: tuple[tuple[float, float], ...], axis: int, reason: str) -> None:
    rows = checked(dict(PREPARED), limits)
    assert reason in rows[f"${130 + axis}"].reason
    assert sum(bool(row.reason) for row in rows.values()) == 1


#: The answer to M211 of Marlin 2.0 and of 2.1.
MARLIN_20 = ["echo:Soft endstops: On  Min:  X:0.00 Y:0.00 Z:0.00   Max:  X:220.00 Y:220.00 Z:250.00"]
MARLIN_21 = [
    "echo:; Soft endstops:",
    "echo:  M211 S0 ; OFF",
    "echo:  Min:  X0.00 Y-2.00 Z0.00   Max:  X220.00 Y220.00 Z250.00",
]


def test_the_soft_end_stops_of_marlin_are_read_in_both_layouts() -> None:
    assert soft_end_stops(MARLIN_20) == (True, (0.0, 0.0, 0.0), (220.0, 220.0, 250.0))
    assert soft_end_stops(MARLIN_21) == (False, (0.0, -2.0, 0.0), (220.0, 220.0, 250.0))
    assert soft_end_stops(['echo:Unknown command: "M211"']) is None


def test_a_prepared_marlin_needs_no_change() -> None:
    stage = StageSettings(driver="marlin", limits_mm=((0.0, 220.0), (0.0, 220.0), (20.0, 200.0)), travel_mm_s=5.0)
    rows = marlin_settings(
        steps_per_mm=(80.0, 80.0, 400.0),
        speeds_mm_s=(500.0, 500.0, 5.0),
        soft_end_stops=soft_end_stops(MARLIN_20),
        stage=stage,
    )
    assert len(rows) == 10
    assert [row for row in rows if row.change or row.reason] == []


def test_wrong_settings_of_marlin_are_named() -> None:
    stage = StageSettings(driver="marlin", limits_mm=((0.0, 220.0), (0.0, 220.0), (20.0, 300.0)))
    rows = {
        row.name: row
        for row in marlin_settings(
            steps_per_mm=(80.0, 80.0, 100.0),
            speeds_mm_s=(500.0, 500.0, 5.0),
            soft_end_stops=soft_end_stops(MARLIN_21),
            stage=stage,
        )
        if row.reason
    }
    assert rows["M211"].change == "M211 S1"
    assert rows["M211 Z"].reason == "[stage] limits_mm of z are [20, 300], beyond the soft end stops; shorten them"
    assert "10.0 micrometres is too coarse" in rows["M92 Z"].reason
    assert "20 mm/s" in rows["M203 Z"].reason
    assert len(rows) == 4
    assert [row.value for row in marlin_settings(steps_per_mm=None, speeds_mm_s=None, soft_end_stops=None)] == [
        "unknown"
    ]


@pytest.mark.usefixtures("rig_time")
def test_the_virtual_marlin_lists_its_settings() -> None:
    from helpers.rig_here import launch

    from tacbench_cad.lab.rig.probing import identify

    with launch("marlin", speed=20.0) as virtual:
        answer = identify(virtual.port)
    rows = {row.name: row for row in answer.settings}
    assert rows["M211"].value == "on" and rows["M211 Z"].value == "0 to 100"
    assert rows["M92 Z"].value == "400"
