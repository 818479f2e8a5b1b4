"""The dialogue of ``tacbench rig wizard``: it fills in a study file, aligns the block and makes a first press."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from tacbench_cad.cli.common import ask_line, note, print_lines, print_next
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import ProgressLines
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.study_file import read_study
from tacbench_cad.lab.rig.camera_devices import STABLE_FOLDERS, cameras
from tacbench_cad.lab.rig.ports import candidates
from tacbench_cad.lab.rig.probing import identify
from tacbench_cad.lab.rig.registry import find_driver
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.editing import store_keys, write_template
from tacbench_cad.lab.study.names import own_name
from tacbench_cad.lab.study.spec import Study
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util import untrusted
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError

#: The number of attempts to answer a question.
_TRIES = 5
#: The word for a rig without hardware, and how many times faster than real time it runs.
_PRACTICE, _PRACTICE_SPEED = "virtual", 50.0
#: The folder of the first press, beside the study file.
FOLDER = "first-press"
#: The force of the first press and the half width of its band, in N.
FIRST_FORCE_N, FIRST_BAND_N = 0.1, 0.02
#: The depth of the first press below first touch on a rig without a gauge, in mm.
FIRST_DEPTH_MM = 0.2
#: The force above which the first press is stopped, in N.
FIRST_LIMIT_N = 1.0
#: The longest step down of the first press, in mm.
FIRST_STEP_MM = 0.05
T = TypeVar("T")


def run(path: Path, calibrate: Callable[[str, Path], None], align: Callable[[Path], None]) -> None:
    """Lead through the steps. A step whose values are already in the file is left out.

    Args:
        path: The study file. It is written if it does not exist.
        calibrate: Calibrates the load cell at a port and writes the calibration to a file.
        align: Finds the origin of the block and writes it into the study file.

    Raises:
        TacbenchError: A question was answered wrongly too often, or a device failed. The file keeps all answers.
    """
    if not path.exists():
        write_template(path)
        note(f"wrote {path}")
    note("Press Ctrl-C to stop at any time. The same command continues at the first step that is not done.")
    steps: list[tuple[str, Callable[[Path], None]]] = [
        ("The block", _block),
        ("The stage", _stage),
        ("The load cell", partial(_gauge, calibrate=calibrate)),
        ("The sensor", _sensor),
        ("The place of the block", partial(_place, align=align)),
        ("The first press", _first_press),
    ]
    for number, (title, step) in enumerate(steps, start=1):
        note(f"\nStep {number} of {len(steps)}: {title}")
        step(path)
    print_next("acquire", path)


def _block(path: Path) -> None:
    _fill(path, "block", "texture", "number of the texture in the holder, 1 to 6, or a texture file", str)
    for key, example in (("printer", "ender-3"), ("filament", "pla-minus")):
        _fill(path, "block", key, f"{key} of the block, for example {example}", partial(own_name, key))


def _stage(path: Path) -> None:
    stage = _table(path, "stage")
    if not stage.get("port") and not find_driver("stage", stage["driver"]).simulated:
        ports = [port.name for port in candidates()]
        port = _chosen("the stage", ports, f"{_PRACTICE}: no hardware, to practise")
        if port == _PRACTICE:
            frame = to_plain(find_driver("stage", "simulated").defaults)
            store_keys(path, "stage", {"driver": "simulated", "options": {"speed": _PRACTICE_SPEED}, **frame})
            store_keys(path, "gauge", {"driver": "simulated", "port": None})
            store_keys(path, "sensor", {"driver": "simulated", "exposure": None})
            return note("The stage, the load cell and the sensor are simulated.")
        store_keys(path, "stage", {"driver": _driver(port), "port": port})
    example = "-300 0, -180 0, -45 0" if _table(path, "stage")["driver"] == "grbl" else "0 220, 0 220, 20 200"
    _fill(path, "stage", "limits_mm", f"lowest and highest x, y and z in mm, for example {example}", _limits)
    return None


def _driver(port: str) -> str:
    note(f"asking {port}; if no device answers, this takes half a minute")
    answer = identify(port)
    identity = answer.identity
    note(identity)
    for setting in answer.settings:
        if setting.change:
            note(f"send {setting.change} with a serial terminal, because {setting.reason}")
    driver = identity.partition(":")[0]
    if driver not in ("grbl", "marlin"):
        raise InputError(port, identity, "is not a stage with GRBL or Marlin; check the cable and the baud rate")
    return driver


def _gauge(path: Path, calibrate: Callable[[str, Path], None]) -> None:
    gauge = _table(path, "gauge")
    if gauge["driver"] != "serial":
        return
    if not gauge.get("port"):
        taken = _table(path, "stage").get("port")
        ports = [port.name for port in candidates() if port.name != taken]
        port = _chosen("the load cell", ports, "none: press to a depth instead of a force")
        if port == "none":
            store_keys(path, "gauge", {"driver": "none"})
            store_keys(path, "protocol.targets", {"contact": "depth", "touch": "sensor"})
            return
        note(f"asking {port}")
        note(identify(port).identity)
        store_keys(path, "gauge", {"port": port})
    port = _table(path, "gauge")["port"]
    if _table(path, "gauge").get("calibration"):
        return
    if _ask("does the load cell send counts or newtons?", partial(_word, ("counts", "newtons"))) == "counts":
        file = path.with_name("gauge.json")
        if not file.exists():
            calibrate(port, file)
        store_keys(path, "gauge", {"calibration": file.name})


def _sensor(path: Path) -> None:
    sensor = _table(path, "sensor")
    if sensor["driver"] != "opencv":
        return
    if not sensor.get("device"):
        store_keys(path, "sensor", {"device": _chosen("the camera", cameras(STABLE_FOLDERS))})
    _fill(path, "sensor", "exposure", "exposure of the camera, in its own unit", float)


def _place(path: Path, align: Callable[[Path], None]) -> None:
    if not _table(path, "stage").get("origin_mm"):
        ask_line("screw the holder to the stage, put the jig over it, mount the pointer, and press Enter: ")
        align(path)


def _first_press(path: Path) -> None:
    chosen = read_study(path)
    study = first_press(chosen.study)
    protocol = study.protocol
    force = protocol.targets.contact == "force"
    goal = f"{protocol.targets.forces_n[0]:g} N" if force else f"{protocol.targets.depths_mm[0]:g} mm below first touch"
    note(f"One press in the middle of the grid, to {goal}, in steps of {protocol.steps.approach_step_mm:g} mm.")
    if force:
        note(f"A force of {protocol.limits.hard_limit_n:g} N stops it and lifts the sensor.")
    note("Keep a hand at the switch that cuts the power of the motors.")
    folder = path.with_name(FOLDER)
    ask_line("take the pointer and the jig away, mount the sensor, put the block in, and press Enter: ")
    acquire_study(
        study,
        chosen.required_rig,
        folder,
        person=Typing(partial(ask_line, err=True), note),
        progress=ProgressLines(folder),
    )
    (row,) = Run.open(folder / study.blocks[0].printed.name).rows
    measured = "" if row.measured_force_n is None else f" with {row.measured_force_n:.3f} N"
    print_lines(f"pressed to z = {row.pose_mm[2]:z.3f} mm{measured}; the frame is {folder / 'last.png'}")


def first_press(study: Study) -> Study:
    """Return a study of one careful press on the first block of a study.

    Forces, depth and steps are small, whatever the study's protocol says. Its other settings stay.
    """
    protocol = study.protocol
    x, y = protocol.positions.grid.x_mm, protocol.positions.grid.y_mm
    careful = protocol.changed(
        grid=PressGrid(x_mm=(x[len(x) // 2],), y_mm=(y[len(y) // 2],)),
        repeats=1,
        stationary_frames=0,
        motion=None,
        forces_n=(FIRST_FORCE_N,),
        bands_n=(FIRST_BAND_N,),
        depths_mm=(FIRST_DEPTH_MM,),
        hard_limit_n=min(protocol.limits.hard_limit_n, FIRST_LIMIT_N),
        approach_step_mm=min(protocol.steps.approach_step_mm, FIRST_STEP_MM),
    )
    return replace(
        study, blocks=(replace(study.blocks[0], levels=careful.all_levels),), protocol=careful, grid_spacing="own"
    )


def _table(path: Path, name: str) -> dict[str, Any]:
    table: dict[str, Any] = untrusted.read_document(path, "study", "toml").get(name, {})
    return table


def _fill(path: Path, table: str, key: str, question: str, convert: Callable[[str], Any]) -> None:
    """Ask for a value if the file has none."""
    if _table(path, table).get(key) in (None, "", []):
        store_keys(path, table, {key: _ask(question, convert)})


def _ask(question: str, convert: Callable[[str], T]) -> T:
    """Ask until the answer can be converted.

    Raises:
        InputError: The last attempt was wrong too.
    """
    for attempt in range(_TRIES):
        try:
            line = ask_line(f"{question}: ")
            if not line:
                raise InputError("answer", line, "must not be empty")
            return convert(line)
        except (InputError, ValueError) as error:
            if attempt == _TRIES - 1 or (isinstance(error, InputError) and error.field == "standard input"):
                raise InputError("answer", None, f"is missing: {question}") from None
            note(f"{error}; again, please")
    raise AssertionError


def _chosen(what: str, names: Sequence[str], other: str = "") -> str:
    """Let the user choose a device by its number, or type its name."""
    for number, name in enumerate(names, start=1):
        print_lines(f"  {number}  {name}")
    print_lines(*([f"  {other}"] if other else []))

    def convert(line: str) -> str:
        if line.isdecimal():
            if not 1 <= int(line) <= len(names):
                raise InputError("number", line, f"must be from 1 to {len(names)}" if names else "no device is listed")
            return names[int(line) - 1]
        return line

    return _ask(f"which is {what}? Type its number or its name", convert)


def _limits(line: str) -> list[list[float]]:
    pairs = [[float(word) for word in part.split()] for part in line.split(",")]
    if len(pairs) != 3 or any(len(pair) != 2 or not pair[0] < pair[1] for pair in pairs):
        raise InputError(
            "limits", line, "must be three pairs with the lower number first, such as 0 220, 0 220, 20 200"
        )
    return pairs


def _word(words: Sequence[str], line: str) -> str:
    if line not in words:
        raise InputError("answer", line, f"must be {' or '.join(words)}")
    return line
