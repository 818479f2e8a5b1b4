"""Test the friction of the simulated sensor: the skin lags behind the dome, up to the limit of friction."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.lab.simulate.contact import FRICTION, LATERAL_N_PER_MM, Drag, contact_for
from tacbench_cad.lab.simulate.tactip import TacTip
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock
from tacbench_cad.spec.block import Block


def test_the_skin_sticks_until_friction_is_exceeded() -> None:
    drag, limit = Drag(), FRICTION * 2.0 / LATERAL_N_PER_MM
    assert drag.move((4.0, 18.0, -1.0), 2.0) == (0.0, 0.0)
    assert drag.move((4.0, 18.5, -1.0), 2.0) == pytest.approx((0.0, 0.5))
    assert drag.move((4.0, 28.0, -1.0), 2.0) == pytest.approx((0.0, limit))
    # A lower force lets the skin slip back, and a motion backwards unloads it first.
    assert drag.move((4.0, 28.0, -0.5), 1.0) == pytest.approx((0.0, limit / 2.0))
    assert drag.move((4.0, 27.75, -0.5), 1.0) == pytest.approx((0.0, limit / 2.0 - 0.25))
    assert drag.move((4.0, 27.0, 5.0), 0.0) == (0.0, 0.0)


def test_pins_in_contact_are_dragged_opposite_to_the_motion_and_others_stay() -> None:
    printed = PrintedBlock(block=Block.of(1), printer="resin", filament="resin")
    contact, sensor = contact_for(printed, HolderRim()), TacTip(colour=False)
    pose = (6.5, 20.5, contact.z_for_force(6.5, 20.5, 2.0))
    moved = sensor.pins(contact, pose, lag_mm=(0.0, 1.5)).tips_mm - sensor.pins(contact, pose).tips_mm
    distance = np.hypot(*sensor.rest.tips_mm[:, :2].T)
    assert moved[:, 1].min() == pytest.approx(-1.5, abs=0.1)
    assert np.abs(moved[:, [0, 2]]).max() == 0.0
    assert np.abs(moved[distance > 12.0, 1]).max() < 0.3
