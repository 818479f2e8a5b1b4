"""The offers of messages of the command line, and what reads the words of its options; see :mod:`helpers.offers`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import click
import numpy as np

from helpers.offered_blocks import request_words
from helpers.offers import Offer, past, texture_file
from tacbench_cad.cli import check_part, compare, import_frames, options, rig, rig_wizard, variance
from tacbench_cad.extensions.conformance import command as rig_test_driver
from tacbench_cad.extensions.design.document import first_state
from tacbench_cad.extensions.exchange import export_command
from tacbench_cad.extensions.foreign_meshes import command as foreign_meshes
from tacbench_cad.extensions.printer_models import command as printer_model
from tacbench_cad.extensions.scan import command as scan
from tacbench_cad.extensions.simulators.folder import export_to_simulators
from tacbench_cad.extensions.slicing import check_command
from tacbench_cad.extensions.slicing.printers import printer_named, printers
from tacbench_cad.geometry.textured.frame import axes_of
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.classification.sweep import PARAMETERS, Sweep
from tacbench_cad.lab.analysis.feature import feature_of
from tacbench_cad.lab.analysis.variance.table import variance_table
from tacbench_cad.lab.runs.importing.sources import FIELDS
from tacbench_cad.lab.runs.region import parse_region
from tacbench_cad.lab.simulate.appearances import look_named
from tacbench_cad.lab.simulate.study import study_of
from tacbench_cad.lab.study.file import virtual_study
from tacbench_cad.lab.study.names import own_name
from tacbench_cad.making.request import Request
from tacbench_cad.making.showing import request_of
from tacbench_cad.spec.fits import clearance_mm
from tacbench_cad.spec.outlines import outline_of
from tacbench_cad.spec.texture_files import find_textures
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import CheckFailedError, InputError

Rows = Mapping[str, Callable[[Path], Sequence[Offer]]]


def run(command: Any, *words: object) -> None:
    """Run a command; its errors are raised. An end with another exit code than 2 is no refusal."""
    with suppress(CheckFailedError, click.exceptions.Exit, click.Abort):
        command.main([str(word) for word in words], standalone_mode=False)


def typed(line: str) -> object:
    """Type a line into the wizard's question for one of two devices."""
    with mock.patch.object(rig_wizard, "_ask", lambda _, convert: convert(line)):
        return rig_wizard._chosen("stage", ["a", "b"])


ROWS: Rows = {
    "extensions.exchange.export_command:_whole_numbers.read": lambda _: [
        Offer(
            attempt=lambda text: export_command._whole_numbers("x", 2, "WxH, for example 128x128").read("size", text),
            wrong="5",
            things={"WxH": "64x48", "128x128": "128x128"},
        )
    ],
    "cli.rig_wizard:_word": lambda _: [
        Offer(attempt=partial(rig_wizard._word, ("counts", "newtons")), wrong="xyz", things=["counts", "newtons"])
    ],
    "extensions.slicing.check_command:_frame_of 2": lambda _: [
        Offer(
            attempt=lambda text: check_command._frame_of("frame", text),
            wrong="90",
            things={"X,Y": "88.35,85", "X,Y,DEGREES": "88.35,85,90"},
        ),
        Offer(
            attempt=lambda degrees: check_command._frame_of("frame", f"1,2,{degrees}"),
            wrong="45",
            things=["0", "90", "180", "270"],
        ),
    ],
    "extensions.slicing.check_command:_block": lambda folder: [
        Offer(
            attempt=lambda word: check_command._block(word, "paper", 1.0, None),
            wrong="all",
            things={"1 to 6": ["1", "6"], "dunes": "dunes", "a TOML file": str(texture_file(folder))},
        )
    ],
    "cli.check_part:command": lambda _: [
        Offer(attempt=lambda scale: run(check_part.command, "none.stl", "--scale", scale), wrong=0.0, later="none.stl")
    ],
    "cli.compare:command": lambda _: [
        Offer(
            attempt=lambda names: run(compare.command, "none", "none2", "--estimator", names, "-o", "out"),
            wrong="forest,network,forest",
            things={"one name": "forest", "one for A and one for B": "forest,network"},
            later="none",
        )
    ],
    "extensions.exchange.export_command:command": lambda _: [
        Offer(
            attempt=lambda word: run(export_command.command, "none", "--to", word, "-o", "out"),
            wrong="xyz",
            later="none",
        )
    ],
    "cli.import_frames:_pairs_of": lambda _: [
        Offer(attempt=lambda text: import_frames._pairs_of("columns", text), wrong="label", things=["label=material"])
    ],
    "cli.options:choice": lambda _: [Offer(attempt=lambda word: options.choice("a", "b").read("jig", word), wrong="x")],
    "cli.options:coordinates.read": lambda _: [
        Offer(
            attempt=lambda text: options.coordinates("X,Y").read("size", text),
            wrong="1",
            things={"X,Y": "3,4", "1.5": "1.5,1.5"},
        )
    ],
    "cli.options:_grid_of": lambda _: [
        Offer(
            attempt=lambda text: options._grid_of("grid", text),
            wrong="5",
            things={"189x201": "189x201", "nothing for the grid of the preset": "default"},
        )
    ],
    "cli.options:_jobs_of": lambda _: [
        Offer(attempt=lambda text: options._jobs_of("jobs", text), wrong="0", things={"1 or more": ["1", "7"]})
    ],
    "extensions.printer_models.command:command": lambda _: [
        Offer(
            attempt=lambda end: run(printer_model.command, "none.json", "-o", f"model{end}"),
            wrong=".txt",
            things=[".toml"],
            later="none.json",
        )
    ],
    "cli.rig:_column_of": lambda _: [
        Offer(attempt=lambda text: rig._column_of("column", text), wrong="2", things=["2/3"])
    ],
    "extensions.conformance.command:command": lambda _: [
        Offer(
            attempt=lambda mass: run(rig_test_driver.command, "none", "--mass-g", mass),
            wrong=0,
            later="is not a driver",
        )
    ],
    "extensions.conformance.command:_kind_of": lambda _: [
        Offer(attempt=rig_test_driver._kind_of, wrong="xyz", later="is required for (simulated|serial|none)")
    ],
    "cli.rig_wizard:_chosen.convert": lambda _: [Offer(attempt=lambda line: typed(str(line)), wrong=3)],
    "cli.rig_wizard:_limits": lambda _: [
        Offer(attempt=rig_wizard._limits, wrong="1 2", things=["0 220, 0 220, 20 200"])
    ],
    "extensions.scan.command:_result": lambda _: [
        Offer(attempt=lambda layer: run(scan.command, "none.ply", "--layer", layer), wrong=0.0, later="none.ply")
    ],
    "extensions.scan.command:command": lambda _: [
        Offer(
            attempt=lambda word: run(scan.command, "--simulate", "scan.ply", "--block", word), wrong="all", things=[4]
        )
    ],
    "extensions.scan.command:_simulate": lambda _: [
        Offer(
            attempt=lambda end: run(scan.command, "--block", "1", "--simulate", f"scan{end}"),
            wrong=".stl",
            things=[".ply"],
        )
    ],
    "extensions.foreign_meshes.command:command": lambda _: [
        Offer(
            attempt=lambda words: run(foreign_meshes.command, "none.step", "--texture", "1", "-o", "a.step", *words),
            wrong=(),
            things={"a point": ("--at", "0,0,0"), "a selector for a STEP file": ("--face", ">Z")},
            later="none.step",
        )
    ],
    "cli.variance:command 2": lambda _: [
        Offer(
            attempt=lambda value: run(variance.command, "none", "--ddof", value),
            wrong="2",
            things=["0", "1"],
            later="none",
        ),
        Offer(
            attempt=lambda value: run(variance.command, "none", "--seed", value),
            wrong="-1",
            things={"0 or more": ["0", "5"]},
            later="none",
        ),
    ],
}

