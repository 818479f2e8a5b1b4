"""The offers of messages about rigs, runs and analyses; see :mod:`helpers.offers`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from helpers.offers import Offer, past
from helpers.rigs import printed, rig_settings, small_protocol
from helpers.rigs import study_of as small_study
from helpers.wrong_drivers import GoodSensor
from tacbench_cad.extensions.devices.klipper import KlipperStage
from tacbench_cad.extensions.exchange.exporting.export_formats import export_runs as export_runs_to
from tacbench_cad.extensions.exchange.exporting.tactile_data import Processing
from tacbench_cad.extensions.exchange.importing.authors import _options_of as authors_options
from tacbench_cad.extensions.exchange.publishing.publication import Author, Publication
from tacbench_cad.extensions.markers.markers import MarkerSettings
from tacbench_cad.extensions.virtual_rig import drivers
from tacbench_cad.extensions.virtual_rig.setup import Setup
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.touch import taught
from tacbench_cad.lab.analysis.classification.augment import Augmentation
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.classification.sweep import PARAMETERS, Sweep
from tacbench_cad.lab.analysis.feature import feature_of
from tacbench_cad.lab.analysis.report.cite import citations
from tacbench_cad.lab.analysis.report.page import write_report
from tacbench_cad.lab.analysis.variance.table import variance_table
from tacbench_cad.lab.rig import plugin, registry
from tacbench_cad.lab.rig.aligning import parse_step
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.colours import channels_fault
from tacbench_cad.lab.rig.drivers import find_driver
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.loadcell import LoadCellOptions
from tacbench_cad.lab.rig.ports import resolve
from tacbench_cad.lab.rig.registry import Context
from tacbench_cad.lab.rig.samples import require_stuck_samples
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.frame_files import write_png
from tacbench_cad.lab.runs.importing.array_files import array_name
from tacbench_cad.lab.runs.importing.import_formats import _Formats
from tacbench_cad.lab.runs.importing.import_options import ImportOptions
from tacbench_cad.lab.runs.importing.sources import columns_of_fields, field_of
from tacbench_cad.lab.runs.region import parse_region
from tacbench_cad.lab.simulate.appearances import LOOKS, look_named
from tacbench_cad.lab.simulate.study import study_of
from tacbench_cad.lab.simulate.tactip import TacTip
from tacbench_cad.lab.study.file import _protocol, virtual_study
from tacbench_cad.lab.study.spec import GaugeSettings, SensorSettings, StageSettings
from tacbench_cad.util.errors import InputError

Rows = Mapping[str, Callable[[Path], Sequence[Offer]]]

STUDY = '[block]\ntexture = 2\nprinter = "bambu-p1p"\nfilament = "pla-minus"\n'
AUTHOR = {"family_name": "A", "given_names": "B", "affiliation": "C"}
LIMITS = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))


def stated_channels(word: str) -> None:
    """Check the order of colours that a sensor states."""
    if fault := channels_fault(GoodSensor(), word):  # type: ignore[arg-type]
        raise InputError("sensor", None, fault)


def options_of(driver: str, key: str) -> object:
    """Open a stage that is not there with an option."""
    settings = StageSettings(driver=driver, port="/dev/none", limits_mm=LIMITS, options={key: 1.0})
    return find_driver("stage", driver).open(settings, Context(clock=Clock()))


def klipper(url: str) -> object:
    try:
        return KlipperStage(url, timeout_s=0.1)
    except RigError:  # nobody answers there
        return None


def launched(speed: float) -> object:
    """Prepare a virtual rig without starting it."""
    stage = replace(rig_settings().stage, driver="virtual-grbl", options={"speed": speed})
    with mock.patch.object(drivers, "launch", side_effect=AttributeError):
        return past(lambda settings: drivers.GRBL.open(settings, Context()))(stage)


def publication(**values: Any) -> Publication:
    given = {
        "title": "T",
        "description": "D",
        "licence": "CC-BY-4.0",
        "authors": (Author(**AUTHOR),),
        "year": 2026,
        "publisher": "P",
    }
    return Publication(**{**given, **values})


def _literal(kind: object) -> Offer:
    return Offer(attempt=lambda text: schema._parser(kind, 1)("column", text), wrong="xyz")


def board(kind: str, key: str) -> object:
    return Setup.of(kind, **{key: 1.0}).board()


def levels(level: int) -> object:
    study = small_study(small_protocol(), 1)
    return replace(study, blocks=(replace(study.blocks[0], levels=(level,)),))


def mask_file(folder: Path) -> Path:
    """Write a picture that is white in its middle."""
    mask = np.zeros((64, 64), np.uint8)
    mask[10:50, 10:50] = 255
    write_png(folder / "mask.png", mask)
    return folder / "mask.png"


def study_file(folder: Path) -> Path:
    """Write a study file, which messages call "a TOML file"."""
    path = folder / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def _sweep(name: str) -> Offer:
    forms = {"LOW:HIGH": "1:3", "LOW:HIGH:STEPS": "1:30:3", "A,B,C": "1,2,5"}
    things = {f"{name}={form}": f"{name}={value}" for form, value in forms.items()}
    return Offer(attempt=Sweep.parsed, wrong=f"{name}=a", things=things)


ROWS: Rows = {
    "lab.acquire.person:Typing.put_in": lambda _: [
        Offer(
            attempt=lambda line: Typing(lambda _: line, print).put_in(printed(1), "T1 PAPER X1 01", None),
            wrong="T4 PAPER X1 01",
            things=["T1 PAPER X1 01"],
        )
    ],
    "lab.acquire.touch:taught": lambda _: [
        Offer(attempt=lambda count: taught([0.0] * count, 4), wrong=2, things={"one finite height": 1, "4, one for": 4})
    ],
    "lab.analysis.classification.augment:Augmentation.__post_init__ 2": lambda _: [
        Offer(attempt=lambda value: Augmentation(noise=value), wrong=0.0, things={"above 0": 0.1, "none": None}),
        Offer(
            attempt=lambda value: Augmentation(brightness=value),
            wrong=(0.0,),
            things={"numbers other than 0": (0.5, -1.0), "none": ()},
        ),
    ],
    "lab.analysis.classification.settings:ClassificationSettings.__post_init__ 5": lambda _: [
        Offer(
            attempt=lambda name: ClassificationSettings(estimators=(name,)),
            wrong="xyz",
            things=["forest", "network", "module:name"],
        ),
        Offer(attempt=lambda name: ClassificationSettings(estimators=(name,)), wrong="xyz"),
        Offer(
            attempt=lambda names: ClassificationSettings(estimators=names),
            wrong=("forest", "forest"),
            things={"one or more different names": ("forest", "network")},
        ),
        Offer(attempt=lambda level: ClassificationSettings(hold_out=(level,)), wrong="xyz"),
        Offer(
            attempt=lambda count: ClassificationSettings(protocol="paper", components=count),
            wrong=None,
            things={"25": 25},
        ),
    ],
    "lab.analysis.classification.sweep:Sweep.parsed 2": lambda _: [
        Offer(attempt=lambda name: Sweep.parsed(f"{name}=1:3"), wrong="xyz"),
        *(_sweep(name) for name in PARAMETERS),
    ],
    "lab.analysis.feature:feature_of 3": lambda _: [
        Offer(attempt=feature_of, wrong="xyz"),
        Offer(attempt=lambda key: feature_of(f"markers:{key}=3"), wrong="xyz"),
        Offer(
            attempt=lambda value: feature_of(f"markers:dark={value}"),
            wrong="red",
            things={"a number": "3", "true": "true", "false": "false"},
        ),
    ],
    "lab.analysis.report.cite:citations": lambda _: [Offer(attempt=citations, wrong="xyz")],
    "lab.analysis.report.page:write_report": lambda _: [
        Offer(
            attempt=lambda end: write_report([Path("none")], Path(f"report{end}")),
            wrong=".txt",
            things=[".html"],
            later="none",
        )
    ],
    "lab.analysis.variance.table:variance_table 2": lambda _: [
        Offer(attempt=past(lambda word: variance_table(None, protocol=word)), wrong="xyz"),  # type: ignore[arg-type]
        Offer(attempt=past(lambda value: variance_table(None, ddof=value)), wrong=2, things=[0, 1]),  # type: ignore[arg-type]
    ],
    "extensions.exchange.publishing.publication:Author.__post_init__": lambda _: [
        Offer(attempt=lambda text: Author(**AUTHOR, orcid=text), wrong="0", things=["0000-0002-1825-0097"])
    ],
    "extensions.exchange.publishing.publication:Publication.__post_init__ 4": lambda _: [
        Offer(attempt=lambda year: publication(year=year), wrong=1800, things={"1900 or later": [1900, 2026]}),
        Offer(attempt=lambda text: publication(licence=text), wrong="x y", things=["CC-BY-4.0"]),
        Offer(attempt=lambda text: publication(doi=text), wrong="x", things=["10.5281/zenodo.1234567"]),
        Offer(
            attempt=lambda text: publication(related=(text,)),
            wrong="x",
            things={"10.1000/182": "10.1000/182", "https://": "https://example.org"},
        ),
    ],
    "lab.rig.aligning:parse_step": lambda _: [
        # The words up, ok and quit are read before the steps.
        Offer(attempt=lambda line: parse_step(line.split()), wrong="5", things={"x, y or z": ["x 1", "y -0.2", "z 1"]})
    ],
    "lab.rig.colours:channels_fault": lambda _: [Offer(attempt=stated_channels, wrong="xyz")],
    "lab.rig.drivers:find_driver": lambda _: [
        Offer(attempt=partial(find_driver, kind), wrong="xyz") for kind in registry.GROUPS
    ],
    "lab.rig.drivers:_serial.open": lambda _: [
        Offer(attempt=partial(options_of, driver), wrong="xyz", later="/dev/none|must be")
        for driver in ("grbl", "marlin", "arduino")
    ],
    "extensions.devices.klipper:KlipperStage.__init__": lambda _: [
        Offer(attempt=klipper, wrong="x", things={"http://printer.local:7125": "http://127.0.0.1:1"})
    ],
    "lab.rig.loadcell:LoadCellOptions.__post_init__ 2": lambda _: [
        Offer(attempt=lambda column: LoadCellOptions(columns=3, column=column), wrong=4),
        Offer(
            attempt=lambda column: LoadCellOptions(columns=3, column=2, temperature_column=column),
            wrong=2,
            things={"from 1 to 3": [1, 3], "0 for none": 0},
        ),
    ],
    "lab.rig.plugin:load 2": lambda _: [
        Offer(attempt=plugin.load, wrong="a b:c", things={"my_arm:Arm": "helpers.wrong_drivers:GoodStage"}),
        Offer(attempt=lambda name: plugin.load(f"helpers.small_study:{name}"), wrong="qqqqqqq"),
    ],
    "lab.rig.ports:resolve": lambda _: [
        Offer(
            attempt=lambda port: resolve(port, "stage"),
            wrong="",
            things={"a path": "/dev/none", "a name": "usb-none", "socket://host:port": "socket://host:1"},
        )
    ],
    "lab.rig.samples:require_stuck_samples": lambda _: [
        Offer(attempt=require_stuck_samples, wrong=1, things={"at least 2": 2, "0 to switch": 0})
    ],
    "extensions.exchange.exporting.export_formats:export_runs": lambda _: [
        Offer(attempt=lambda word: export_runs_to([Path("none")], word, Path("out")), wrong="xyz", later="none")
    ],
    "extensions.exchange.exporting.tactile_data:Processing.__post_init__": lambda _: [
        Offer(
            attempt=lambda size: Processing(size=size),
            wrong=(0, 1),
            things={"1x1": (1, 1), "10000x10000": (10_000, 10_000)},
        )
    ],
    "lab.runs.importing.array_files:array_name": lambda _: [
        Offer(attempt=lambda name: array_name(Path("a.npz"), {"one": (3, 4), "two": (2, 2)}, name), wrong="xyz")
    ],
    "extensions.exchange.importing.authors:_options_of 3": lambda _: [
        Offer(attempt=lambda axis: authors_options({"first-axis": axis}), wrong="z"),
        Offer(attempt=lambda word: authors_options({word: "1"}), wrong="30", things=["P30"]),
        Offer(attempt=lambda level: authors_options({"P30": str(level)}), wrong=0),
    ],
    "lab.runs.importing.import_formats:_Formats.__init__": lambda _: [
        Offer(attempt=lambda word: _Formats(word), wrong="xyz"),
    ],
    "lab.runs.importing.import_options:ImportOptions.__post_init__": lambda _: [
        Offer(attempt=lambda word: ImportOptions(channels=word), wrong="xyz"),
    ],
    "lab.runs.importing.sources:columns_of_fields": lambda _: [
        Offer(attempt=lambda column: columns_of_fields("table.csv", ["one", "two"], {"label": column}), wrong="xyz")
    ],
    "lab.runs.importing.sources:field_of": lambda _: [Offer(attempt=field_of, wrong="xyzxyz")],
    "lab.runs.schema:_parser": lambda _: [_literal(kind) for kind in (schema.When, schema.PoseFrom, schema.Reason)],
    "lab.runs.schema:_flag": lambda _: [
        Offer(
            attempt=lambda text: schema._parser(bool | None, 1)("in_band", text),
            wrong="maybe",
            things={"true": "true", "false": "false", "empty": ""},
        )
    ],
    "lab.runs.schema:_time 2": lambda _: [
        Offer(attempt=lambda text: schema._time("time", text), wrong=wrong, things=["2026-01-31T12:00:00.000Z"])
        for wrong in ("x", "2026-01-31T12:00:00")
    ],
    "lab.simulate.appearances:look_named": lambda _: [Offer(attempt=look_named, wrong="xyz", things=list(LOOKS))],
    "lab.simulate.study:study_of": lambda folder: [
        Offer(
            attempt=study_of,
            wrong="xyz",
            things={"paper": "paper", "quick": "quick", "a TOML file": str(study_file(folder))},
        )
    ],
    "lab.simulate.tactip:TacTip.__init__": lambda _: [Offer(attempt=lambda value: TacTip(flicker=value), wrong=2.0)],
    "lab.study.file:virtual_study": lambda _: [Offer(attempt=lambda word: virtual_study(driver=word), wrong="xyz")],
    "lab.study.file:_protocol": lambda _: [Offer(attempt=lambda word: _protocol({"grid": word}, 1.0), wrong="xyz")],
    "lab.study.spec:_Device.require_driver": lambda _: [
        Offer(attempt=partial(kind.require_driver, "driver"), wrong="xyz")
        for kind in (StageSettings, GaugeSettings, SensorSettings)
    ],
    "lab.study.spec:Protocol.__post_init__": lambda _: [
        Offer(
            attempt=lambda count: replace(small_protocol(), bands_n=(0.001,) * count), wrong=5, things={"2 numbers": 2}
        )
    ],
    "lab.study.spec:Study.__post_init__": lambda _: [Offer(attempt=levels, wrong=9)],
    "extensions.markers.markers:MarkerSettings.__post_init__": lambda _: [
        Offer(attempt=lambda value: MarkerSettings(sigma_px=value), wrong=99.0)
    ],
    "lab.runs.region:parse_region": lambda folder: [
        Offer(
            attempt=lambda text: parse_region(text, 64, 64),
            wrong="xyz",
            things={
                "circle:X,Y,R": "circle:32,32,20",
                "rect:X0,Y0,X1,Y1": "rect:5,5,50,50",
                "a PNG file": str(mask_file(folder)),
            },
        )
    ],
    "extensions.virtual_rig.drivers:_speed": lambda _: [Offer(attempt=launched, wrong=0.0)],
    "extensions.virtual_rig.setup:Setup.board": lambda _: [
        Offer(attempt=past(partial(board, kind)), wrong="xyz", later="must be")
        for kind in ("grbl", "grblhal", "marlin", "arduino")
    ],
}
