"""A whole rig from its settings. Real, virtual and simulated devices can be combined.

*Virtual*: a firmware simulator in its own process, behind a serial port; the drivers are the real ones.
*Simulated*: a device in this process. A simulated gauge or sensor follows the position and the angles that the stage
reports. The lab itself opens neither. Callers that need them pass :class:`Simulators`, as
``tacbench_cad.extensions.virtual_rig.devices.open_rig`` does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.drivers import open_gauge, open_sensor, open_stage, ready_stage
from tacbench_cad.lab.rig.gauge import Gauge
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.rig.stage import RotatingStage, Stage, can_turn
from tacbench_cad.lab.study.spec import (
    VIRTUAL_ARM,
    GaugeSettings,
    HolderRim,
    PrintedBlock,
    RigSettings,
    StageSettings,
    WorkFrame,
)
from tacbench_cad.util.errors import InputError

#: The value of ``[gauge] port`` for the load cell of a virtual stage.
VIRTUAL_PORT = "virtual"
#: The options of a virtual stage that are not recorded, since they do not affect the measurement.
UNRECORDED = ("speed", "tcp", "faults")


@runtime_checkable
class Following(Protocol):
    """A simulated device, which must know the block below the sensor."""

    def put(self, printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> None:
        """Replace the block below the sensor."""


class VirtualStage(Following, Protocol):
    """The running firmware of a virtual stage.

    Attributes:
        port: The port of the stage.
        gauge_port: The port of the virtual load cell.
        clock: The clock of the virtual rig.
    """

    port: str
    gauge_port: str
    clock: Clock


class SimulatedStage(RotatingStage, Protocol):
    """A simulated stage without firmware.

    Attributes:
        clock: The clock of the stage, which the whole rig uses.
    """

    clock: Clock


@dataclass(frozen=True, kw_only=True)
class Simulators:
    """Functions that open virtual and simulated devices.

    Args:
        stage: Starts the firmware of a virtual stage.
        arm: Opens the simulated arm.
        gauge: Opens a gauge that follows a position and, by ``rotation``, angles.
        sensor: Opens a sensor that follows them; its last positional argument is the options of ``[sensor]``, and
            ``in_motion`` returns whether the stage moves the sensor in contact.
    """

    stage: Callable[[RigSettings], AbstractContextManager[VirtualStage]]
    arm: Callable[[StageSettings], SimulatedStage]
    gauge: Callable[..., Gauge]
    sensor: Callable[..., Sensor]


@dataclass(kw_only=True)
class Rig:
    """The open devices of a rig.

    Args:
        stage: The stage.
        gauge: The force gauge, or None.
        sensor: The tactile sensor.
        clock: The rig's time.
        settings: The settings from which the devices were opened.
        following: The simulated devices, which must know the block below the sensor.
    """

    stage: Stage
    gauge: Gauge | None
    sensor: Sensor
    clock: Clock
    settings: RigSettings
    following: tuple[Following, ...] = ()

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
    return {
        "driver": settings.driver,
        "limits_mm": [list(limits) for limits in settings.limits_mm],
        "travel_mm_s": settings.travel_mm_s,
        "approach_mm_s": settings.approach_mm_s,
        "options": {key: value for key, value in settings.options.items() if key not in UNRECORDED},
        **({"station": settings.station} if settings.station else {}),
    }


def recorded_gauge(settings: GaugeSettings) -> dict[str, Any]:
    """Return the settings of a gauge that must not change during a run, without its calibration."""
    return {"driver": settings.driver, "options": dict(settings.options)}


@contextmanager
def open_rig(
    settings: RigSettings, printed: PrintedBlock, frame: WorkFrame, *, simulators: Simulators | None = None
) -> Iterator[Rig]:
    """Open all devices. They are closed in reverse order at the end, also after an error.

    Args:
        settings: The settings of the devices.
        printed: The block below the sensor, for virtual and simulated devices.
        frame: The work frame of the block.
        simulators: The functions for virtual and simulated devices; None if the rig has none.

    Raises:
        RigError: A device is missing or is not the expected one.
        InputError: A setting is not allowed.
    """

    def simulator(table: str, driver: str) -> Simulators:
        if simulators is None:
            raise InputError(
                f"[{table}] driver",
                driver,
                "is a simulator; open it with tacbench_cad.extensions.virtual_rig.devices.open_rig",
            )
        return simulators

    with ExitStack() as devices:
        stage_settings, gauge_settings, sensor_settings = settings.stage, settings.gauge, settings.sensor
        clock, simulated = Clock(), ""
        opened: list[object] = []
        if stage_settings.driver == VIRTUAL_ARM:
            arm = simulator("stage", VIRTUAL_ARM).arm(stage_settings)
            clock, stage = arm.clock, ready_stage(arm, stage_settings)
        else:
            if stage_settings.is_virtual:
                virtual = devices.enter_context(simulator("stage", stage_settings.driver).stage(settings))
                opened.append(virtual)
                clock = virtual.clock
                stage_settings = replace(stage_settings, port=virtual.port)
                if gauge_settings.port == VIRTUAL_PORT:
                    gauge_settings = replace(gauge_settings, port=virtual.gauge_port)
                    simulated = "load cell of the virtual rig"
            stage = open_stage(stage_settings, clock)
        devices.enter_context(stage)
        rotation = stage.followed_deg if can_turn(stage) else None
        taken = [stage_settings.port] if stage_settings.port else []
        gauge: Gauge | None = None
        if gauge_settings.driver == "simulated":
            gauge = devices.enter_context(
                simulator("gauge", "simulated").gauge(stage.followed_mm, clock, rotation=rotation)
            )
        elif gauge_settings.driver != "none":
            gauge = devices.enter_context(open_gauge(gauge_settings, clock, taken=taken, simulated=simulated))
        if sensor_settings.driver == "simulated":
            sensor = simulator("sensor", "simulated").sensor(
                stage.followed_mm,
                clock,
                sensor_settings.options,
                rotation=rotation,
                in_motion=lambda: stage.is_tracked,
            )
        else:
            taken += [gauge_settings.port] if gauge_settings.port else []
            sensor = open_sensor(sensor_settings, clock, taken=taken)
        opened += [gauge, devices.enter_context(sensor)]
        following = tuple(device for device in opened if isinstance(device, Following))
        rig = Rig(stage=stage, gauge=gauge, sensor=sensor, clock=clock, settings=settings, following=following)
        rig.put(printed, frame)
        yield rig