#: What follows an offered word that is the beginning of a value.
ENDINGS = {
    "circle:": "32,32,20",
    "rect:": "5,5,50,50",
    **{f"{name}=": "1:3" for name in PARAMETERS},
    **{f"{name}=": "column" for name in FIELDS},
}


def _region(word: str) -> object:
    return None if word in ("auto", "none") else parse_region(word, 64, 64)


def _own_word(word: str) -> str:
    """Read the name of a printer or a filament, which may be any word of file names."""
    if word == "qqqqqq":
        raise InputError("name", word, "is allowed")
    return own_name("filament", word)


#: The functions that read the words of options, by the command and the option, or by the option of all commands.
READERS: Mapping[str, Callable[[str], object]] = {
    "textures": lambda word: find_textures((word,), "paper"),
    "design texture": first_state,
    "texture": lambda word: find_textures((word,), "paper"),
    "acquire texture": lambda word: virtual_study(texture=word),
    "scan block": lambda word: find_textures((word,), "paper"),
    "outline": lambda word: outline_of(word, (20.0, 30.0)),
    "fit": clearance_mm,
    "make parts": partial(request_words, "parts"),
    "correct parts": partial(request_words, "parts"),
    "formats": partial(request_words, "formats"),
    "view parts": lambda word: request_of((word,), Request(textures=(1,))),
    "up": lambda word: axes_of(np.array([0.48, 0.6, 0.64]), word, "face"),
    "plate printer": lambda word: printer_named(word, printers()),
    "printer": _own_word,
    "filament": _own_word,
    "driver": lambda word: virtual_study(driver=word),
    "study": study_of,
    "look": look_named,
    "roi": _region,
    "features": feature_of,
    "variance protocol": past(lambda word: variance_table(None, protocol=word)),  # type: ignore[arg-type]
    "classify protocol": lambda word: from_plain(ClassificationSettings, {"protocol": word, "components": 25}),
    "estimators": lambda word: ClassificationSettings(estimators=(word,)),
    "hold_out": lambda word: ClassificationSettings(hold_out=(word,)),
    "sweep": Sweep.parsed,
    "export-runs to": lambda word: _passes(
        lambda: run(export_command.command, "none", "--to", word, "-o", "o"), "none"
    ),
    "export-simulator to": lambda word: export_to_simulators([], [word], Path("out")),
}


def _passes(call: Callable[[], object], later: str) -> None:
    """Call a command that ends later, at a file that does not exist."""
    try:
        call()
    except InputError as error:
        if later not in str(error):
            raise
