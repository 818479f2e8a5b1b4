"""The names of the drivers: ours, and those that installed packages add by Python entry points.

A package adds a driver with an entry point in one of the groups ``tacbench.stages``, ``tacbench.gauges`` and
``tacbench.sensors``. The entry point names a :class:`Driver`, or a class or function as ``module:name`` does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.util.entries import entries
from tacbench_cad.util.packages import PACKAGES, has_module, install_command

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: The kind of a device.
Kind = Literal["stage", "gauge", "sensor"]
#: The connections of a device to the computer.
Connection = Literal["serial port", "camera", "network", "other"]

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
        unrecorded: The options that are not recorded in a run, since they do not affect the measurement.
    """

    open: Callable[[Any, Context], Any]
    summary: str
    connection: Connection = "other"
    modules: tuple[str, ...] = ()
    install: str = install_command("lab")
    simulated: bool = False
    defaults: Mapping[str, Any] = field(default_factory=dict)
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
