"""``tacbench rig``: what is plugged in, where the block lies, what the load cell's counts mean."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import console, given, note, number_of, print_json, table, whole_of, words_of
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.rig.calibration import Calibration, CalibrationPoint
    from tacbench_cad.lab.rig.loadcell import RawLoadCell

NAME = "rig"
app = typer.Typer(no_args_is_help=True, add_completion=False, rich_markup_mode="rich")


@app.callback()
def rig() -> None:
    """Look at a rig, teach it where the block lies, calibrate its load cell.

    Examples:
      tacbench rig probe                       ports and cameras by the names to write into a file
      tacbench rig align study.toml            teach the origin with the printed jig
      tacbench rig calibrate-force --port P --masses 0,50,100,200 -o gauge.json
    """


@app.command()
def probe(
    ask: Annotated[
        list[str] | None,
        typer.Option(metavar="PORT", help="Ask what is at this port; may be given more than once. Restarts boards."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """List serial ports and cameras by names that stay the same.

    Nothing is sent to a port that is not named by --ask: opening a port restarts many boards, and a stage then forgets
    where it is. Nothing that moves is ever sent. Cameras are opened for a moment for their size.

    Examples:
      tacbench rig probe
      tacbench rig probe --ask /dev/serial/by-id/usb-1a86_USB_Serial-if00-port0
      tacbench rig probe --json
    """
    from tacbench_cad.lab.rig.ports import candidates
    from tacbench_cad.lab.rig.probing import found_cameras, identify

    ports = candidates()
    answers = {}
    for port in ask or ():
        note(f"asking {port}; a silent one takes half a minute")
        answers[port] = identify(port)
    cameras = found_cameras()
    if json:
        print_json(
            {
                "ports": [
                    {"name": one.name, "device": one.device, "description": one.description, "stable": one.stable}
                    for one in ports
                ],
                "asked": answers,
                "cameras": [
                    {"name": one.name, "size_px": None if one.size_px is None else list(one.size_px)} for one in cameras
                ],
            }
        )
        return
    shown = table("Serial ports", "name", "now", "device")
    for found in ports:
        shown.add_row(found.name, found.device, found.description)
    seen = table("Cameras", "name", "size")
    for camera in cameras:
        size = "does not open" if camera.size_px is None else f"{camera.size_px[0]} x {camera.size_px[1]}"
        seen.add_row(camera.name, size)
    screen = console()
    screen.print(shown if ports else "No serial device is plugged in.")
    screen.print(seen if cameras else "No camera with a stable name is plugged in.")
    for asked, answer in answers.items():
        screen.print(f"{asked}: {answer}", soft_wrap=True)


@app.command()
def align(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="The study, with its rig.", show_default=False)],
    tolerance_mm: Annotated[
        str | None, typer.Option(metavar="MM", help="How far a marker may lie from the fitted frame. Default: 0.3.")
    ] = None,
) -> None:
    """Teach the stage where the block lies, with the printed jig; the file's origin and quarter turns are replaced.

    You drive a pointer to four markers of the jig by typed steps (x 1.5, y -0.2, z -1), then the sensor down to the
    block's highest point. The fit is shown, and refused if a marker is off. All else in the file stays as it is.

    Examples:
      tacbench rig align study.toml
      tacbench rig align study.toml --tolerance-mm 0.2
    """
    from dataclasses import replace

    from tacbench_cad.lab.rig.aligning import TOLERANCE_MM, Teaching, store_frame
    from tacbench_cad.lab.rig.errors import OutOfRangeError
    from tacbench_cad.lab.rig.reach import require_reach
    from tacbench_cad.lab.study.file import read_study
    from tacbench_cad.lab.study.presses import block_order
    from tacbench_cad.lab.study.spec import SensorSettings
    from tacbench_cad.virtual_rig.devices import open_rig

    tolerance = given(number_of, "tolerance-mm", tolerance_mm)
    if tolerance is not None and not 0.0 < tolerance <= 5.0:
        raise InputError("tolerance-mm", tolerance, "must be above 0 and at most 5 mm")
    study = read_study(file, teaching=True)
    # The sensor is not needed: its camera or port stays free, and may not even be plugged in yet.
    settings = replace(study.required_rig, sensor=SensorSettings(driver="simulated"))
    stage, protocol = settings.stage, study.study.protocol
    printed = block_order(study.study)[0].printed
    with open_rig(settings, printed, stage.frame) as opened:
        gauge = opened.gauge
        if gauge is not None:
            gauge.tare()
        teaching = Teaching(
            opened.stage,
            limits_mm=stage.limits_mm,
            ask=_ask,
            say=typer.echo,
            travel_mm_s=stage.travel_mm_s,
            approach_mm_s=stage.approach_mm_s,
            force_n=None if gauge is None else lambda: gauge.read(protocol.force_window_s).mean_n,
        )
        taught = teaching.frame(protocol, printed.block, TOLERANCE_MM if tolerance is None else tolerance)
    origin, turns = taught.frame.origin_mm, taught.frame.quarter_turns
    aligned = replace(stage, origin_mm=origin, quarter_turns=turns)
    try:
        require_reach(protocol, settings.holder, aligned.frames, stage.limits_mm)
    except InputError as error:
        raise OutOfRangeError(f"{error}; nothing is stored") from None
    store_frame(file, taught.frame)
    x, y, z = taught.frame.origin_mm
    typer.echo(
        f"stored in {file}: origin {x:z.4f}, {y:z.4f}, {z:z.4f} mm, {taught.frame.quarter_turns} quarter turns; worst "
        f"marker {taught.worst_mm:.3f} mm off, {taught.turn_deg:+z.2f} degrees left over, stretch {taught.stretch:.4f}"
    )


@app.command(name="calibrate-force")
def calibrate_force(
    masses: Annotated[str, typer.Option(metavar="G,G,...", help="Known masses in grams, 0 for none; three or more.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.json", help="Where the calibration goes.")],
    port: Annotated[
        str | None, typer.Option(metavar="P", help="The load cell's port. Default: the only one there is.")
    ] = None,
    baud: Annotated[str | None, typer.Option(metavar="N", help="Symbols per second. Default: 115200.")] = None,
    column: Annotated[
        str | None, typer.Option(metavar="I/N", help="Which of the N numbers on a line. Default: 1/1.")
    ] = None,
    falling: Annotated[bool, typer.Option("--falling", help="The counts are meant to fall under load.")] = False,
) -> None:
    """Find what a load cell's raw counts mean, with known masses.

    The file is named at calibration in the study's table gauge.

    For each mass you put it on, let it come to rest, and press Enter. A straight line is fitted and its residual shown.

    Examples:
      tacbench rig calibrate-force --port /dev/ttyUSB1 --masses 0,50,100,200 -o gauge.json
    """
    from datetime import UTC, datetime

    from tacbench_cad.lab.rig.calibration import MIN_MASSES, fit, write_calibration
    from tacbench_cad.lab.rig.clock import Clock
    from tacbench_cad.lab.rig.loadcell import LoadCellOptions, open_raw
    from tacbench_cad.lab.rig.ports import resolve

    grams = [number_of("masses", word) for word in words_of(masses) or ()]
    if len(set(grams)) < MIN_MASSES or not all(0.0 <= one <= 10_000.0 for one in grams):
        raise InputError("masses", masses, f"at least {MIN_MASSES} different ones from 0 to 10000 g are needed")
    if out.exists():
        raise InputError("out", str(out), "is there already; name another file, or remove it")
    if not out.resolve().parent.is_dir():
        raise InputError("out", str(out), "its folder does not exist")
    number, of = _column(column)
    where = resolve(port, "gauge")
    options = LoadCellOptions(columns=of, column=number)
    with open_raw(where, clock=Clock(), baud=given(whole_of, "baud", baud), options=options) as cell:
        points = tuple(_weighed(cell, mass) for mass in grams)
        garbled = cell.garbled
    found = fit(points, date_utc=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"), device=where, falling=falling)
    write_calibration(out, found)
    _print(found, out)
    if garbled:
        note(f"note: {garbled} garbled lines were skipped")


def _weighed(cell: RawLoadCell, mass_g: float) -> CalibrationPoint:
    """One point of a calibration."""
    from tacbench_cad.lab.rig.calibration import CalibrationPoint
    from tacbench_cad.lab.rig.loadcell import STILL_S

    _ask(f"{f'put {mass_g:g} g on' if mass_g else 'take everything off'}, wait for it to rest, press Enter: ")
    raw = cell.read(STILL_S)
    typer.echo(f"{mass_g:g} g: {raw.mean:z.1f} counts, spread {raw.spread:.1f}, {counted(raw.samples, 'sample')}")
    return CalibrationPoint(mass_g=mass_g, counts=raw.mean, spread_counts=raw.spread, samples=raw.samples)


def _print(found: Calibration, path: Path) -> None:
    from tacbench_cad.lab.rig.calibration import weight_n

    shown = table(
        str(path),
        "mass (g)",
        "counts",
        "force (N)",
        "off the line (N)",
        right=("mass (g)", "counts", "force (N)", "off the line (N)"),
    )
    for one in found.points:
        force = found.newtons(one.counts)
        off = force - weight_n(one.mass_g)
        shown.add_row(f"{one.mass_g:g}", f"{one.counts:z.1f}", f"{force:z.4f}", f"{off:+z.4f}")
    screen = console()
    screen.print(shown)
    screen.print(
        f"{1.0 / found.newtons_per_count:.6g} counts per newton; residual {found.residual_n:.3g} N (rms), worst "
        f"{found.worst_n:.3g} N, noise of a sample {found.noise_n:.3g} N",
        soft_wrap=True,
    )
    for warning in found.warnings:
        note(f"warning: {warning}")


def _column(text: str | None) -> tuple[int, int]:
    """``2/3`` is the second of three."""
    if text is None:
        return (1, 1)
    parts = text.split("/")
    if len(parts) != 2:
        raise InputError("column", text, "must be I/N, as in 2/3 for the second of three numbers on a line")
    number, of = (whole_of("column", part) for part in parts)
    if not 1 <= number <= of <= 1000:
        raise InputError("column", text, "must be I/N with I from 1 to N")
    return (number, of)


def _ask(prompt: str) -> str:
    """Show a prompt and return the line that was typed. A line that no terminal shows is shown here.

    Raises:
        InputError: The input has ended.
    """
    typer.echo(prompt, nl=False)
    line = sys.stdin.readline()
    if not line:
        typer.echo()
        raise InputError("answer", None, "the input has ended; nothing is stored")
    if not sys.stdin.isatty():
        typer.echo(line.strip())
    return line.strip()
