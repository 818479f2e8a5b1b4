"""The offers of messages about blocks, parts, files, plates, scans and pages; see :mod:`helpers.offers`."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from helpers.offers import Offer, past, texture_file
from housing import Coupon, Holder, Jig
from tacbench_cad.checks.candidates import Expectation
from tacbench_cad.extensions.design.app import IMAGES, Upload
from tacbench_cad.extensions.design.document import first_state, start
from tacbench_cad.extensions.foreign_meshes import files as foreign_files
from tacbench_cad.extensions.scan.fitting import fit_scan
from tacbench_cad.extensions.scan.limits import limits_of
from tacbench_cad.extensions.scan.reading import read_scan
from tacbench_cad.extensions.scan.roughness import roughness
from tacbench_cad.extensions.scan.simulating import ScanTruth, simulate_foreign
from tacbench_cad.extensions.serving.server import bound_socket
from tacbench_cad.extensions.simulators.folder import export_to_simulators
from tacbench_cad.extensions.slicing.gcode import read_gcode
from tacbench_cad.extensions.slicing.plates import arrange_plates
from tacbench_cad.extensions.slicing.printed_surface import Frame
from tacbench_cad.extensions.slicing.printers import Printer, printer_named, printers
from tacbench_cad.formats import SUFFIXES, format_of
from tacbench_cad.geometry.block_part import as_part, block_part
from tacbench_cad.geometry.textured.field import Fade
from tacbench_cad.geometry.textured.frame import DIRECTIONS, axes_of
from tacbench_cad.geometry.textured.height import height_over
from tacbench_cad.geometry.textured.textured_faces import faces_by, textured_part
from tacbench_cad.geometry.texturing import Texturing, texturing
from tacbench_cad.making.request import Request, _formats, _kinds, blocks_of
from tacbench_cad.making.showing import request_of
from tacbench_cad.render.snapshot import _pieces
from tacbench_cad.render.viewing.page import require_page
from tacbench_cad.spec import families
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.fits import clearance_mm
from tacbench_cad.spec.interpolation import checked_heights, height_map, pixel_steps
from tacbench_cad.spec.label import engrave
from tacbench_cad.spec.outlines import Disc, Polygon, RegularPolygon, Ring, outline_of
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.texture_files import find_texture, texture_of_document
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.plotting import SUFFIXES as PICTURES
from tacbench_cad.util.plotting import picture_format
from tacbench_cad.util.untrusted import read_rows

Rows = Mapping[str, Callable[[Path], Sequence[Offer]]]


def _corners(count: int) -> tuple[tuple[float, float], ...]:
    """Return the corners of a regular polygon of 400 mm."""
    return tuple((200.0 * math.cos(math.tau * i / count), 200.0 * math.sin(math.tau * i / count)) for i in range(count))


def _shape() -> Any:
    """Return a cylinder of 10 mm with a flat top."""
    import build123d as bd

    return bd.Cylinder(5.0, 10.0)


def _shapes() -> dict[str, Any]:
    import cadquery as cq

    shape = _shape()
    return {
        "CadQuery": cq.Workplane().box(1.0, 1.0, 1.0),
        "build123d": shape,
        "kernel shape": shape.wrapped,
        "list of them": (shape, shape),
    }


def _header(folder: Path) -> Callable[[str], object]:
    def attempt(header: str) -> object:
        path = folder / "table.csv"
        path.write_text(f"{header}\n", encoding="utf-8")
        return read_rows(path, "table", ["a", "b"])

    return attempt


def _upload(ending: str) -> Upload:
    name = f"map{ending}".encode()
    return Upload.of(struct.pack("<II", 1, len(name)) + name)


def _family(word: str) -> object:
    return texture_of_document({"texture": {"name": "mine"} | ({"family": word} if word else {})})


def request_words(name: str, word: str) -> object:
    request = Request(textures=(1,), **{name: (word,) if word else ()})
    return {"parts": _kinds, "formats": _formats}[name](request, [])


def _texture_words(folder: Path) -> dict[str, Any]:
    return {"1 to 6": ["1", "6"], "TOML file": str(texture_file(folder))}


def _surfaces() -> dict[str, object]:
    return {
        "WaveSum": WaveSum((Wave(amplitude=1.0, f=1.0, g=0.0),)),
        "SplineSurface": height_map(np.outer(np.arange(5.0), np.arange(5.0))),
    }


def _ridges(depth_mm: float) -> Texturing:
    """Return ridges in mm, whose depth follows from their amplitude."""
    wave = Wave(amplitude=depth_mm / 2.0, f=1.0, g=0.0)
    return texturing(Texture(name="ridges-in-mm", surface=WaveSum((wave,), "mm")))


def _fields(factory: Callable[..., object], wrong: float, later: str, *names: str, **others: Any) -> list[Offer]:
    """Return an offer for the range of each argument of a function."""
    return [
        Offer(attempt=lambda value, name=name: factory(**others, **{name: value}), wrong=wrong, later=later)  # type: ignore[misc]
        for name in names
    ]


ROWS: Rows = {
    "checks.candidates:Expectation.__post_init__": lambda _: [
        Offer(attempt=lambda word: Expectation(preset=word), wrong="xyz")
    ],
    "formats.__init__:format_of": lambda _: [
        Offer(attempt=lambda end: format_of(Path(f"a{end}")), wrong=".xyz", things=list(SUFFIXES))
    ],
    "extensions.simulators.folder:export_to_simulators 2": lambda folder: [
        Offer(attempt=lambda word: export_to_simulators([], [word] if word else [], folder / "out"), wrong=wrong)
        for wrong in ("", "xyz")
    ],
    "geometry.block_part:as_part": lambda _: [
        Offer(
            attempt=as_part,
            wrong=5,
            things={
                "Block": Block.of(1),
                "Holder": Holder(block=Block.of(1)),
                "Jig": Jig(holder=Holder(block=Block.of(1))),
                "Coupon": Coupon(),
                "a Part": block_part(Block.of(1)),
                "method part()": SimpleNamespace(part=lambda: block_part(Block.of(1))),
            },
        )
    ],
    "geometry.textured.frame:axes_of": lambda _: [
        Offer(
            attempt=lambda up: axes_of(np.array([0.48, 0.6, 0.64]), up, "face"),
            wrong="Q",
            things={**{word: word for word in DIRECTIONS}, "a vector": (1.0, 2.0, 0.0)},
        )
    ],
    "geometry.textured.textured_faces:textured_part": lambda _: _fields(
        lambda **values: textured_part(None, [], "1", name="x", **values), 0.0, "face: must be", "mesh_tolerance_mm"
    ),
    "geometry.textured.textured_faces:faces_by": lambda _: [
        Offer(attempt=lambda word: faces_by(_shape().wrapped, word), wrong="%Sphere", things=[">Z", "%Cylinder"])
    ],
    "geometry.textured.height:height_over": lambda _: [
        Offer(attempt=lambda depth: height_over((20.0, 20.0), False, _ridges(depth), Fade(length_mm=0.0)), wrong=0.001)
    ],
    "geometry.texturing:Texturing.__post_init__ 6": lambda _: [
        *_fields(
            lambda **values: texturing("2", **values),
            -1.0,
            "",
            *("depth_mm", "margin_mm", "fade_mm", "base_mm", "tolerance_mm"),
        ),
        Offer(attempt=lambda value: texturing("2", mm_per_unit=(value, 1.0)), wrong=0.0),
    ],
    "making.request:_chosen 2": lambda _: [
        Offer(attempt=partial(request_words, name), wrong=wrong)
        for name in ("parts", "formats")
        for wrong in ("xyz", "")
    ],
    "making.request:blocks_of": lambda _: _fields(
        lambda **values: blocks_of(Request(textures=(1,), **values)), 0, "", "copies"
    ),
    "extensions.foreign_meshes.files:textured_mesh 2": lambda _: [
        *_fields(
            lambda **values: foreign_files.textured_mesh("none.stl", (0, 0, 0), "1", **values), 0.0, "none", "scale"
        ),
        Offer(
            attempt=past(lambda mesh: foreign_files.textured_mesh(mesh, (0.0, 0.0, 0.0), "1")),
            wrong=5,
            things={
                "an STL or 3MF file": ["none.stl", "none.3mf", Path("none.stl")],
                "an object with vertices and faces": SimpleNamespace(vertices=[(0, 0, 0)], faces=[(0, 0, 0)]),
            },
            later="none|mesh",
        ),
    ],
    "extensions.foreign_meshes.files:_read": lambda _: [
        Offer(
            attempt=lambda end: foreign_files._read(Path(f"none.{end.lower()}")),
            wrong="step",
            things=["STL", "3MF"],
            later="none",
        )
    ],
    "extensions.foreign_meshes.files:write_textured_mesh": lambda folder: [
        Offer(
            attempt=past(lambda end: foreign_files.write_textured_mesh(None, folder / f"a{end}")),  # type: ignore[arg-type]
            wrong=".step",
            things=[".stl", ".3mf"],
        )
    ],
    "render.snapshot:_pieces": lambda _: [Offer(attempt=lambda shape: list(_pieces(shape)), wrong=5, things=_shapes())],
    "render.viewing.page:require_page": lambda folder: [
        Offer(attempt=lambda end: require_page(folder / f"a{end}"), wrong=".txt", things=[".html"])
    ],
    "extensions.scan.fitting:fit_scan": lambda _: [
        Offer(attempt=past(lambda word: fit_scan(None, Block.of(1), word)), wrong="xyz")  # type: ignore[arg-type]
    ],
    "extensions.scan.limits:limits_of 2": lambda folder: [
        Offer(attempt=lambda name: limits_of([f"{name}=0.5"]), wrong="xyz"),
        Offer(
            attempt=lambda value: limits_of([f"top_rms_mm={value}"]),
            wrong="x",
            things={"a number": "0.05", "none": "none"},
        ),
    ],
    "extensions.scan.reading:read_scan": lambda _: [
        Offer(attempt=lambda word: read_scan(Path("none.ply"), unit=word), wrong="xyz", later="none.ply")
    ],
    "extensions.scan.roughness:roughness": lambda _: [
        Offer(attempt=past(lambda value: roughness(None, s_filter_mm=value)), wrong=-1.0)  # type: ignore[arg-type]
    ],
    "extensions.scan.simulating:ScanTruth.__post_init__ 6": lambda _: [
        *_fields(ScanTruth, -1.0, "", "noise_mm", "outlier_fraction", "top_fraction", "points"),
        Offer(attempt=lambda word: ScanTruth(noise_direction=word), wrong="xyz"),
        Offer(attempt=lambda word: ScanTruth(walls=(word,)), wrong="xyz"),
    ],
    "extensions.scan.simulating:simulate_foreign": lambda _: [
        Offer(attempt=lambda word: simulate_foreign(word, points=100), wrong="xyz")
    ],
    "extensions.slicing.gcode:read_gcode": lambda _: [
        Offer(attempt=lambda value: read_gcode(Path("none.gcode"), value), wrong=0.0, later="none")
    ],
    "extensions.slicing.plates:arrange_plates 2": lambda _: [
        Offer(attempt=past(lambda value: arrange_plates([], value, printers()["form-3"])), wrong=0),
        Offer(attempt=past(lambda value: arrange_plates([], 1, printers()["form-3"], value)), wrong=-1.0),
    ],
    "extensions.slicing.printers:Printer.__post_init__": lambda _: [
        *_fields(Printer, 1.0, "", "height_mm", name="x", bed_mm=(50.0, 50.0), filaments=("a",)),
        Offer(
            attempt=lambda value: Printer(
                name="x", bed_mm=(value, value), height_mm=10.0, filaments=("a",), margin_mm=0.0
            ),
            wrong=1.0,
        ),
    ],
    "extensions.slicing.printers:printer_named": lambda _: [
        Offer(attempt=lambda word: printer_named(word, printers()), wrong="xyz")
    ],
    "extensions.slicing.printed_surface:Frame.__post_init__": lambda _: [
        Offer(
            attempt=lambda quarters: Frame(x_mm=0.0, y_mm=0.0, quarters=quarters),
            wrong=5,
            things={str(90 * quarters): quarters for quarters in range(4)},
        )
    ],
    "spec.block:Block.of": lambda _: [Offer(attempt=lambda word: Block.of(1, word), wrong="xyz")],
    "spec.block:Block.__post_init__ 4": lambda _: [
        Offer(attempt=lambda word: replace(Block.of(1), preset=word), wrong="xyz"),
        *_fields(lambda **values: Block.of(1, **values), 0.0, "once scaled|base|height", "scale"),
        Offer(
            attempt=lambda value: Block.of(1, mm_per_unit=(value, 1.0, 1.0)), wrong=0.0, later="once scaled|base|height"
        ),
        Offer(attempt=lambda value: replace(Block.of(1), copy=value), wrong=0),
    ],
    "spec.block:Block._check_outline 2": lambda _: [
        Offer(
            attempt=lambda outline: Block.of(1, outline=outline),
            wrong=5,
            things={
                "Disc": Disc(diameter_mm=20.0),
                "RegularPolygon": RegularPolygon(sides=6, diameter_mm=20.0),
                "Polygon": Polygon(points_mm=((0.0, 0.0), (20.0, 0.0), (10.0, 15.0))),
                "Ring": Ring(outer_mm=20.0, inner_mm=8.0),
                "disc:30": "disc:30",
            },
        )
    ],
    "spec.fits:clearance_mm 2": lambda _: [
        Offer(attempt=clearance_mm, wrong="xyz", things=["press", "slip", "loose"]),
        Offer(attempt=clearance_mm, wrong="xyz", things={"a number of mm per side": "0.1"}),
        Offer(attempt=clearance_mm, wrong=99.0),
    ],
    "spec.label:engrave": lambda _: [
        Offer(
            attempt=lambda character: engrave((character,), (30.0, 30.0), 0.0),
            wrong="ä",
            things=["A to Z", "0 to 9", "-", "."],
        )
    ],
    "spec.outlines:Polygon.__post_init__": lambda _: [
        Offer(attempt=lambda count: Polygon(points_mm=_corners(count)), wrong=2)
    ],
    "spec.outlines:outline_of 2": lambda _: [
        Offer(attempt=lambda word: outline_of(word, (20.0, 30.0)), wrong="xyz"),
        Offer(attempt=lambda word: outline_of(word, (20.0, 30.0)), wrong="xyz", things=["polygon:0,0,20,0,10,15"]),
        Offer(attempt=lambda word: outline_of(word, (20.0, 30.0)), wrong="disc:x", things=["disc:30"]),
    ],
    "spec.outlines:_require_length": lambda _: [Offer(attempt=lambda value: Disc(diameter_mm=value), wrong=1e-6)],
    "spec.protocol:PressGrid.paper": lambda _: [Offer(attempt=lambda word: PressGrid.paper(spacing=word), wrong="xyz")],
    "spec.interpolation:checked_heights": lambda _: [
        Offer(
            attempt=lambda heights: checked_heights(np.eye(5), heights),
            wrong=0.0,
            things={"above 0": 1.0, "two heights with the smaller one first": (-1.0, 1.0)},
        )
    ],
    "spec.interpolation:pixel_steps": lambda _: [
        Offer(attempt=pixel_steps, wrong=0.0, things={"1e-6": 1e-6, "1000": 1e3})
    ],
    "spec.textures:Texture.__post_init__": lambda _: [
        Offer(attempt=lambda surface: Texture(name="mine", surface=surface), wrong=5, things=_surfaces())
    ],
    "spec.families:series 3": lambda _: [
        Offer(attempt=lambda word: families.series(word, 3), wrong="xyz"),
        Offer(attempt=lambda word: families.series("square", 3, terms=word), wrong="xyz"),
        Offer(attempt=lambda word: families.series("square", 3, axes=word), wrong="q"),
    ],
    "spec.families:harmonics": lambda _: [Offer(attempt=lambda word: families.harmonics([1.0], word), wrong="q")],
    "spec.families:plane_waves": lambda _: [
        Offer(
            attempt=families.plane_waves,
            wrong=(1.0,),
            things={"(amplitude, f, g)": (1.0, 1.0, 0.0), "(amplitude, f, g, phase)": (1.0, 1.0, 0.0, 0.5)},
        )
    ],
    "spec.texture_files:find_texture": lambda folder: [
        Offer(
            attempt=find_texture,
            wrong=word,
            things={"1 to 6": ["1", "6"], "dunes": "dunes", "a TOML file": str(texture_file(folder))},
        )
        for word in ("all", "later")
    ],
    "spec.texture_files:unknown_texture 2": lambda folder: [
        Offer(attempt=attempt, wrong="xyzxyz", things=things)
        for attempt in (
            find_texture,
            lambda word: first_state(str(word)),
            lambda word: request_of((str(word),), Request(textures=(1,))),
        )
        for things in (None, {"1 to 6": ["1", "6"], "a TOML file": str(texture_file(folder))})
    ],
    "util.convert:_flag": lambda _: [
        Offer(attempt=lambda value: from_plain(bool, value), wrong="yes", things={"true": True, "false": False})
    ],
    "util.convert:_date": lambda _: [
        Offer(attempt=lambda value: from_plain(date, value), wrong="x", things=["2026-01-31"])
    ],
    "util.convert:_refuse_unknown": lambda _: [
        Offer(
            attempt=lambda key: from_plain(Ring, {"outer_mm": 9.0, "inner_mm": 4.0, key: 5.0}),
            wrong="xyz",
            later="ring",
        )
    ],
    "util.convert:_union_hook.structure 2": lambda _: [
        Offer(
            attempt=_family,
            wrong="",
            things=["equation1", "series", "plane-waves", "image", "sum"],
            later="is missing|at least one",
        )
    ],
    "util.untrusted:read_rows 2": lambda folder: [Offer(attempt=_header(folder), wrong="a,x", things=["a,b"])],
    "util.plotting:picture_format": lambda _: [
        Offer(attempt=lambda end: picture_format(Path(f"a{end}")), wrong=".gif", things=list(PICTURES))
    ],
    "extensions.design.app:Upload.of": lambda _: [Offer(attempt=_upload, wrong=".exe", things=list(IMAGES))],
    "extensions.design.document:start": lambda _: [Offer(attempt=start, wrong="xyz")],
    "extensions.serving.server:bound_socket 2": lambda _: [
        Offer(attempt=lambda port: bound_socket(port).close(), wrong=70_000, later="cannot be used"),
        Offer(
            attempt=lambda host: bound_socket(0, host).close(),
            wrong="0.0.0.0",
            things=["192.168.1.20"],
            later="is not an address of this machine",
        ),
    ],
}
