"""The drivers of stages, gauges and sensors, by their names in ``[stage]``, ``[gauge]`` and ``[sensor]``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.rig import plugin, ports
from tacbench_cad.lab.rig.arduino import ArduinoStage
from tacbench_cad.lab.rig.calibration import read_calibration
from tacbench_cad.lab.rig.camera import open_camera
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.gauge import Force, Gauge
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.rig.loadcell import LoadCellOptions, open_load_cell
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.rig.sensor import Frame, Sensor
from tacbench_cad.lab.rig.stage import LimitedStage, Stage
from tacbench_cad.lab.rig.taxels import open_taxels
from tacbench_cad.lab.study.spec import GaugeSettings, Point, SensorSettings, StageSettings
from tacbench_cad.util.errors import InputError, nearest

#: The drivers of serial stages, with the options that each accepts.
SERIAL: dict[str, tuple[Callable[..., Stage], tuple[str, ...]]] = {
    "grbl": (GrblStage, ("home_timeout_s", "tolerance_mm")),
    "marlin": (MarlinStage, ("home_timeout_s", "home_lift_mm")),
    "arduino": (ArduinoStage, ("steps_per_mm", "home_timeout_s")),
}
#: The attributes that every stage, gauge and sensor must have.
NEEDED = {
    "stage": ("identity", "simulated", "home", "move", "position", "stop", "close"),
    "gauge": ("identity", "simulated", "calibration", "read", "tare", "close"),
    "sensor": ("name", "units", "shape", "simulated", "settings", "read", "close"),
}


def open_stage(settings: StageSettings, clock: Clock | None = None) -> LimitedStage:
    """Open and identify the stage, and home it if the settings say so.

    The firmware of a virtual stage must already run at ``settings.port``. Its own options (``speed``, ``faults``) are
    for the program that runs it; this function ignores them.

    Args:
        settings: The stage's settings.
        clock: The rig's time; None for real time.

    Raises:
        InputError: The driver, an option or the port does not exist, or several ports are possible.
        RigError: The device does not answer, is not the expected one, or cannot be homed.
    """
    stage = LimitedStage(_stage(settings, clock or Clock()), settings.limits_mm)
    try:
        if settings.home:
            stage.home()
    except BaseException:
        stage.close()
        raise
    return stage


def open_gauge(settings: GaugeSettings, clock: Clock, *, taken: Sequence[str] = (), simulated: str = "") -> Gauge:
    """Open the gauge that ``[gauge]`` describes.

    Args:
        settings: The table. Its driver is ``serial`` or a ``module:name``, which receives the port as ``port``.
        clock: The rig's time.
        taken: The ports of the rig's other devices, which are not tried.
        simulated: The simulated part: the virtual rig's load cell uses a real port.

    Raises:
        InputError: A setting is not allowed, the calibration cannot be read, or the port does not exist.
        RigError: The device sends no valid sample.
    """
    if plugin.is_plugin(settings.driver):
        gauge: Gauge = _open_own("gauge", settings, port=settings.port)
        return gauge
    path = None if settings.calibration is None else Path(settings.calibration)
    calibration = None if path is None else read_calibration(path)
    options = LoadCellOptions.of(settings.options, calibrated=calibration is not None)
    port = ports.resolve(settings.port, "gauge", taken=taken)
    return open_load_cell(
        port,
        settings.baud,
        options=options,
        clock=clock,
        timeout_s=settings.timeout_s,
        calibration=calibration,
        calibration_name="" if path is None else path.name,
        simulated=simulated,
    )


def open_sensor(settings: SensorSettings, clock: Clock, *, taken: Sequence[str] = ()) -> Sensor:
    """Open the sensor that ``[sensor]`` describes.

    Args:
        settings: The table. A ``module:name`` receives the device as ``device``.
        clock: The rig's time.
        taken: The ports of the rig's other devices, which are not tried.

    Raises:
        InputError: A setting is not allowed, or the device does not exist.
        RigError: The sensor fails, does not accept a setting, or sends invalid frames.
    """
    if plugin.is_plugin(settings.driver):
        sensor: Sensor = _open_own("sensor", settings, device=settings.device)
        return sensor
    return open_camera(settings) if settings.driver == "opencv" else open_taxels(settings, clock, taken=taken)


def _stage(settings: StageSettings, clock: Clock) -> Stage:
    if plugin.is_plugin(settings.driver):
        stage: Stage = _open_own("stage", settings, port=settings.port)
        return stage
    name = settings.driver.removeprefix("virtual-")
    factory, known = SERIAL[name]
    options = dict(settings.options)
    if settings.is_virtual:
        options = {key: value for key, value in options.items() if key in known}
        if settings.port is None:
            raise InputError("[stage] port", None, f"{settings.driver} needs the port of its running firmware")
    for key in options:
        if key not in known:
            raise InputError(f"[stage] options {key}", None, f"is not an option of {name}; {nearest(key, known)}")
    if settings.baud is not None:
        options["baud"] = settings.baud
    return factory(
        ports.resolve(settings.port, "stage"),
        clock=clock,
        timeout_s=settings.timeout_s,
        simulated=f"stage ({settings.driver})" if settings.is_virtual else "",
        **options,
    )


def _open_own(kind: str, settings: StageSettings | GaugeSettings | SensorSettings, **place: str | None) -> Any:
    """Open a user's own device. It receives its port or device if the file names one."""
    options = {**settings.options, **{key: value for key, value in place.items() if value is not None}}
    return plugin.open_device(settings.driver, options, NEEDED[kind], field=f"[{kind}] driver", results=RESULTS[kind])


def _point(value: Any) -> Point:
    x, y, z = (float(coordinate) for coordinate in value)
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{value} is not a position in mm")
    return (x, y, z)


def _force(value: Any) -> Force:
    if not isinstance(value, Force):
        raise TypeError(f"{value!r:.60} is not a Force")
    return value


def _frame(value: Any) -> Frame:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        raise TypeError(f"a {type(value).__name__} is not an array of numbers")
    return value


#: The required results of the methods of a user's own device.
RESULTS: Mapping[str, Mapping[str, Callable[[Any], Any]]] = {
    "stage": {"move": _point, "position": _point},
    "gauge": {"read": _force},
    "sensor": {"read": _frame},
}
