"""The drivers of stages with emulated firmware and of their load cell. Each runs the driver of a real device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tacbench_cad.extensions.virtual_rig.loadcell import BlockUnderDome
from tacbench_cad.extensions.virtual_rig.server import VirtualRig, launch
from tacbench_cad.lab.rig import SERIAL, Clock, Closing, Context, Driver, Gauge, GrblStage, MarlinStage, inner
from tacbench_cad.lab.study import GaugeSettings, HolderRim, PrintedBlock, StageSettings, WorkFrame
from tacbench_cad.util.errors import InputError

#: The highest speed as a multiple of real time. Beyond it, the serial port limits the speed.
MAX_SPEED = 1000.0


class _Emulated(Closing):
    """The part of a stage that knows its emulated firmware.

    Attributes:
        rig: The running firmware.
        clock: The clock of the virtual rig.
    """

    rig: VirtualRig
    clock: Clock

    def put(self, printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> None:
        """Replace the block under the carriage."""
        self.rig.put(BlockUnderDome(printed=printed, holder=holder, frame=frame))

    def close(self) -> None:
        """Close the port, and end the firmware."""
        super().close()
        self.rig.close()


class VirtualGrblStage(_Emulated, GrblStage):
    """A stage with emulated GRBL."""


class VirtualMarlinStage(_Emulated, MarlinStage):
    """A stage with emulated Marlin."""


def _driver(
    kind: str, stage: type[VirtualGrblStage] | type[VirtualMarlinStage], known: tuple[str, ...], **defaults: Any
) -> Driver:
    """Return the driver of an emulated stage.

    Args:
        kind: The firmware.
        stage: The class of the stage.
        known: The options of the driver. The others are those of :func:`launch`.
        **defaults: The origin of the work frame and the limits, in mm.
    """

    def open(settings: StageSettings, context: Context) -> VirtualGrblStage | VirtualMarlinStage:
        own: dict[str, Any] = {key: value for key, value in settings.options.items() if key in known}
        emulated = {key: value for key, value in settings.options.items() if key not in known}
        clock = Clock(speed=_speed(settings.options))
        rig = launch(kind, gauge={"newtons": True, **emulated.pop("gauge", {})}, **emulated)
        try:
            if settings.baud is not None:
                own["baud"] = settings.baud
            simulated = f"stage ({settings.driver})"
            opened = stage(rig.port, clock=clock, timeout_s=settings.timeout_s, simulated=simulated, **own)
        except BaseException:
            rig.close()
            raise
        opened.rig, opened.clock = rig, clock
        return opened

    return Driver(
        open=open,
        summary=f"emulated {kind}, behind a port",
        modules=("serial",),
        simulated=True,
        defaults=defaults,
        unrecorded=("speed", "tcp", "faults"),
    )


def _speed(options: Mapping[str, Any]) -> float:
    speed = options.get("speed", 1.0)
    if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0.1 <= speed <= MAX_SPEED:
        raise InputError("[stage] options speed", speed, f"must be from 0.1 to {MAX_SPEED:g}")
    return float(speed)


def _open_cell(settings: GaugeSettings, context: Context) -> Gauge:
    stage = context.stage and inner(context.stage)
    if not isinstance(stage, _Emulated):
        raise InputError("[gauge] driver", settings.driver, "works only with a stage that has emulated firmware")
    port = replace(settings, port=stage.rig.gauge_port)
    gauge: Gauge = SERIAL.open(port, replace(context, simulated="load cell of the virtual rig"))
    return gauge


_XY_MM = ((0.0, 200.0), (0.0, 200.0))
GRBL = _driver(
    "grbl",
    VirtualGrblStage,
    ("home_timeout_s", "tolerance_mm"),
    origin_mm=(80.0, 80.0, -60.0),
    limits_mm=(*_XY_MM, (-100.0, 0.0)),
)
MARLIN = _driver(
    "marlin",
    VirtualMarlinStage,
    ("home_timeout_s", "home_lift_mm"),
    origin_mm=(80.0, 80.0, 40.0),
    limits_mm=(*_XY_MM, (0.0, 100.0)),
)
LOAD_CELL = Driver(open=_open_cell, summary="load cell of an emulated stage", modules=("serial",), simulated=True)
