"""Drivers: how a device is described, found and opened.

A driver is named in one of three ways, which all end in a :class:`Driver`: the name of an entry point (ours, or of an
installed package, in the groups ``tacbench.stages``, ``tacbench.gauges`` and ``tacbench.sensors``), a ``module:name``
in the working folder or the environment, or an object. The entry point, the module or the user gives a
:class:`Driver`, a class or a function that opens the device, or (an object only) the open device itself.
``tests/helpers/example_stage.py`` is a complete example.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from tacbench_cad.lab.rig import plugin
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.spec import GaugeSettings, Point, SensorSettings, StageSettings
from tacbench_cad.util.entries import entries
from tacbench_cad.util.errors import InputError, MissingToolError, TacbenchError, one_line, one_of
from tacbench_cad.util.packages import PACKAGES, has_module, install_command

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: The kind of a device.
Kind = Literal["stage", "gauge", "sensor"]
#: The connections of a device to the computer.
Connection = Literal["serial port", "camera", "network", "other"]

#: The distribution whose drivers are ours.
OURS = "tacbench-cad"
#: The attributes that every stage, gauge and sensor must have.
NEEDED = {
    "stage": ("identity", "simulated", "home", "move", "position", "stop", "close"),
    "gauge": ("identity", "simulated", "calibration", "read", "tare", "close"),
    "sensor": ("name", "units", "shape", "simulated", "settings", "read", "close"),
}
#: The entry-point group of each kind of device.
GROUPS: Mapping[Kind, str] = {"stage": "tacbench.stages", "gauge": "tacbench.gauges", "sensor": "tacbench.sensors"}


@dataclass(frozen=True, kw_only=True)
class Context:
    """The circumstances in which a device is opened.

    Args:
        clock: The rig's time.
        taken: The ports of the rig's other devices, which are not tried.
        simulated: The simulated part: emulated firmware uses the drivers of real devices.
        stage: The open :class:`~tacbench_cad.lab.rig.stage.LimitedStage` of the rig, for a simulated gauge or sensor,
            which follows it; None if a device is opened alone.
    """

    clock: Clock = field(default_factory=Clock)
    taken: Sequence[str] = ()
    simulated: str = ""
    stage: Any = None


@dataclass(frozen=True, kw_only=True)
class Driver:
    """A driver of a stage, a gauge or a sensor.

    Args:
        open: Opens the device that a table of the study file describes. Its arguments are the
            :class:`~tacbench_cad.lab.study.spec.StageSettings`, ``GaugeSettings`` or ``SensorSettings`` and the
            :class:`Context`.
        summary: The devices that it drives, in a few words.
        connection: The connection of the device.
        modules: The import names of the packages that it needs.
        install: The command that installs these packages.
        simulated: Whether the device exists only in software, so that no person puts a block into it. The object that
            ``open`` returns then may have two more members. ``put(printed, holder, frame)`` replaces the block below
            the sensor. The ``clock`` of a stage is used by the whole rig.
        defaults: The values of keys that the table of a simulated device may leave out.
        given: Whether the device was opened by the user, who also closes it.
        unrecorded: The options that are not recorded in a run, since they do not affect the measurement.
    """

    open: Callable[[Any, Context], Any]
    summary: str
    connection: Connection = "other"
    modules: tuple[str, ...] = ()
    install: str = install_command("lab")
    simulated: bool = False
    defaults: Mapping[str, Any] = field(default_factory=dict)
    given: bool = False
    unrecorded: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """The needed packages that are not installed."""
        return distributions(name for name in self.modules if not has_module(name))


def distributions(modules: Iterable[str]) -> tuple[str, ...]:
    """Return the names by which modules are installed, as far as the project knows them."""
    known = {package.module: package.distribution for package in PACKAGES}
    return tuple(known.get(name, name) for name in modules)


def drivers(kind: Kind) -> dict[str, EntryPoint]:
    """Return the entry points of the drivers of a kind of device by their names, ours first."""
    return entries(GROUPS[kind])


def driver_name(driver: Any) -> str:
    """Return the name of a driver for people and for ``run.json``: ``my_arm:Arm`` for an object of this class."""
    if isinstance(driver, str):
        return driver
    named = driver.open if isinstance(driver, Driver) else driver
    named = named if hasattr(named, "__qualname__") else type(named)
    return f"{named.__module__}:{named.__qualname__}"


def find_driver(kind: Kind, word: Any) -> Driver:
    """Return the driver that a study file or a user names.

    Args:
        kind: The kind of device.
        word: The name of a driver, a ``module:name``, or an object.

    Raises:
        InputError: There is no such driver, or it cannot be imported.
    """
    field, loaded = f"[{kind}] driver", word
    if isinstance(word, str):
        target = word
        if not plugin.is_plugin(word):
            found = drivers(kind)
            entry = found[one_of(field, word, found)]
            target = f"{entry.module}:{entry.attr}"
        loaded = plugin.load(target, field=field)
        if not isinstance(loaded, Driver) and not callable(loaded):
            raise InputError(field, word, "is not callable; name a class or a function")
    if isinstance(loaded, Driver):
        return loaded
    if callable(loaded):
        return _driver_of(loaded)
    simulated = bool(getattr(loaded, "simulated", ""))
    return Driver(open=lambda settings, context: loaded, summary=driver_name(word), simulated=simulated, given=True)


def _driver_of(factory: Callable[..., Any]) -> Driver:
    """Return the driver of a class or a function. It receives its port or device if the file names one."""

    def open(settings: StageSettings | GaugeSettings | SensorSettings, context: Context) -> Any:
        place = {name: getattr(settings, name, None) for name in ("port", "device")}
        return factory(**settings.options, **{name: value for name, value in place.items() if value is not None})

    open.__module__ = factory.__module__
    summary = next(iter((factory.__doc__ or "").strip().splitlines()), "")
    return Driver(open=open, summary=summary)


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
        InputError: The driver or an option does not exist, the driver refuses the options, or the device lacks an
            attribute.
        MissingToolError: A package that the driver needs is not installed.
        RigError: The device fails.
    """
    driver, field, name = find_driver(kind, settings.driver), f"[{kind}] driver", driver_name(settings.driver)
    if driver.missing:
        names = ", ".join(driver.missing)
        raise MissingToolError(f"{field} = {name!r}: needs {names}, not installed: run {driver.install}")
    module = getattr(driver.open, "__module__", None) or ""
    if not guarded or (module.startswith("tacbench_cad.") and not driver.given):
        return driver.open(settings, context)
    device = plugin.opened(lambda: driver.open(settings, context), name, module=module, field=field)
    missing = [attribute for attribute in NEEDED[kind] if not hasattr(device, attribute)]
    if missing:
        where = plugin.file_of(type(device).__module__)
        raise InputError(field, name, f"lacks {', '.join(missing)}" + (f" ({where})" if where else ""))
    return plugin.OwnDevice(device, f"{field} {name}", RESULTS[kind], closes=not driver.given)


def list_drivers() -> Iterator[dict[str, Any]]:
    """Yield plain values about all drivers, ours first. Opens no device.

    Each has ``kind``, ``name`` (for the study file) and ``package`` (which adds the driver). A driver that cannot be
    loaded has the reason as ``error``. The others have ``summary`` (the devices), ``connection``, ``needs`` (packages),
    ``missing`` (those that are not installed) and ``install`` (the command that installs them).
    """
    for kind in GROUPS:
        for name, entry in drivers(kind).items():
            row = {"kind": kind, "name": name, "package": entry.dist.name if entry.dist else OURS}
            try:
                driver = find_driver(kind, name)
            except TacbenchError as error:
                yield {**row, "error": one_line(error)}
                continue
            needs, install = list(distributions(driver.modules)), driver.install if driver.missing else ""
            about = {"summary": driver.summary, "connection": driver.connection, "needs": needs}
            yield {**row, **about, "missing": list(driver.missing), "install": install}


def simulated_stages() -> tuple[str, ...]:
    """Return the names of the drivers of simulated stages, ours first."""
    names = []
    for name in drivers("stage"):
        with suppress(TacbenchError):  # the driver cannot be loaded
            if find_driver("stage", name).simulated:
                names.append(name)
    return tuple(names)


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
