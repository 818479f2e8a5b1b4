"""Sensors by the names that ``[sensor]`` uses. The simulated one belongs to the simulator and is opened there."""

from __future__ import annotations

from tacbench_cad.lab.rig import plugin
from tacbench_cad.lab.rig.camera import open_camera
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.rig.taxels import open_taxels
from tacbench_cad.lab.study.spec import SensorSettings
from tacbench_cad.util.errors import InputError, nearest

#: What every sensor has.
NEEDED = ("name", "units", "shape", "simulated", "settings", "read", "close")
#: Drivers of real sensors that have a name of their own.
NAMES = ("opencv", "taxels")


def open_sensor(settings: SensorSettings, clock: Clock, *, taken: tuple[str, ...] = ()) -> Sensor:
    """Open the sensor that ``[sensor]`` describes.

    Args:
        settings: The table; the device of a ``module:name`` is given to it as ``device``.
        clock: The rig's time.
        taken: Ports of the rig's other devices, which it cannot have.

    Raises:
        InputError: A setting is not allowed, or there is no such device.
        RigError: The sensor fails, does not obey, or sends what cannot be a reading.
    """
    if plugin.is_plugin(settings.driver):
        given = {} if settings.device is None else {"device": settings.device}
        sensor: Sensor = plugin.made(settings.driver, {**settings.options, **given}, NEEDED)
        return sensor
    if settings.driver == "opencv":
        return open_camera(settings)
    if settings.driver == "taxels":
        return open_taxels(settings, clock, taken=taken)
    raise InputError(
        "[sensor] driver", settings.driver, f"{nearest(settings.driver, NAMES)}, or module:name for your own"
    )
