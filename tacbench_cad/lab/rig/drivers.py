"""Stage drivers by the names that ``[stage]`` uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tacbench_cad.lab.rig import plugin
from tacbench_cad.lab.rig.arduino import ArduinoStage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.rig.ports import resolve
from tacbench_cad.lab.rig.stage import LimitedStage, Stage
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError, nearest

#: How the names of virtual stages begin.
VIRTUAL = "virtual-"
#: Drivers of serial stages, and the options of the file that each knows.
SERIAL: dict[str, tuple[Callable[..., Stage], tuple[str, ...]]] = {
    "grbl": (GrblStage, ("home_timeout_s", "tolerance_mm")),
    "marlin": (MarlinStage, ("home_timeout_s", "home_lift_mm")),
    "arduino": (ArduinoStage, ("steps_per_mm", "home_timeout_s")),
}
#: What every stage has.
NEEDED = ("identity", "simulated", "home", "move", "position", "stop", "close")


def open_stage(settings: StageSettings, clock: Clock | None = None) -> LimitedStage:
    """Open, identify and (if asked) home the stage.

    A virtual stage's firmware must run already; ``settings.port`` says where. Its own options (``speed``, ``faults``)
    are for whoever runs it and are passed over here.

    Args:
        settings: The stage's settings.
        clock: Time of the rig; None for real time.

    Raises:
        InputError: Unknown driver or option, no such port, or several candidates.
        RigError: The device is silent, is another one, or cannot be homed.
    """
    clock = clock or Clock()
    stage = _opened(settings, clock)
    limited = LimitedStage(stage, settings.limits_mm)
    try:
        if settings.home:
            stage.home()
    except BaseException:
        limited.close()
        raise
    return limited


def _opened(settings: StageSettings, clock: Clock) -> Stage:
    if plugin.is_plugin(settings.driver):
        options = dict(settings.options)
        if settings.port is not None:
            options["port"] = settings.port
        stage: Stage = plugin.made(settings.driver, options, NEEDED)
        return stage
    name = settings.driver.removeprefix(VIRTUAL)
    if name not in SERIAL:
        hint = nearest(settings.driver, [*SERIAL, *(VIRTUAL + one for one in SERIAL)])
        raise InputError("[stage] driver", settings.driver, f"{hint}, or module:name for your own")
    maker, known = SERIAL[name]
    options = {**settings.options}
    if settings.is_virtual:
        options = {key: value for key, value in options.items() if key in known}
    for key in options:
        if key not in known:
            raise InputError(f"[stage] options {key}", None, f"unknown to {name}; {nearest(key, known)}")
    if settings.is_virtual and settings.port is None:
        raise InputError("[stage] port", None, f"{settings.driver} needs the port of its running firmware")
    own: dict[str, Any] = {"baud": settings.baud} if settings.baud is not None else {}
    return maker(
        resolve(settings.port, "stage"),
        clock=clock,
        timeout_s=settings.timeout_s,
        simulated=f"stage ({settings.driver})" if settings.is_virtual else "",
        **own,
        **options,
    )
