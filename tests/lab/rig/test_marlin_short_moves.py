"""Test moves on Marlin that are so short that the firmware would withhold them, and motors that are idle."""

from __future__ import annotations

import pytest
from helpers.rig_here import FakeTime, launch
from helpers.scripted_marlin import ScriptedMarlin

from tacbench_cad.extensions.virtual_rig import VirtualRig
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.study.spec import Point

SPEED = 50.0


pytestmark = pytest.mark.usefixtures("rig_time")


def opened(rig: VirtualRig) -> MarlinStage:
    return MarlinStage(rig.port, baud=250000)


@pytest.mark.parametrize("z_steps_per_mm", [400, 2560])
def test_every_move_down_to_one_motor_step_is_made(z_steps_per_mm: int) -> None:
    step_mm = 1.0 / z_steps_per_mm
    with (
        launch("marlin", speed=SPEED, resets_on_open=False, z_steps_per_mm=z_steps_per_mm) as rig,
        opened(rig) as stage,
    ):
        stage.home()
        z = stage.move((50.0, 60.0, 70.0), 50.0)[2]
        zero = rig.true_position()[2] - z
        for steps in (-1, -2, -3, -5, -6, -7, -20, -21, -40, 1, 4, 6, 0):
            z += steps * step_mm
            reported = stage.move((50.0, 60.0, z), 2.0)
            assert reported[2] == pytest.approx(z, abs=1e-6)
            assert rig.true_position()[2] - zero == pytest.approx(z, abs=1e-4)
        for x, y in ((50.0125, 60.0), (50.0125, 60.05), (49.975, 59.9875)):
            assert stage.move((x, y, z), 2.0) == pytest.approx((x, y, z), abs=1e-6)
            assert rig.true_position()[0] == pytest.approx(x, abs=0.013)


def test_short_moves_are_made_at_the_upper_ends_of_the_axes() -> None:
    with launch("marlin", speed=SPEED, resets_on_open=False) as rig, opened(rig) as stage:
        stage.home()
        for target in ((0.05, 0.0, 100.0), (0.05, 0.0375, 100.0), (0.05, 0.0375, 99.995), (0.0, 0.0375, 100.0)):
            assert stage.move(target, 20.0) == pytest.approx(target, abs=1e-6)
        stage.move((200.0, 200.0, 100.0), 100.0)
        at: Point = (200.0, 199.975, 100.0)
        assert stage.move(at, 20.0) == pytest.approx(at, abs=1e-6)


def moves_of(script: ScriptedMarlin, start: Point, target: Point) -> list[Point]:
    """Return the targets of the lines that the driver sends for one move."""
    with script.peer() as peer, MarlinStage(peer.port, baud=115200, timeout_s=0.3) as stage:
        stage.home()
        stage.move(start, 20.0)
        del script.accepted[:]
        stage.move(target, 20.0)
    lines = [line.decode().split() for line in script.accepted if line.startswith(b"G1")]
    return [(float(x[1:]), float(y[1:]), float(z[1:])) for _, x, y, z, _ in lines]


@pytest.mark.parametrize("dz_steps", [-5, -1, 1, 5])
def test_a_detour_goes_up_first_and_never_below_the_target(dz_steps: int) -> None:
    target: Point = (10.0, 20.0, 50.0 + dz_steps / 400.0)
    first, middle, last = moves_of(ScriptedMarlin(), (10.0, 20.0, 50.0), target)
    assert last == target
    assert first[:2] == (10.0, 20.0)
    assert first[2] > middle[2] > target[2]
    for a, b in (((10.0, 20.0, 50.0), first), (first, middle), (middle, last)):
        assert abs(round(400.0 * b[2]) - round(400.0 * a[2])) >= 6


def test_longer_moves_have_three_parts_on_a_straight_line() -> None:
    assert moves_of(ScriptedMarlin(), (10.0, 20.0, 50.0), (16.0, 20.0, 44.0)) == [
        (12.0, 20.0, 48.0), (14.0, 20.0, 46.0), (16.0, 20.0, 44.0),
    ]  # fmt: skip
    # Parts of fewer than seven steps could be withheld.
    assert len(moves_of(ScriptedMarlin(), (10.0, 20.0, 50.0), (10.0, 20.0, 49.95))) == 1


def test_idle_motors_stay_on(rig_time: FakeTime) -> None:
    with launch("marlin", speed=SPEED, resets_on_open=False, idle_s=5.0) as rig, opened(rig) as stage:
        stage.home()
        stage.move((50.0, 60.0, 70.0), 50.0)
        rig_time.sleep(15.0 / SPEED)
        assert rig.true_position()[2] == pytest.approx(70.0, abs=0.01)


def test_a_build_without_m84_is_refused() -> None:
    script = ScriptedMarlin()
    script.on[b"M84"] = lambda line: iter([b'echo:Unknown command: "M84 S0"\n', b"ok\n"])
    with script.peer() as peer, pytest.raises(RigError, match="does not know M84 S0"):
        MarlinStage(peer.port)
