"""The drivers of stages, gauges and sensors, by their names in ``[stage]``, ``[gauge]`` and ``[sensor]``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.rig import plugin, ports, registry
from tacbench_cad.lab.rig.arduino import ArduinoStage
from tacbench_cad.lab.rig.calibration import read_calibration
from tacbench_cad.lab.rig.camera import open_camera
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.colours import with_inside_colours
from tacbench_cad.lab.rig.gauge import Force, Gauge
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.rig.loadcell import LoadCellOptions, open_load_cell
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.rig.registry import Context, Driver, Kind
from tacbench_cad.lab.rig.sensor import Frame, Sensor
from tacbench_cad.lab.rig.stage import LimitedStage, Stage
from tacbench_cad.lab.rig.taxels import open_taxels
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    Point,
    SensorSettings,
    StageSettings,
)
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.entries import is_own
from tacbench_cad.util.errors import InputError, MissingToolError, TacbenchError, one_line, one_of

#: The longest homing, in s.
HomeTimeout = Annotated[float, Interval(ge=0.1, le=3600.0)]
#: The distribution whose drivers are ours.
OURS = "tacbench-cad"
#: The attributes that every stage, gauge and sensor must have.
NEEDED = {
    "stage": ("identity", "simulated", "home", "move", "position", "stop", "close"),
    "gauge": ("identity", "simulated", "calibration", "read", "tare", "close"),
    "sensor": ("name", "units", "shape", "simulated", "settings", "read", "close"),
}


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


def find_driver(kind: Kind, word: str) -> Driver:
    """Return the driver that a study file names.

    Args:
        kind: The kind of device.
        word: The name of a driver, or a ``module:name`` of a :class:`~tacbench_cad.lab.rig.registry.Driver`, a class or
            a function.

    Raises:
        InputError: There is no such driver, or it cannot be imported.
    """
    field = f"[{kind}] driver"
    target = word
    if not plugin.is_plugin(word):
        found = registry.drivers(kind)
        entry = found[one_of(field, word, found)]
        target = f"{entry.module}:{entry.attr}"
    loaded = plugin.load(target, field=field)
    if isinstance(loaded, Driver):
        return loaded
    if not callable(loaded):
        raise InputError(field, word, "is not callable; name a class or a function")
    return _driver_of(loaded)


@dataclass(frozen=True, kw_only=True)
class ListedDriver:
    """A driver in the list of ``tacbench rig drivers``.

    Args:
        kind: The kind of device.
        name: The name for the study file.
        package: The package that adds the driver.
        summary: The devices that it drives.
        connection: The connection of the device; empty if the driver cannot be loaded.
        needs: The packages that it needs.
        missing: The needed packages that are not installed.
        install: The command that installs these packages; empty if none is missing.
        error: Why the driver cannot be loaded; empty if it can.
    """

    kind: Kind
    name: str
    package: str
    summary: str = ""
    connection: str = ""
    needs: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    install: str = ""
    error: str = ""


def list_drivers() -> Iterator[ListedDriver]:
    """Yield all drivers, ours first. A driver that cannot be loaded is listed with the reason. Opens no device."""
    for kind in registry.GROUPS:
        for name, entry in registry.drivers(kind).items():
            listed = ListedDriver(kind=kind, name=name, package=entry.dist.name if entry.dist else OURS)
            try:
                driver = find_driver(kind, name)
            except TacbenchError as error:
                yield replace(listed, error=one_line(error))
                continue
            yield replace(
                listed,
                summary=driver.summary,
                connection=driver.connection,
                needs=registry.distributions(driver.modules),
                missing=driver.missing,
                install=driver.install if driver.missing else "",
            )


def simulated_stages() -> tuple[str, ...]:
    """Return the names of the drivers of simulated stages, ours first."""
    names = []
    for name in registry.drivers("stage"):
        with suppress(TacbenchError):  # the driver cannot be loaded
            if find_driver("stage", name).simulated:
                names.append(name)
    return tuple(names)


def open_device(
    kind: Kind,
    settings: StageSettings | GaugeSettings | SensorSettings,
    context: Context,
    *,
    guarded: bool = True,
) -> Any:
    """Open a device as its driver does, without limits and without homing.

    Args:
        kind: The kind of device.
        settings: The device's table of a study file.
        context: The circumstances.
        guarded: Whether exceptions and wrong results of a user's driver become errors of the rig.

    Raises:
        InputError: The driver or an option does not exist.
        MissingToolError: A package that the driver needs is not installed.
        RigError: The device fails.
    """
    word = settings.driver
    driver, field = find_driver(kind, word), f"[{kind}] driver"
    if driver.missing:
        names = ", ".join(driver.missing)
        raise MissingToolError(f"{field} = {word!r}: needs {names}, not installed: run {driver.install}")
    if not guarded or (word in registry.drivers(kind) and is_own(registry.drivers(kind)[word])):
        return driver.open(settings, context)
    module = getattr(driver.open, "__module__", None) or ""
    return plugin.open_device(
        lambda: driver.open(settings, context), word, NEEDED[kind], module=module, field=field, results=RESULTS[kind]
    )


def _driver_of(factory: Callable[..., Any]) -> Driver:
    """Return the driver of a class or a function. It receives its port or device if the file names one."""

    def open(settings: StageSettings | GaugeSettings | SensorSettings, context: Context) -> Any:
        place = {name: getattr(settings, name, None) for name in ("port", "device")}
        return factory(**settings.options, **{name: value for name, value in place.items() if value is not None})

    open.__module__ = factory.__module__
    summary = next(iter((factory.__doc__ or "").strip().splitlines()), "")
    return Driver(open=open, summary=summary)


@dataclass(frozen=True, kw_only=True)
class _GrblOptions:
    home_timeout_s: HomeTimeout = 120.0
    tolerance_mm: Annotated[float, Interval(ge=0.0001, le=5.0)] | None = None


@dataclass(frozen=True, kw_only=True)
class _MarlinOptions:
    home_timeout_s: HomeTimeout = 120.0
    home_lift_mm: Annotated[float, Interval(ge=0.0, le=500.0)] = 5.0


@dataclass(frozen=True, kw_only=True)
class _ArduinoOptions:
    home_timeout_s: HomeTimeout = 120.0
    steps_per_mm: Point


def _serial(factory: Callable[..., Stage], kind: type[Any], summary: str) -> Driver:
    """Return the driver of a stage behind a serial port.

    Args:
        factory: Opens the stage.
        kind: The dataclass of its options.
        summary: The devices that it drives.
    """

    def open(settings: StageSettings, context: Context) -> Stage:
        options = vars(from_plain(kind, dict(settings.options), "[stage] options "))
        return factory(
            ports.resolve(settings.port, "stage"),
            clock=context.clock,
            baud=settings.baud,
            timeout_s=settings.timeout_s,
            simulated=context.simulated,
            **options,
        )

    return Driver(open=open, summary=summary, connection="serial port", modules=("serial",))


def _open_load_cell(settings: GaugeSettings, context: Context) -> Gauge:
    path = None if settings.calibration is None else Path(settings.calibration)
    calibration = None if path is None else read_calibration(path)
    options = LoadCellOptions.of(settings.options, calibrated=calibration is not None)
    return open_load_cell(
        ports.resolve(settings.port, "gauge", taken=context.taken),
        settings.baud,
        options=options,
        clock=context.clock,
        timeout_s=settings.timeout_s,
        calibration=calibration,
        calibration_name="" if path is None else path.name,
        simulated=context.simulated,
    )


GRBL = _serial(GrblStage, _GrblOptions, "GRBL 1.1 and grblHAL, on a serial port or over TCP")
MARLIN = _serial(MarlinStage, _MarlinOptions, "Marlin 2, most printers")
ARDUINO = _serial(ArduinoStage, _ArduinoOptions, "the Arduino firmware of the paper's authors")
#: The driver of load cells whose board sends lines.
SERIAL = Driver(
    open=_open_load_cell,
    summary="load cell whose board sends one line per sample (HX711, ADS1232)",
    connection="serial port",
    modules=("serial",),
)
OPENCV = Driver(
    open=lambda settings, context: open_camera(settings),
    summary="any USB camera that OpenCV opens",
    connection="camera",
    modules=("cv2",),
)
TAXELS = Driver(
    open=lambda settings, context: open_taxels(settings, context.clock, taken=context.taken),
    summary="array of taxels that sends one line per sample; frames or time series",
    connection="serial port",
    modules=("serial",),
)


def _point(value: Any) -> Point:
    x, y, z = (float(coordinate) for coordinate in value)
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{value} is not three numbers")
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
