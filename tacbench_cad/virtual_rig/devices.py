"""Opens rigs with virtual and simulated devices in them; the lab itself opens real ones only."""

from __future__ import annotations

from contextlib import AbstractContextManager

from tacbench_cad.lab.rig import devices
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import Rig, Simulators
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.simulate.devices import SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, RigSettings, WorkFrame
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.virtual_rig.process import launch

#: How many times faster than real time a virtual rig runs, if ``[stage] options.speed`` does not say.
DEFAULT_SPEED = 1.0
#: Beyond this a serial port limits the speed.
MAX_SPEED = 1000.0


class LaunchedStage(Closing):
    """The firmware that the settings of a virtual stage ask for, running.

    Attributes:
        port: Where the stage's driver finds it.
        gauge_port: The port of its load cell.
        clock: The time that it keeps.
    """

    def __init__(self, settings: RigSettings) -> None:
        stage = settings.stage
        options = {"speed": DEFAULT_SPEED, **stage.options}
        speed = options["speed"]
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0.1 <= speed <= MAX_SPEED:
            raise InputError("[stage] options speed", speed, f"must be from 0.1 to {MAX_SPEED:g}")
        self.clock = Clock(speed=float(speed))
        # Without a calibration the gauge's lines are taken for newtons, so it has to send them.
        cell = {"newtons": settings.gauge.calibration is None, **options.pop("gauge", {})}
        self.rig = launch(stage.driver.removeprefix("virtual-"), gauge=cell, **options)
        self.port, self.gauge_port = self.rig.port, self.rig.gauge_port

    def put(self, printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> None:
        """Another block lies under the carriage now."""
        self.rig.put(
            {
                "printed": printed.as_dict(),
                "holder": to_plain(holder),
                "frame": to_plain(frame),
            }
        )

    def close(self) -> None:
        """End its process."""
        self.rig.close()


SIMULATORS = Simulators(stage=LaunchedStage, gauge=SimulatedGauge, sensor=SimulatedSensor)


def open_rig(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> AbstractContextManager[Rig]:
    """:func:`tacbench_cad.lab.rig.devices.open_rig` for any mixture of real, virtual and simulated devices."""
    return devices.open_rig(settings, printed, frame, simulators=SIMULATORS)
