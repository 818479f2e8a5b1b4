"""``tacbench rig``: find devices, calibrate the load cell, align the block."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import ask_line, note, print_json, print_lines, print_next, print_table
from tacbench_cad.util.errors import InputError, located
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.rig.calibration import Calibration, CalibrationPoint
    from tacbench_cad.lab.rig.loadcell import LoadCell


@options.group("rig", "Press")
def command() -> None:
    """Find devices, calibrate the load cell, align the block.

    For a new rig, begin with wizard: it leads through the other commands and makes a first press. Only wizard, align
    and test-driver move the stage. Align homes it, makes the steps that you type, and travels to the last two markers
    by itself.

    Examples:
      tacbench rig wizard study.toml   # all steps, one after another
      tacbench rig drivers             # devices that can be used
      tacbench rig probe               # names of ports and cameras
      tacbench rig calibrate-force --masses 0,50,100,200 -o gauge.json
      tacbench rig align study.toml    # find the block's origin with the jig
    """


@options.command("probe", command)
@options.option(
    "--ask",
    options.text("PORT", complete=completing.of_files),
    "Ask which device is at this port. Can be repeated. Opening the port restarts many boards.",
    options.INPUT,
    multiple=True,
)
@options.option(
    "--study",
    options.file("FILE.toml"),
    "Compare the settings of the firmware with the limits and speeds of this study file.",
    options.INPUT,
)
@options.json
def probe(ask: tuple[str, ...], study: Path | None, json: bool) -> None:
    """List ports and cameras, and check firmware settings.

    Write the listed names into the study file. They stay the same when you unplug a device and plug it in again.

    The command opens a port only if you name it with --ask. Many boards restart when their port is opened, and the
    stage then loses its position. The command never sends anything that moves the stage. It opens each camera for a
    moment to read its image size.

    If a named port has a stage with GRBL, grblHAL or Marlin, the command lists the settings of its firmware. It says
    which ones to change and why. It changes nothing itself.

    Examples:
      tacbench rig probe
      tacbench rig probe --ask /dev/serial/by-id/usb-1a86_USB_Serial-if00-port0
      tacbench rig probe --ask /dev/ttyUSB0 --study my-rig.toml
      tacbench rig probe --json
    """
    from tacbench_cad.lab.acquire.study_file import read_study
    from tacbench_cad.lab.rig.ports import candidates
    from tacbench_cad.lab.rig.probing import identify, plugged_cameras
    from tacbench_cad.util.convert import to_plain

    stage = None if study is None else read_study(study, teaching=True).required_rig.stage
    ports = candidates()
    answers = {}
    for port in ask:
        note(f"asking {port}; if no device answers, this takes half a minute")
        answers[port] = identify(port, stage)
    cameras = plugged_cameras()
    if json:
        asked = {port: answer.identity for port, answer in answers.items()}
        settings = {port: to_plain(answer.settings) for port, answer in answers.items() if answer.settings}
        print_json({"ports": to_plain(ports), "asked": asked, "settings": settings, "cameras": to_plain(cameras)})
        return
    if ports:
        rows = [(port.name, port.device, port.description) for port in ports]
        print_table("Serial ports", ("name", "device now", "description"), rows)
    else:
        print_lines("No serial device is plugged in.")
    if cameras:
        sizes = ["does not open" if camera.size_px is None else "{} x {}".format(*camera.size_px) for camera in cameras]
        names = [camera.name for camera in cameras]
        print_table("Cameras", ("name", "size"), zip(names, sizes, strict=True))
    else:
        print_lines("No camera with a stable name is plugged in.")
    for port, answer in answers.items():
        print_lines(f"{port}: {answer.identity}")
        if answer.settings:
            checked = [(each.name, each.value, each.meaning, each.change, each.reason) for each in answer.settings]
            print_table("Settings of the firmware", ("setting", "value", "meaning", "send", "why"), checked)
            changes = sum(bool(each.change) for each in answer.settings)
            print_lines(f"{counted(changes, 'setting')} to change" if changes else "No setting must be changed.")
    print_next("acquire", "--init", "study.toml")


@options.command("wizard", command)
@options.argument("study_file", options.file("FILE.toml"), "Study file. It is written if it does not exist.")
@click.pass_context
def wizard(context: click.Context, study_file: Path) -> None:
    """Set up a new rig step by step.

    The wizard asks for the block, the stage, the load cell and the sensor, calibrates the load cell, and writes the
    answers into the study file. Then it aligns the block and makes one careful press of 0.1 N. A step is left out if
    the file already has its values, so you can interrupt the wizard and type the same command again.

    To practise without hardware, type virtual when the wizard asks for the stage.

    Examples:
      tacbench rig wizard my-rig.toml
    """
    from tacbench_cad.cli import rig_wizard

    def calibrate(port: str, file: Path) -> None:
        masses = ask_line("known masses in grams, with 0, for example 0,50,100,200: ")
        values = options.numbers_of("masses", masses)
        context.invoke(calibrate_force, masses=values, port=port, baud=None, column=(1, 1), falling=False, out=file)

    rig_wizard.run(study_file, calibrate, lambda path: context.invoke(align, study_file=path, tolerance_mm=None))


@options.command("drivers", command)
@options.json
def drivers(json: bool) -> None:
    """List the drivers of stages, gauges and sensors.

    For each driver, you see the packages that it needs. The command opens no device; "tacbench rig probe" lists the
    connected ones.

    Other packages can add drivers by the entry points tacbench.stages, tacbench.gauges and tacbench.sensors.

    Examples:
      tacbench rig drivers
      tacbench rig drivers --json
    """
    from tacbench_cad.lab.rig.registry import list_drivers

    listed = tuple(list_drivers())
    if json:
        print_json({"drivers": listed})
        return
    for kind in dict.fromkeys(driver["kind"] for driver in listed):
        rows = [_driver_cells(driver) for driver in listed if driver["kind"] == kind]
        print_table(f"{kind.capitalize()}s", ("driver", "devices", "connection", "needs"), rows)
    print_next("rig", "probe")


def _driver_cells(driver: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a driver's row."""
    if "error" in driver:
        return (driver["name"], driver["error"], "", driver["package"])
    needs = ", ".join(driver["needs"])
    if driver["missing"]:
        needs = f"missing: {', '.join(driver['missing'])}; {driver['install']}"
    return (driver["name"], driver["summary"], driver["connection"], needs)


