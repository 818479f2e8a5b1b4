"""Test the simulated arm, alone and below a simulated gauge and sensor."""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_rig
from tacbench_cad.lab.rig.drivers import open_gauge
from tacbench_cad.lab.rig.errors import DeviceLostError, NotThereError, OutOfRangeError, PositionLostError
from tacbench_cad.lab.rig.stage import can_turn
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.simulate.simulated_stage import SimulatedStage
from tacbench_cad.lab.simulate.tactip import TacTip
from tacbench_cad.lab.study.file import virtual_study
from tacbench_cad.lab.study.rotation import UPRIGHT, above, in_stage_frame, lowest, towards
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    HolderRim,
    PrintedBlock,
    RigSettings,
    SensorSettings,
    StageSettings,
)
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import DOME_RADIUS_MM
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


def test_a_roll_moves_the_centre_of_the_dome_in_time() -> None:
    arm = SimulatedStage(FAST)
    length = DOME_RADIUS_MM * math.radians(20.0)
    roll = threading.Thread(
        target=arm.turn,
        args=(towards(90.0, 20.0), 10.0),
        kwargs={"above_mm": DOME_RADIUS_MM, "by_mm": (0.0, length, 0.0)},
    )
    roll.start()
    seen = []
    while roll.is_alive():
        seen.append((arm.position(), arm.rotation()))
    roll.join()
    centre = above(arm.position(), arm.rotation(), DOME_RADIUS_MM)
    assert centre == pytest.approx((100.0, 100.0 + length, 100.0 + DOME_RADIUS_MM))
    assert arm.rotation() == pytest.approx((-20.0, 0.0, 0.0))
    # A position and angles that are asked for one after the other may belong to slightly different times.
    on_the_way = [(point, -angles[0]) for point, angles in seen if 1.0 < -angles[0] < 19.0]
    assert on_the_way
    for (_, y, _), angle in on_the_way:
        expected = 100.0 + DOME_RADIUS_MM * (math.radians(angle) - math.sin(math.radians(angle)))
        assert y == pytest.approx(expected, abs=0.1)


def test_a_stop_ends_a_turn_where_it_is() -> None:
    arm = SimulatedStage()
    timer = threading.Timer(0.1, arm.stop)
    timer.start()
    with pytest.raises(NotThereError, match="stopped on request"):
        arm.turn(towards(0.0, 20.0), 2.0)
    timer.join()
    angles = arm.rotation()
    assert 0.0 < angles[1] < 20.0 and arm.rotation() == angles
    with pytest.raises(PositionLostError, match="home the stage first"):
        arm.move((50.0, 50.0, 50.0), 10.0)
    arm.clock = FAST
    arm.home()
    assert arm.rotation() == UPRIGHT
    with pytest.raises(OutOfRangeError, match="beyond its reach"):
        arm.turn(UPRIGHT, 10.0, by_mm=(0.0, 0.0, 31.0))
    arm.close()
    with pytest.raises(DeviceLostError, match="is closed"):
        arm.rotation()


def test_gauge_and_sensor_follow_the_angles_of_the_arm() -> None:
    frame = RIG.stage.frame
    contact, tactip = contact_for(PRINTED, HolderRim()), TacTip(colour=False, flicker=0.0)
    with open_rig(RIG, PRINTED, frame) as rig:
        assert can_turn(rig.stage) and rig.info["stage"]["simulated"] == "simulated stage"
        assert rig.gauge is not None
        rig.gauge.tare()
        summit = (6.5, 20.5, -1.2)
        rig.stage.move(frame.to_stage((6.5, 20.5, 5.0)), 100.0)
        rig.stage.move(frame.to_stage(summit), 100.0)
        pressed = rig.sensor.read().astype(float)
        for angles in (towards(0.0, 8.0), towards(90.0, 8.0)):
            rig.stage.turn(in_stage_frame(frame, angles), 50.0)  # type: ignore[attr-defined]
            force_n = contact.force_n(*lowest(summit, angles))
            assert rig.gauge.read(1.0).mean_n == pytest.approx(force_n, abs=0.01)
            expected = tactip.frame(tactip.pins(contact, summit, angles), np.random.default_rng(0)).astype(float)
            image = rig.sensor.read().astype(float)
            # The images differ by noise only.
            assert np.max(np.abs(image - expected)) < 30.0
            assert np.count_nonzero(np.abs(image - pressed) > 60.0) > 100


def test_a_virtual_study_has_a_simulated_gauge() -> None:
    rig = virtual_study().required_rig
    assert (rig.stage.driver, rig.gauge.driver, rig.sensor.driver) == ("simulated", "simulated", "simulated")


def test_a_simulated_gauge_cannot_be_opened_alone() -> None:
    with pytest.raises(InputError, match=r"\[gauge\] driver = 'simulated': follows the stage of a rig"):
        open_gauge(GaugeSettings(driver="simulated"), FAST)
