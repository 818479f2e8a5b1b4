"""A whole rig from its settings: real, virtual and simulated devices, in any mixture.

*Virtual*: a firmware simulator in a process of its own, behind a serial port; the drivers are the real ones.
*Simulated*: a device in this process that follows the position that the stage reports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.gauge import Gauge
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.rig.stage import Stage
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    HolderRim,
    PrintedBlock,
    RigSettings,
    SensorSettings,
    StageSettings,
    WorkFrame,
)
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.virtual_rig.launch import VirtualRig

#: How many times faster than real time a virtual rig runs, if ``[stage] options.speed`` does not say.
DEFAULT_SPEED = 1.0
#: Beyond this a serial port is what limits it.
MOST_SPEED = 1000.0
#: ``[gauge] port`` of the load cell that belongs to a virtual stage.
VIRTUAL_PORT = "virtual"
#: Options of a virtual stage that are not part of what is recorded: they change no reading.
UNRECORDED = ("speed", "tcp", "faults")

Put = Callable[[PrintedBlock, HolderRim, WorkFrame], None]


@runtime_checkable
class Following(Protocol):
    """A simulated device, which has to be told what lies under the sensor."""

    def put(self, printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> None:
        """Another block lies there now."""
        ...


@dataclass(kw_only=True)
class Rig:
    """Open devices.

    Args:
        stage: The stage.
        gauge: The force gauge, or None.
        sensor: The tactile sensor.
        clock: The rig's time.
        settings: What they were opened from.
        puts: Told which block lies under the sensor, and where: the simulated devices.
    """

    stage: Stage
    gauge: Gauge | None
    sensor: Sensor
    clock: Clock
    settings: RigSettings
    puts: tuple[Put, ...] = ()

    def put(self, printed: PrintedBlock, frame: WorkFrame) -> None:
        """Tell the simulated devices which block is pressed next."""
        for put in self.puts:
            put(printed, self.settings.holder, frame)

    @property
    def stage_info(self) -> dict[str, Any]:
        """The stage for ``run.json``."""
        return {
            "identity": self.stage.identity,
            "simulated": self.stage.simulated,
            "settings": recorded_stage(self.settings.stage),
        }

    @property
    def gauge_info(self) -> dict[str, Any]:
        """The gauge for ``run.json``."""
        return {
            "identity": "none" if self.gauge is None else self.gauge.identity,
            "simulated": "" if self.gauge is None else self.gauge.simulated,
            "calibration": {} if self.gauge is None else dict(self.gauge.calibration),
            "settings": recorded_gauge(self.settings.gauge),
        }

    @property
    def sensor_info(self) -> dict[str, Any]:
        """The sensor for ``run.json``."""
        return {
            "name": self.sensor.name,
            "simulated": self.sensor.simulated,
            "units": self.sensor.units,
            "shape": list(self.sensor.shape),
            "settings": self.sensor.settings,
        }


def recorded_stage(settings: StageSettings) -> dict[str, Any]:
    """The settings of a stage that must stay the same throughout a run; the origin is recorded with the frame."""
    return {
        "driver": settings.driver,
        "limits_mm": [list(one) for one in settings.limits_mm],
        "travel_mm_s": settings.travel_mm_s,
        "approach_mm_s": settings.approach_mm_s,
        "options": {key: value for key, value in settings.options.items() if key not in UNRECORDED},
    }


def recorded_gauge(settings: GaugeSettings) -> dict[str, Any]:
    """The settings of a gauge that must stay the same throughout a run; its calibration is recorded by itself."""
    return {"driver": settings.driver, "options": dict(settings.options)}


@contextmanager
def open_rig(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> Iterator[Rig]:
    """Open every device; they are closed in reverse when the body ends, however it ends.

    Args:
        settings: The devices.
        printed: The block under the sensor: the load of virtual and simulated devices.
        frame: Where it lies.

    Raises:
        RigError: A device is missing or is another one.
        InputError: A setting is not allowed.
    """
    from tacbench_cad.lab.rig.drivers import open_stage

    with ExitStack() as devices:
        stage_settings, gauge_settings = settings.stage, settings.gauge
        clock = Clock()
        puts: list[Put] = []
        if stage_settings.is_virtual:
            virtual, clock = _launched(settings, _load(printed, settings.holder, frame))
            devices.enter_context(virtual)
            puts.append(lambda printed, holder, frame: virtual.put(_load(printed, holder, frame)))
            stage_settings = replace(stage_settings, port=virtual.port)
            if gauge_settings.port == VIRTUAL_PORT:
                gauge_settings = replace(gauge_settings, port=virtual.gauge_port)
        stage = devices.enter_context(open_stage(stage_settings, clock))
        simulated = "load cell of the virtual rig" if settings.gauge.port == VIRTUAL_PORT else ""
        gauge = devices.enter_context(_gauge(gauge_settings, stage, clock, _ports(stage_settings.port), simulated))
        taken = _ports(stage_settings.port, gauge_settings.port)
        sensor = devices.enter_context(_sensor(settings.sensor, stage, clock, taken))
        opened: tuple[object, ...] = (gauge, sensor)
        for device in opened:
            if isinstance(device, Following):
                device.put(printed, settings.holder, frame)
                puts.append(device.put)
        yield Rig(stage=stage, gauge=gauge, sensor=sensor, clock=clock, settings=settings, puts=tuple(puts))


def _load(printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> dict[str, Any]:
    """What lies under a virtual stage, as plain values for its process."""
    return {
        "printed": printed.as_dict(),
        "holder": {"rim_mm": holder.rim_mm, "gap_mm": holder.gap_mm},
        "frame": {"origin_mm": list(frame.origin_mm), "quarter_turns": frame.quarter_turns},
    }


def _launched(settings: RigSettings, load: dict[str, Any]) -> tuple[VirtualRig, Clock]:
    """The virtual stage's process, and the time that it keeps."""
    from tacbench_cad.virtual_rig.launch import launch

    stage = settings.stage
    options = {"speed": DEFAULT_SPEED, **stage.options}
    clock = Clock(speed=_speed(options["speed"]))
    # Without a calibration the gauge's lines are taken for newtons, so it has to send them.
    cell = {"newtons": settings.gauge.calibration is None, **options.pop("gauge", {})}
    return launch(stage.driver.removeprefix("virtual-"), stimulus=load, gauge=cell, **options), clock


def _speed(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.1 <= value <= MOST_SPEED:
        raise InputError("[stage] options speed", value, f"must be from 0.1 to {MOST_SPEED:g}")
    return float(value)


def _ports(*ports: str | None) -> tuple[str, ...]:
    """Ports that another device cannot have."""
    return tuple(port for port in ports if port is not None)


def _gauge(
    settings: GaugeSettings, stage: Stage, clock: Clock, taken: tuple[str, ...], simulated: str
) -> AbstractContextManager[Gauge | None]:
    if settings.driver == "none":
        return nullcontext()
    if settings.driver == "simulated":
        from tacbench_cad.lab.simulate.devices import SimulatedGauge

        return SimulatedGauge(stage.position, clock)
    from tacbench_cad.lab.rig.loadcell import open_gauge

    return open_gauge(settings, clock, taken=taken, simulated=simulated)


def _sensor(settings: SensorSettings, stage: Stage, clock: Clock, taken: tuple[str, ...]) -> Sensor:
    if settings.driver == "simulated":
        from tacbench_cad.lab.simulate.devices import SimulatedSensor

        return SimulatedSensor(stage.position, clock, settings.options)
    from tacbench_cad.lab.rig.sensors import open_sensor

    return open_sensor(settings, clock, taken=taken)
