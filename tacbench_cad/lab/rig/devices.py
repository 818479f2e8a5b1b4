"""A whole rig from its settings. Real and simulated devices can be combined.

A simulated gauge or sensor follows the position and the angles that the stage reports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.colours import with_inside_colours
from tacbench_cad.lab.rig.gauge import Gauge
from tacbench_cad.lab.rig.registry import Context, driver_name, find_driver, open_device
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.rig.stage import LimitedStage, Stage, inner
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import (
    NO_GAUGE,
    GaugeSettings,
    PrintedBlock,
    RigSettings,
    SensorSettings,
    StageSettings,
    WorkFrame,
)


@dataclass(kw_only=True)
class OpenRig:
    """The open devices of a rig.

    Args:
        stage: The stage.
        gauge: The force gauge, or None.
        sensor: The tactile sensor.
        clock: The rig's time.
        settings: The settings from which the devices were opened.
        following: The simulated devices, which must know the block below the sensor.
        known_mm: Returns the height at which a press reaches its target, in mm of the work frame, on an ideal
            (simulated) rig that knows it. Such a rig needs no search and no checks of its position. None on all others.
    """

    stage: Stage
    gauge: Gauge | None
    sensor: Sensor
    clock: Clock
    settings: RigSettings
    following: tuple[Any, ...] = ()
    known_mm: Callable[[Press], float] | None = None

    def put(self, printed: PrintedBlock, frame: WorkFrame) -> None:
        """Pass the next block to the simulated devices."""
        for device in self.following:
            device.put(printed, self.settings.holder, frame)

    @property
    def info(self) -> dict[str, dict[str, Any]]:
        """Descriptions of the stage, gauge and sensor for ``run.json``."""
        gauge, sensor = self.gauge, self.sensor
        return {
            "stage": {
                "identity": self.stage.identity,
                "simulated": self.stage.simulated,
                "settings": recorded_stage(self.settings.stage),
            },
            "gauge": {
                "identity": "none" if gauge is None else gauge.identity,
                "simulated": "" if gauge is None else gauge.simulated,
                "calibration": {} if gauge is None else dict(gauge.calibration),
                "settings": recorded_gauge(self.settings.gauge),
            },
            "sensor": {
                "name": sensor.name,
                "simulated": sensor.simulated,
                "units": sensor.units,
                "shape": list(sensor.shape),
                "settings": sensor.settings,
            },
        }


def recorded_stage(settings: StageSettings) -> dict[str, Any]:
    """Return the settings of a stage that must not change during a run, without the origin, which frames record."""
    unrecorded = find_driver("stage", settings.driver).unrecorded
    return {
        "driver": driver_name(settings.driver),
        "limits_mm": [list(limits) for limits in settings.limits_mm],
        "travel_mm_s": settings.travel_mm_s,
        "approach_mm_s": settings.approach_mm_s,
        "options": {key: value for key, value in settings.options.items() if key not in unrecorded},
    }


def recorded_gauge(settings: GaugeSettings) -> dict[str, Any]:
    """Return the settings of a gauge that must not change during a run, without its calibration."""
    return {"driver": driver_name(settings.driver), "options": dict(settings.options)}


def open_stage(settings: StageSettings, clock: Clock | None = None) -> LimitedStage:
    """Open and identify the stage, and home it if the settings say so.

    Args:
        settings: The stage's settings.
        clock: The rig's time; None for real time.

    Raises:
        InputError: The driver, an option or the port does not exist, or several ports are possible.
        MissingToolError: A package that the driver needs is not installed.
        RigError: The device does not answer, is not the expected one, or cannot be homed.
    """
    opened = open_device("stage", settings, Context(clock=clock or Clock()))
    stage = LimitedStage(opened, settings.limits_mm)
    try:
        if hasattr(opened, "kept_limits_mm"):
            # A firmware may have limits of its own.
            stage.limits_mm = opened.kept_limits_mm(settings.limits_mm)
        if settings.home:
            stage.home()
    except BaseException:
        stage.close()
        raise
    return stage


def open_gauge(
    settings: GaugeSettings, clock: Clock, *, taken: Sequence[str] = (), stage: LimitedStage | None = None
) -> Gauge:
    """Open the gauge that ``[gauge]`` describes.

    Args:
        settings: The table. A ``module:name`` receives the port as ``port``.
        clock: The rig's time.
        taken: The ports of the rig's other devices, which are not tried.
        stage: The open stage, which a simulated gauge follows.

    Raises:
        InputError: A setting is not allowed, the calibration cannot be read, or the port does not exist.
        MissingToolError: A package that the driver needs is not installed.
        RigError: The device sends no valid sample.
    """
    gauge: Gauge = open_device("gauge", settings, Context(clock=clock, taken=taken, stage=stage))
    return gauge


def open_sensor(
    settings: SensorSettings, clock: Clock, *, taken: Sequence[str] = (), stage: LimitedStage | None = None
) -> Sensor:
    """Open the sensor that ``[sensor]`` describes.

    Args:
        settings: The table. A ``module:name`` receives the device as ``device``.
        clock: The rig's time.
        taken: The ports of the rig's other devices, which are not tried.
        stage: The open stage, which a simulated sensor follows.

    Raises:
        InputError: A setting is not allowed, the device does not exist, or nothing states the order of its colours.
        MissingToolError: A package that the driver needs is not installed.
        RigError: The sensor fails, does not accept a setting, or sends invalid frames.
    """
    sensor: Sensor = open_device("sensor", settings, Context(clock=clock, taken=taken, stage=stage))
    try:
        return with_inside_colours(sensor, settings.channels, settings.driver)
    except BaseException:
        sensor.close()
        raise


@contextmanager
def open_rig(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> Iterator[OpenRig]:
    """Open all devices. They are closed in reverse order at the end, also after an error.

    Args:
        settings: The settings of the devices.
        printed: The block below the sensor, for simulated devices.
        frame: The work frame of the block.

    Raises:
        RigError: A device is missing or is not the expected one.
        InputError: A setting is not allowed.
    """
    with ExitStack() as devices:
        clock = Clock()
        stage = devices.enter_context(open_stage(settings.stage, clock))
        own_clock = getattr(inner(stage), "clock", None)
        clock = own_clock if isinstance(own_clock, Clock) else clock
        taken = [settings.stage.port] if settings.stage.port else []
        gauge: Gauge | None = None
        if settings.gauge.driver != NO_GAUGE:
            gauge = devices.enter_context(open_gauge(settings.gauge, clock, taken=taken, stage=stage))
        taken += [settings.gauge.port] if settings.gauge.port else []
        sensor = devices.enter_context(open_sensor(settings.sensor, clock, taken=taken, stage=stage))
        following = tuple(device for device in (inner(stage), gauge, sensor) if hasattr(device, "put"))
        rig = OpenRig(stage=stage, gauge=gauge, sensor=sensor, clock=clock, settings=settings, following=following)
        rig.put(printed, frame)
        yield rig
