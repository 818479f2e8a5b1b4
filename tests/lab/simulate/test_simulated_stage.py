"""Test the simulated stage, alone and below a simulated gauge and sensor."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from tacbench_cad.lab.acquire.study_file import virtual_study
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_gauge, open_rig
from tacbench_cad.lab.rig.errors import DeviceLostError, OutOfRangeError, PositionLostError, RigError
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.simulate.simulated_stage import SimulatedStage
from tacbench_cad.lab.simulate.tactip import TacTip
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    HolderRim,
    PrintedBlock,
    RigSettings,
    SensorSettings,
    StageSettings,
)
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

FAST = Clock(speed=200.0)
PRINTED = PrintedBlock(block=Block.of(2), printer="bambu-p1p", filament="pla-minus")


RIG = RigSettings(
    stage=StageSettings(
        driver="simulated",
        quarter_turns=1,
        origin_mm=(110.0, 80.0, 40.0),
        limits_mm=((0.0, 200.0), (0.0, 200.0), (0.0, 100.0)),
        options={"speed": 200.0},
    ),
    gauge=GaugeSettings(driver="simulated"),
    sensor=SensorSettings(driver="simulated", options={"seed": 1, "flicker": 0.0}),
)


def test_a_move_takes_its_time() -> None:
    stage = SimulatedStage(FAST)
    move = threading.Thread(target=stage.move, args=((100.0, 140.0, 100.0), 20.0))
    move.start()
    seen = []
    while move.is_alive():
        seen.append(stage.position())
    move.join()
    assert stage.position() == (100.0, 140.0, 100.0)
    assert any(101.0 < y < 139.0 for _, y, _ in seen)
    assert all(x == z == 100.0 for x, _, z in seen)


def test_a_stop_ends_a_move_where_it_is() -> None:
    stage = SimulatedStage()
    timer = threading.Timer(0.1, stage.stop)
    timer.start()
    with pytest.raises(RigError, match="stopped on request"):
        stage.move((100.0, 140.0, 100.0), 5.0)
    timer.join()
    at = stage.position()
    assert 100.0 < at[1] < 140.0 and stage.position() == at
    with pytest.raises(PositionLostError, match="home the stage first"):
        stage.move((50.0, 50.0, 50.0), 10.0)
    stage.clock = FAST
    stage.home()
    with pytest.raises(OutOfRangeError, match="beyond its reach"):
        stage.move((100.0, 100.0, 131.0), 10.0)
    stage.close()
    with pytest.raises(DeviceLostError, match="is closed"):
        stage.position()


def test_gauge_and_sensor_follow_the_stage_over_a_turned_block() -> None:
    frame = RIG.stage.frame
    contact, tactip = contact_for(PRINTED, HolderRim()), TacTip(colour=False, flicker=0.0)
    with open_rig(RIG, PRINTED, frame) as rig:
        assert rig.info["stage"]["simulated"] == "simulated stage"
        assert rig.gauge is not None
        rig.gauge.tare()
        summit = (6.5, 20.5, -1.2)
        rig.stage.move(frame.to_stage((6.5, 20.5, 5.0)), 100.0)
        rig.stage.move(frame.to_stage(summit), 100.0)
        assert rig.gauge.read(1.0).mean_n == pytest.approx(contact.force_n(*summit), abs=0.01)
        expected = tactip.frame(tactip.pins(contact, summit), np.random.default_rng(0)).astype(float)
        # The images differ by noise only.
        assert np.max(np.abs(rig.sensor.read().astype(float) - expected)) < 30.0


def test_a_virtual_study_has_a_simulated_gauge() -> None:
    rig = virtual_study().required_rig
    assert (rig.stage.driver, rig.gauge.driver, rig.sensor.driver) == ("simulated", "simulated", "simulated")


def test_a_simulated_gauge_cannot_be_opened_alone() -> None:
    with pytest.raises(InputError, match=r"\[gauge\] driver = 'simulated': follows the stage of a rig"):
        open_gauge(GaugeSettings(driver="simulated"), FAST)
