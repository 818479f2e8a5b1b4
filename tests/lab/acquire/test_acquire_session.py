"""Test the acquisition of a study: trays, labels, resuming, and errors before a device is opened."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.rigs import FakeRig, printed, rig_settings, small_protocol, study_of

from tacbench_cad.lab.acquire.block_presses import BlockResult
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import acquire_study, places
from tacbench_cad.lab.rig.errors import NoAnswerError
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import GaugeSettings, Protocol, RigSettings, SensorSettings, Study
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked


class Script:
    """A person who types the lines of a script."""

    def __init__(self, *lines: str) -> None:
        self.lines = list(lines)
        self.prompts: list[str] = []
        self.shown: list[str] = []
        self.person = Typing(self._ask, self.shown.append)

    def _ask(self, prompt: str) -> str:
        self.prompts.append(prompt)
        if not self.lines:
            raise InputError("standard input", None, f"ended before the answer to: {prompt}")
        return self.lines.pop(0)


def run(
    rig: FakeRig, study: Study, out: Path, script: Script, settings: RigSettings | None = None
) -> tuple[BlockResult, ...]:
    return acquire_study(
        study,
        settings or rig_settings(),
        out,
        person=script.person,
        progress=PressProgress(),
        durable=False,
        opener=rig.opener,
    )


def short(**changes: object) -> Protocol:
    return small_protocol(repeats=1, stationary_frames=1, **changes)


def test_a_study_requests_each_block_and_opens_the_rig_once(tmp_path: Path) -> None:
    rig, script = FakeRig(), Script("t1 paper x1 01", "T4 PAPER X1 01")
    results = run(rig, study_of(short(), 1, 4), tmp_path, script)
    assert [result.folder.name for result in results] == [printed(1).name, printed(4).name]
    assert [result.presses for result in results] == [8, 8]
    assert rig.opened == 1
    assert rig.stage.closed
    assert script.shown[0] == "Put into the holder: texture-1, preset paper, scale 1, bambu-p1p, pla-minus, copy 1"
    assert script.prompts == ["Its label (T1 PAPER X1 01): ", "Its label (T4 PAPER X1 01): "]


def test_a_wrong_label_is_requested_again_and_then_refused(tmp_path: Path) -> None:
    script = Script("T4 PAPER X1 01", printed(1).name, "T5 PAPER X1 01", *["no"] * 9)
    with pytest.raises(InputError, match="must be T4 PAPER X1 01"):
        run(FakeRig(), study_of(short(), 1, 4), tmp_path, script)
    assert "'T4 PAPER X1 01' is the label of another block; this block must have T1 PAPER X1 01" in script.shown
    assert len(Run.open(tmp_path / printed(1).name).rows) == 8
    assert not (tmp_path / printed(4).name).exists()


def test_the_end_of_the_input_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"standard input: ended before the answer to: Its label"):
        run(FakeRig(), study_of(short(), 1, 4), tmp_path, Script())


def test_a_single_block_is_assumed_to_be_in_the_rig(tmp_path: Path) -> None:
    script = Script()
    run(FakeRig(), study_of(short(), 1), tmp_path, script)
    assert script.prompts == []


def test_a_tray_is_filled_slot_by_slot(tmp_path: Path) -> None:
    rig, script = FakeRig(), Script("T1 PAPER X1 01", "T2 PAPER X1 01", "T3 PAPER X1 01")
    settings = rig_settings(slots_mm=((0.0, 0.0, 0.0), (60.0, 0.0, 0.0)))
    study = study_of(short(), 1, 2, 3)
    results = run(rig, study, tmp_path, script, settings)
    assert [Run.open(result.folder).info.slot for result in results] == [0, 1, 0]
    assert [Run.open(result.folder).info.frame.origin_mm[0] for result in results] == [0.0, 60.0, 0.0]
    assert {round(x) for x, _, _ in rig.stage.path} == {0, 4, 9, 64, 69}
    # Both blocks of the first tray are requested before the first is pressed; a later session keeps their slots.
    assert [line.split(":")[0] for line in script.shown] == ["Put into slot 1", "Put into slot 2", "Put into slot 1"]
    assert [place.slot for place in places(study, settings, tmp_path)] == [0, 1, 0]


def test_a_study_is_resumed_at_the_first_missing_press_of_any_block(tmp_path: Path) -> None:
    rig, study = FakeRig(), study_of(short(), 1, 4)
    rig.stage.faults[450] = NoAnswerError("silent")
    with pytest.raises(NoAnswerError):
        run(rig, study, tmp_path, Script("T1 PAPER X1 01", "T4 PAPER X1 01"))
    there = [row.number for row in Run.open(tmp_path / printed(4).name).rows]
    assert 0 < len(there) < 8
    script = Script("T4 PAPER X1 01")
    (result,) = run(FakeRig(), study, tmp_path, script)
    assert result.presses == 8 - len(there)
    again = FakeRig()
    assert run(again, study, tmp_path, Script()) == ()
    assert again.opened == 0, "a complete study opens no device"


def test_other_settings_are_refused_before_a_device_is_opened(tmp_path: Path) -> None:
    run(FakeRig(), study_of(short(), 1), tmp_path, Script())
    rig = FakeRig()
    with pytest.raises(InputError, match=r"protocol\.steps\.settle_s was 0\.2, is now 0\.3"):
        run(rig, study_of(short(settle_s=0.3), 1), tmp_path, Script())
    with pytest.raises(InputError, match=r"frame\.origin_mm"):
        run(rig, study_of(short(), 1), tmp_path, Script(), rig_settings(origin_mm=(0.0, 0.0, 1.0)))
    with pytest.raises(InputError, match=r"stage\.settings\.approach_mm_s was 2\.0, is now 3\.0"):
        run(rig, study_of(short(), 1), tmp_path, Script(), rig_settings(approach_mm_s=3.0))
    assert rig.opened == 0


def test_a_run_without_presses_may_be_deleted_after_settings_changed(tmp_path: Path) -> None:
    run(FakeRig(), study_of(short(), 1), tmp_path, Script())
    with pytest.raises(InputError, match="restore these settings, or choose another output folder"):
        run(FakeRig(), study_of(short(settle_s=0.3), 1), tmp_path, Script())
    table = tmp_path / printed(1).name / "targets.csv"
    table.write_bytes(table.read_bytes().splitlines(keepends=True)[0])
    with pytest.raises(InputError, match=r"is now 0\.3; the run contains no press yet, so delete its folder"):
        run(FakeRig(), study_of(short(settle_s=0.3), 1), tmp_path, Script())


def test_a_second_process_is_refused_before_a_device_is_opened(tmp_path: Path) -> None:
    rig = FakeRig()
    with locked(tmp_path), pytest.raises(InputError, match="another tacbench is writing"):
        run(rig, study_of(short(), 1), tmp_path, Script())
    assert rig.opened == 0


def test_positions_outside_the_stage_are_refused(tmp_path: Path) -> None:
    rig = FakeRig()
    settings = rig_settings(limits_mm=((0.0, 200.0), (0.0, 200.0), (-5.0, 50.0)))
    with pytest.raises(InputError, match=r"limits_mm z = \[-5\.0, 50\.0\]: slot 1 needs -7\.000 to 5\.000 mm"):
        run(rig, study_of(short(), 1), tmp_path, Script(), settings)
    far = rig_settings(slots_mm=((0.0, 0.0, 0.0), (295.0, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"slot 2 needs 299\.000 to 304\.000 mm"):
        run(rig, study_of(short(), 1), tmp_path, Script(), far)
    assert rig.opened == 0


def test_pressing_to_a_force_needs_a_gauge(tmp_path: Path) -> None:
    settings = rig_settings()
    without = RigSettings(stage=settings.stage, gauge=GaugeSettings(driver="none"), sensor=settings.sensor)
    with pytest.raises(InputError, match="needs a gauge"):
        run(FakeRig(), study_of(short(), 1), tmp_path, Script(), without)


def test_taught_heights_are_requested_once(tmp_path: Path) -> None:
    study = study_of(short(contact="depth", touch="taught"), 1)
    rig, script = FakeRig(gauge=False), Script("-0.5, -0.6, -0.7, -0.8")
    run(rig, study, tmp_path, script)
    rows = Run.open(tmp_path / printed(1).name).by_key
    assert rows[(1, 1, 2)].pose_mm[2] == pytest.approx(-0.6 - 0.35)
    folder = tmp_path / printed(1).name
    (folder / "targets.csv").write_text("\n".join((folder / "targets.csv").read_text().splitlines()[:-2]) + "\n")
    again = Script()
    (result,) = run(FakeRig(gauge=False), study, tmp_path, again)
    assert (result.presses, again.prompts) == (2, [])


def test_heights_that_are_not_numbers_are_refused(tmp_path: Path) -> None:
    study = study_of(short(contact="depth", touch="taught"), 1)
    with pytest.raises(InputError, match="first touch = 'low': must be numbers"):
        run(FakeRig(gauge=False), study, tmp_path, Script("low"))


def test_a_person_who_is_always_asked_also_puts_blocks_into_a_simulated_rig(tmp_path: Path) -> None:
    settings = rig_settings()
    virtual = replace(
        settings, stage=replace(settings.stage, driver="virtual-grbl"), sensor=SensorSettings(driver="simulated")
    )
    for always, prompts in ((False, 0), (True, 2)):
        script = Script("T1 PAPER X1 01", "T4 PAPER X1 01")
        script.person.is_asked_always = always
        run(FakeRig(), study_of(short(), 1, 4), tmp_path / str(always), script, virtual)
        assert len(script.prompts) == prompts
