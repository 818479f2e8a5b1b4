"""Rigs of mixed devices: a stage of a user's own with a simulated gauge and sensor that follow it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.rigs import LIMITS, printed, small_protocol, study_of

from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import Silent
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.study.spec import GaugeSettings, RigSettings, SensorSettings, StageSettings, WorkFrame
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.virtual_rig.devices import open_rig

ORIGIN = (30.0, 10.0, -5.0)
RIG = RigSettings(
    stage=StageSettings(driver="helpers.fakes:FakeStage", limits_mm=LIMITS, origin_mm=ORIGIN, quarter_turns=1),
    gauge=GaugeSettings(driver="simulated"),
    sensor=SensorSettings(driver="simulated", options={"seed": 1}),
)


def test_simulated_devices_follow_a_stage_of_ones_own(tmp_path: Path) -> None:
    protocol = small_protocol(
        grid=PressGrid(x_mm=(4.0,), y_mm=(18.0,)),
        forces_n=(0.5,),
        bands_n=(0.02,),
        repeats=1,
        stationary_frames=1,
        clearance_mm=0.5,
        settle_s=0.0,
    )
    study = study_of(protocol, 4)
    acquire_study(
        study,
        RIG,
        tmp_path,
        person=Typing(lambda _: "", lambda _: None),
        progress=Silent(),
        durable=False,
        opener=open_rig,
    )
    run = Run.open(tmp_path / printed(4).name)
    assert run.info.simulated == (
        "stage: fake stage",
        "gauge: simulated load cell",
        "sensor: simulated TacTip",
    )
    contact = contact_for(printed(4), RIG.holder)
    for row in run.rows:
        # Band, noise of eight samples, and a quarter of the band for the zero.
        assert contact.force_n(*row.pose_mm) == pytest.approx(0.5, abs=0.02 + 0.005 + 0.001)


def test_a_device_that_fails_to_open_closes_the_others() -> None:
    from helpers.fakes import FakeStage

    made: list[FakeStage] = []
    close = FakeStage.close
    frame = WorkFrame(origin_mm=ORIGIN)
    broken = replace(RIG, sensor=SensorSettings(driver="simulated", options={"colours": True}))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(FakeStage, "close", lambda self: (made.append(self), close(self))[1])
        with pytest.raises(InputError, match='did you mean "colour"'), open_rig(broken, printed(), frame):
            pass
    assert made
    assert made[0].closed


def test_a_gauge_that_is_not_there_is_named() -> None:
    settings = replace(RIG, gauge=GaugeSettings(driver="serial", port="/dev/no-such-gauge"))
    with (
        pytest.raises((InputError, RigError), match="/dev/no-such-gauge"),
        open_rig(settings, printed(), WorkFrame(origin_mm=ORIGIN)),
    ):
        pass
