"""Opening of rigs with virtual and simulated devices. The lab itself opens only real ones."""

from __future__ import annotations

from contextlib import AbstractContextManager

from tacbench_cad.extensions.virtual_rig.arm import VirtualArm
from tacbench_cad.extensions.virtual_rig.process import launch
from tacbench_cad.lab.rig import devices
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import Rig, Simulators
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.simulate.devices import SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, RigSettings, WorkFrame
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError

#: The speed of a virtual rig as a multiple of real time, if ``[stage] options.speed`` is not set.
DEFAULT_SPEED = 1.0
#: The highest speed. Beyond it, the serial port limits the speed.
MAX_SPEED = 1000.0


class LaunchedStage(Closing):
    """The running firmware of a virtual stage.

    Attributes:
        port: The port of the stage.
        gauge_port: The port of its load cell.
        clock: The clock of the virtual rig.
    """

    def __init__(self, settings: RigSettings) -> None:
        stage = settings.stage
        options = {"speed": DEFAULT_SPEED, **stage.options}
        speed = options["speed"]
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0.1 <= speed <= MAX_SPEED:
            raise InputError("[stage] options speed", speed, f"must be from 0.1 to {MAX_SPEED:g}")
        self.clock = Clock(speed=float(speed))
        # Without a calibration, the gauge's values are in newtons, so the load cell must send newtons.
        cell = {"newtons": settings.gauge.calibration is None, **options.pop("gauge", {})}
        self.rig = launch(stage.driver.removeprefix("virtual-"), gauge=cell, **options)
        self.port, self.gauge_port = self.rig.port, self.rig.gauge_port

    def put(self, printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> None:
        """Replace the block under the carriage."""
        self.rig.put(
            {
                "printed": printed.as_dict(),
                "holder": to_plain(holder),
                "frame": to_plain(frame),
            }
        )

    def close(self) -> None:
        """End the process."""
        self.rig.close()


SIMULATORS = Simulators(stage=LaunchedStage, arm=VirtualArm.open, gauge=SimulatedGauge, sensor=SimulatedSensor)


def open_rig(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> AbstractContextManager[Rig]:
    """Open any combination of devices; see :func:`tacbench_cad.lab.rig.devices.open_rig`."""
    return devices.open_rig(settings, printed, frame, simulators=SIMULATORS)