def _column_of(option: str, text: str) -> tuple[int, int]:
    parts = text.split("/")
    if len(parts) != 2:
        raise InputError(option, text, "must be I/N; for example 2/3 is the second of three numbers in a line")
    number, count = (options.whole_of(option, part) for part in parts)
    if not 1 <= number <= count <= 1000:
        raise InputError(option, text, "must be I/N with I from 1 to N")
    return number, count


@options.command("calibrate-force", command)
@options.option(
    "--masses",
    options.Value("G,G,...", options.numbers_of),
    "Known masses in grams, at least three. 0 means no mass.",
    options.INPUT,
    required=True,
)
@options.option(
    "--port",
    options.text("PORT", complete=completing.of_files),
    "Port of the load cell. You can leave it out if only one port is plugged in.",
    options.INPUT,
)
@options.option("--baud", options.COUNT, "Baud rate. Default: 115200.", options.ADVANCED)
@options.option(
    "--column",
    options.Value("I/N", _column_of),
    "Use the I-th of the N numbers in a line.",
    options.ADVANCED,
    default="1/1",
)
@options.flag("--falling", "The counts of this load cell fall under load.", options.ADVANCED)
@options.out("FILE.json", "File of the calibration.", required=True)
def calibrate_force(
    masses: tuple[float, ...], port: str | None, baud: int | None, column: tuple[int, int], falling: bool, out: Path
) -> None:
    """Convert the counts of a load cell into newtons.

    For each mass, you put the mass on the load cell, wait until it rests, and press Enter. The command fits a straight
    line and prints the residuals.

    To use the calibration, open the study file. In the table gauge, set the key calibration to the name of the file.

    Examples:
      tacbench rig calibrate-force --masses 0,50,100,200 -o gauge.json
      tacbench rig calibrate-force --port /dev/ttyUSB1 --masses 0,50,100 -o g.json
    """
    from datetime import UTC, datetime

    from tacbench_cad.lab.rig.calibration import MIN_MASSES, fit, write_calibration
    from tacbench_cad.lab.rig.clock import Clock
    from tacbench_cad.lab.rig.loadcell import LoadCellOptions, open_load_cell
    from tacbench_cad.lab.rig.ports import resolve

    if len(set(masses)) < MIN_MASSES or not all(0.0 <= mass <= 10_000.0 for mass in masses):
        shown = ",".join(f"{mass:g}" for mass in masses)
        raise InputError("masses", shown, f"name at least {MIN_MASSES} different masses from 0 to 10000 g")
    if out.exists():
        raise InputError("out", str(out), "exists already; name another file, or remove it")
    if not out.resolve().parent.is_dir():
        raise InputError("out", str(out), "the folder does not exist; make it first")
    where = resolve(port, "gauge")
    how = LoadCellOptions(columns=column[1], column=column[0])
    with open_load_cell(where, baud, clock=Clock(), options=how) as cell:
        points = tuple(_weighed(cell, mass) for mass in masses)
        garbled = cell.garbled
    calibration = fit(points, date_utc=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"), device=where, falling=falling)
    write_calibration(out, calibration)
    _print(calibration, out)
    if garbled:
        note(f"note: {garbled} garbled lines were skipped")
    print_next("rig", "align", "FILE.toml")


@options.command("align", command)
@options.argument("study_file", options.file("FILE.toml"), "Study file that describes the rig.")
@options.option(
    "--tolerance-mm",
    options.MM,
    "Largest allowed distance between a marker and its fitted position. Default: 0.3.",
    options.ACCURACY,
)
def align(study_file: Path, tolerance_mm: float | None) -> None:
    """Find the origin of the block with the printed jig.

    You move a pointer to two markers of the jig by typing steps, for example x 1.5, y -0.2 or z -1. The stage travels
    to two more markers by itself, and you correct its position. Then you move the sensor down to the highest point of
    the block. The command fits the position and the rotation of the block, and prints the fit. If a marker is too far
    from its fitted position, nothing is stored.

    The command writes the origin and the number of quarter turns into the study file. It changes nothing else in the
    file.

    After an error, Ctrl-C or a lost terminal, the command lifts the stage and ends.

    Examples:
      tacbench rig align study.toml
      tacbench rig align study.toml --tolerance-mm 0.2
    """
    from dataclasses import replace

    from tacbench_cad.lab.acquire.safety import RunInterruptedError
    from tacbench_cad.lab.acquire.session import require_reach
    from tacbench_cad.lab.acquire.signals import Signals
    from tacbench_cad.lab.acquire.study_file import read_study
    from tacbench_cad.lab.rig.aligning import TOLERANCE_MM, Teaching, corner_markers, store_frame
    from tacbench_cad.lab.rig.devices import open_rig
    from tacbench_cad.lab.rig.errors import OutOfRangeError, RigError
    from tacbench_cad.lab.study.presses import block_order
    from tacbench_cad.lab.study.spec import SensorSettings

    if tolerance_mm is not None and not 0.0 < tolerance_mm <= 5.0:
        raise InputError("tolerance mm", tolerance_mm, "must be above 0 and at most 5 mm")
    study = read_study(study_file, teaching=True)
    # The sensor is not needed: its camera or port stays free, and may not even be plugged in yet.
    settings = replace(study.required_rig, sensor=SensorSettings(driver="simulated"))
    stage, protocol = settings.stage, study.study.protocol
    printed = block_order(study.study)[0].printed
    corner_markers(protocol.positions.grid)  # a grid that shows no rotation is refused before a device is opened

    def give_up(error: RunInterruptedError) -> None:
        note(f"error: interrupted; gave up {error.gave_up}, which did not return; look whether the sensor is lifted")

    with (
        located(f"{study_file}: ", fields="["),
        Signals(give_up) as signals,
        open_rig(settings, printed, stage.frame) as opened,
    ):
        gauge = opened.gauge
        if gauge is not None:
            gauge.tare()
        teaching = Teaching(
            stage=opened.stage,
            # The driver may have lowered the upper limit, to keep clear of the end stop.
            limits_mm=getattr(opened.stage, "limits_mm", stage.limits_mm),
            ask=ask_line,
            say=click.echo,
            travel_mm_s=stage.travel_mm_s,
            approach_mm_s=stage.approach_mm_s,
            force_n=None if gauge is None else lambda: gauge.read(protocol.steps.force_window_s).mean_n,
            may_home=stage.home,
            uninterrupted=signals.ignored,
        )
        try:
            fit = teaching.frame(protocol, printed.block, TOLERANCE_MM if tolerance_mm is None else tolerance_mm)
        except RunInterruptedError:
            raise KeyboardInterrupt(teaching.not_lifted or "the sensor is lifted") from None
        except RigError as error:
            if teaching.not_lifted:
                error.args = (f"{error}; {teaching.not_lifted}",)
            raise
    origin, turns = fit.frame.origin_mm, fit.frame.quarter_turns
    aligned = replace(stage, origin_mm=origin, quarter_turns=turns)
    try:
        require_reach(protocol, settings.holder, aligned.frames, stage.limits_mm)
    except InputError as error:
        raise OutOfRangeError(f"{error}; nothing is stored") from None
    store_frame(study_file, fit.frame)
    x, y, z = fit.frame.origin_mm
    click.echo(
        f"stored in {study_file}: origin {x:z.4f}, {y:z.4f}, {z:z.4f} mm, {fit.frame.quarter_turns} quarter turns\n"
        f"largest error of a marker {fit.worst_mm:.3f} mm, remaining rotation {fit.turn_deg:+z.2f} degrees, "
        f"stretch {fit.stretch:.4f}"
    )
    print_next("acquire", study_file)


def _weighed(cell: LoadCell, mass_g: float) -> CalibrationPoint:
    """Measure one point of a calibration."""
    from tacbench_cad.lab.rig.calibration import CalibrationPoint
    from tacbench_cad.lab.rig.loadcell import STILL_S

    task = f"put {mass_g:g} g on the load cell" if mass_g else "remove everything from the load cell"
    ask_line(f"{task}, wait until nothing moves, press Enter: ")
    raw = cell.mean(STILL_S)
    click.echo(
        f"{mass_g:g} g: {raw.mean:z.1f} counts, standard deviation {raw.spread:.1f}, {counted(raw.samples, 'sample')}"
    )
    return CalibrationPoint(mass_g=mass_g, counts=raw.mean, spread_counts=raw.spread, samples=raw.samples)


def _print(calibration: Calibration, path: Path) -> None:
    from tacbench_cad.lab.rig.calibration import weight_n

    forces = [(point, calibration.newtons(point.counts)) for point in calibration.points]
    print_table(
        str(path),
        (">mass (g)", ">counts", ">force (N)", ">residual (N)"),
        [
            (f"{point.mass_g:g}", f"{point.counts:z.1f}", f"{force:z.4f}", f"{force - weight_n(point.mass_g):+z.4f}")
            for point, force in forces
        ],
    )
    print_lines(
        f"{1.0 / calibration.newtons_per_count:.6g} counts per newton; residual {calibration.residual_n:.3g} N (rms), "
        f"largest residual {calibration.worst_n:.3g} N, noise of a sample {calibration.noise_n:.3g} N"
    )
    for warning in calibration.warnings:
        note(f"warning: {warning}")
