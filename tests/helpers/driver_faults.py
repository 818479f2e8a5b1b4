"""Check what must hold for every driver and every fault of the virtual firmware."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable
from typing import Any

from helpers.rig_here import launch
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.stage import Stage
from tacbench_cad.lab.study.spec import Point

SPEED = 50.0
#: Faults that a driver can notice. The firmware's step counters do not show the other faults; the force gauge does.
KINDS = ("drop", "double", "garble", "silence", "reset", "alarm", "unplug")
#: The largest distance in mm between true and reported position: the scatter of the end stops and one step.
NEAR_MM = 0.05

Opener = Callable[[str], Stage]


def random_fault(seed: int) -> Fault:
    """Return a random fault that depends on the seed alone."""
    rng = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    more: dict[str, Any] = {"direction": rng.choice(["in", "out", "both"])}
    if kind in ("drop", "double", "garble"):
        more |= {"count": rng.choice([1, 3, 10]), "chance": rng.choice([0.02, 0.2, 1.0])}
    elif kind == "silence":
        more |= {"seconds": rng.choice([5.0, None])}
    return Fault(kind=kind, **more)


def survive(kind: str, opener: Opener, center_mm: Point, seed: int) -> list[str]:
    """Make ten moves with one fault at a random move.

    Every move must end at the reported position or with a specific error. After an error the stage must be usable
    again, or it must refuse to report a position.

    Returns:
        The names of the errors.
    """
    rng = random.Random(seed)
    errors: list[str] = []
    with launch(kind, speed=SPEED, seed=seed) as rig, contextlib.closing(opener(rig.port)) as stage:
        stage.home()
        stage.move(center_mm, 20.0)
        at_move = rng.randrange(10)
        for number in range(10):
            target: Point = tuple(coordinate + rng.uniform(-8.0, 8.0) for coordinate in center_mm)  # type: ignore[assignment]
            if number == at_move:
                rig.inject(random_fault(seed))
            try:
                reported = stage.move(target, 20.0)
            except RigError as error:
                assert str(error).startswith("stage at ") and "\n" not in str(error)
                errors.append(type(error).__name__)
                if not _again(stage):
                    return errors
            else:
                true = rig.true_position()
                assert max(abs(a - b) for a, b in zip(reported, target, strict=True)) <= NEAR_MM
                assert max(abs(a - b) for a, b in zip(true, target, strict=True)) <= NEAR_MM
    return errors


def _again(stage: Stage) -> bool:
    """Make a stage usable after an error, as the press loop does; return False if it no longer answers."""
    with contextlib.suppress(RigError):
        stage.position()
        return True
    try:
        stage.home()
    except RigError as error:
        assert str(error).startswith("stage at ")
        # The position must stay unknown, so that no later move is believed.
        with contextlib.suppress(RigError):
            stage.position()
            raise AssertionError("a stage that could not be homed reports a position") from error
        return False
    return True
