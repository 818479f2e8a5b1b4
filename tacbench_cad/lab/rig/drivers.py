"""Our drivers of stages, gauges and sensors, which ``pyproject.toml`` names as entry points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from tacbench_cad.lab.rig import ports
from tacbench_cad.lab.rig.arduino import ArduinoStage
from tacbench_cad.lab.rig.calibration import read_calibration
from tacbench_cad.lab.rig.camera import open_camera
from tacbench_cad.lab.rig.gauge import Gauge
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.rig.loadcell import LoadCellOptions, open_load_cell
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.rig.registry import Context, Driver
from tacbench_cad.lab.rig.stage import Stage
from tacbench_cad.lab.rig.taxels import open_taxels
from tacbench_cad.lab.study.spec import GaugeSettings, Point, StageSettings
from tacbench_cad.util.convert import from_plain

#: The longest homing, in s.
HomeTimeout = Annotated[float, Interval(ge=0.1, le=3600.0)]


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
