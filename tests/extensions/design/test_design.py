"""The design page without a browser: its states, pictures, controls, texture files and messages."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest
from helpers.millimetres import KNOWN

pytest.importorskip("starlette", reason="the design page needs the extra web")
pytest.importorskip("httpx2", reason="the test client of Starlette needs httpx2")

from starlette.applications import Starlette
from starlette.testclient import TestClient
from trimesh import load

from tacbench_cad.checks.check import check
from tacbench_cad.extensions.design.app import MAX_TEXT, DesignPage, question_of
from tacbench_cad.extensions.design.document import STARTS, controls, first_state, opened, start, toml
from tacbench_cad.extensions.design.model import CUT_POINTS, Design, facts, picture
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import catalogue
from tacbench_cad.spec.texture_files import read_texture
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats


def unpacked(data: bytes) -> tuple[dict[str, Any], list[Floats]]:
    """Return the header of a picture, and the heights of both tops (y, x) and of both cuts."""
    (length,) = struct.unpack_from("<I", data)
    header = json.loads(data[4 : 4 + length])
    numbers = np.frombuffer(data, "<f4", offset=4 + length).astype(np.float64)
    n, m = header["lines"]
    tops, cuts = numbers[: 2 * n * m].reshape(2, m, n), numbers[2 * n * m :].reshape(2, CUT_POINTS)
    return header, [*tops, *cuts]


@pytest.mark.parametrize("number", range(1, 7))
def test_the_first_six_are_those_of_the_catalogue(number: int) -> None:
    assert start(f"texture {number}").formula.surface == catalogue()[number - 1].surface
    assert first_state(str(number)) == (start(f"texture {number}"), f"texture {number}")


def test_a_picture_has_the_heights_of_the_block() -> None:
    design = replace(start("texture 4"), shift=(0.3, 0.0), cut="y", cut_at=0.25)
    header, (formula, printed, cut, printed_cut) = unpacked(picture(design))
    block = design.block
    x, y = (np.linspace(0.0, side, count) for side, count in zip(block.size_mm, header["lines"], strict=True))
    assert formula.max() == pytest.approx(7.0, abs=1e-5)
    # The datum of a picture follows from the highest point of its grid, which is lower than the peak of the formula.
    assert np.abs(formula - block.height_at(x[None, :], y[:, None])).max() < 0.06
    points = np.linspace(0.0, block.size_mm[1], CUT_POINTS)
    assert np.abs(cut - block.height_at(0.25 * block.size_mm[0], points)).max() < 0.06
    wide = [w for w in block.surface.waves if 2.0 * np.pi / np.hypot(w.f, w.g) >= 0.8]  # type: ignore[attr-defined]
    assert len(wide) == 11
    lost = sum(w.amplitude for w in block.surface.waves if w not in wide)  # type: ignore[attr-defined]
    assert 0.05 < np.abs(cut - printed_cut).max() <= lost
    assert 0.05 < np.abs(formula - printed).max() <= lost


@pytest.mark.parametrize("outline", ["disc", "hexagon", "ring"])
def test_a_block_of_another_outline_ends_there(outline: str, tmp_path: Path) -> None:
    design = replace(start("texture 2"), outline=outline, shift=(0.2, 0.0))
    block, (header, (formula, _, cut, _)) = design.block, unpacked(picture(design))
    assert block.outline is not None and header["size"] == list(block.size_mm)
    cell = block.size_mm[0] / header["lines"][0] * block.size_mm[1] / header["lines"][1]
    assert np.count_nonzero(formula) * cell == pytest.approx(block.outline.area_mm2, rel=0.03)
    assert (np.count_nonzero(cut) < CUT_POINTS - 20) == (outline == "ring")
    assert opened(toml(design), "mine.toml").block.outline == block.outline


def test_facts_are_those_of_the_block() -> None:
    rows = dict(facts(start("texture 4")))
    assert rows["relief"] == "4.71789 mm"
    assert rows["printable by a nozzle of 0.4 mm"].startswith("11 of 26 waves, ")
    assert rows["largest distance from the formula"].endswith("proved")
    with pytest.raises(InputError, match="use a height of at least 8"):
        facts(replace(start("texture 4"), unit_mm=1.6))


@pytest.mark.parametrize("name", [*list(STARTS)[:8], "dunes"])
def test_the_texture_file_gives_the_same_block(name: str, tmp_path: Path) -> None:
    design = replace(start(name), name="mine", unit_mm=0.7, shift=(0.5, -1.0), size_mm=(20.0, 17.3), height_mm=9.0)
    path = tmp_path / "mine.toml"
    path.write_text(toml(design), encoding="utf-8")
    file = read_texture(path)
    x, y = np.linspace(0.0, 20.0, 30), np.linspace(0.0, 17.3, 20)
    read = replace(design.block, texture=file)
    assert read.height_at(x[:, None], y) == pytest.approx(design.block.height_at(x[:, None], y), abs=1e-9)
    again = opened(path.read_text(encoding="utf-8"), "mine.toml")
    assert toml(again) == toml(design)


def test_every_number_of_a_state_has_a_control_with_its_value() -> None:
    for name in STARTS:
        design = replace(start(name), unit_mm=50.0)
        rows = [row for group in controls(design) for row in group["rows"]]
        values = {tuple(row["path"]): row for row in rows}
        assert len(values) == len(rows)
        assert len({row["label"] for group in controls(design) for row in group["rows"]}) >= 9
        assert values["unit_mm",]["high"] == 50.0
        for (first, *rest), row in values.items():
            inner: Any = getattr(design, str(first))
            for step in rest:
                inner = inner[step]
            assert row["value"] == inner
    assert first_state("z13")[1] == "dunes"
    with pytest.raises(InputError, match=r'did you mean "texture-4"\?; a number from 1 to 6 and a TOML file are also'):
        first_state("texture-44")


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("{}", "do: is missing"),
        ("[", "is not valid JSON"),
        ('{"do": NaN}', "is not valid JSON"),
        ('{"do": "shell"}', "do = 'shell'"),
        ('{"do": "picture", "design": {"texture": {}, "size_mm": [0, 1]}}', "must be at least 0.5"),
        ('{"do": "picture", "design": {"texture": {}, "folder": "/etc"}}', "folder: "),
        ('{"do": "picture", "design": {"texture": {}, "out": "/etc"}}', "unknown key"),
        ('{"do": "write", "formats": "stl"}', "must be a list"),
        ("[" * 50_000, "nested deeper|not valid JSON"),
        ('"' + "x" * MAX_TEXT + '"', "at most 1,000,000 bytes"),
    ],
)
def test_a_bad_message_is_refused_in_one_line(text: str, allowed: str) -> None:
    with pytest.raises(InputError, match=allowed):
        question_of(text.encode())


@pytest.mark.parametrize("file", ["x\0.png", "/etc/passwd", "../secret.png", "a/../../secret.csv"])
def test_files_outside_of_the_folder_are_not_read(file: str, tmp_path: Path) -> None:
    for table in ({"family": "image", "file": file}, {"family": "sum", "of": [f"{file}.toml"]}):
        design = Design(texture=table, folder=tmp_path)
        with pytest.raises(InputError, match="must be in the folder of the texture file"):
            picture(design)
    with pytest.raises(InputError, match=r'start the command with it, "tacbench design scan\.toml"'):
        opened('[texture]\nname = "scan"\nfamily = "image"\nfile = "scan.png"\n', "scan.toml")


class Page:
    """A page that asks the server."""

    def __init__(self, client: TestClient) -> None:
        self.client = client

    def post(self, path: str, data: bytes) -> Any:
        answer = self.client.post(path, content=data)
        assert answer.status_code == 200
        return answer.json() if answer.headers.get("content-type") == "application/json" else answer.content

    def ask(self, **question: Any) -> Any:
        return self.post("/ask", json.dumps(question).encode())

    def upload(self, name: str, content: bytes) -> Any:
        return self.post(f"/upload?{urlencode({'name': name})}", content)


@pytest.fixture
def page(tmp_path: Path) -> Any:
    (tmp_path / "uploads").mkdir()
    first, name = first_state("2")
    routes = DesignPage(tmp_path / "out", tmp_path / "uploads", first, name).routes
    with TestClient(Starlette(routes=routes)) as client:
        yield Page(client)


def test_names_of_uploads_cannot_leave_their_folder(page: Page, tmp_path: Path) -> None:
    for name, kept in (("scan 1.csv", "scan_1.csv"), ("../../é.csv", "_.._é.csv".replace("é", "_"))):
        state = page.upload(name, lines(np.tile(np.linspace(0.0, 1.0, 41), (31, 1))))["design"]
        assert (tmp_path / "uploads" / state["upload"] / kept).is_file()
    for name in ("", "run.sh", "x.png.exe", ".png"):
        assert "must end in" in page.upload(name, b"content")["error"]


def test_the_page_gets_states_pictures_facts_and_errors(page: Page) -> None:
    hello = page.ask(do="hello")
    assert hello["start"] == "texture 2" and "dunes" in hello["starts"]
    design = page.ask(do="start", text="three waves")["design"]
    assert len(page.ask(do="waves", design=design, count=5)["design"]["wave"]) == 5
    assert unpacked(page.ask(do="picture", design=design))[0]["range"][1] == 7.0
    assert dict(page.ask(do="facts", design=design))["facts"][1] == ["relief", "2.25 mm"]
    assert "is missing" in page.ask(do="picture")["error"]
    even = design | {"wave": [], "texture": {"family": "series", "law": "square", "N": 4}}
    assert "must be odd" in page.ask(do="picture", design=even)["error"]
    assert "a-z" in page.ask(do="toml", design=design | {"name": "../x"})["error"]
    assert "not valid JSON" in page.post("/ask", b"nonsense")["error"]
    for file in ("x\0.png", "a" * 5000, ".", ""):
        assert page.ask(do="picture", design=design | {"texture": {"family": "image", "file": file}, "wave": []})[
            "error"
        ]
    assert page.ask(do="hello")["start"] == "texture 2", "the server works after errors"


@pytest.mark.usefixtures("no_preview")
def test_files_are_written_into_the_folder_of_the_command(page: Page, tmp_path: Path) -> None:
    design = page.ask(do="start", text="texture 2")["design"] | {"name": "waves"}
    answer = page.ask(do="write", design=design, formats=["stl"])
    assert answer == {"files": ["waves_paper_x1.stl", "waves.toml"], "failed": []}
    assert check(tmp_path / "out" / answer["files"][0]).ok
    assert read_texture(tmp_path / "out" / "waves.toml").surface == catalogue()[1].surface
    refused = page.ask(do="write", design=design, formats=["exe"])
    assert "formats = 'exe'" in refused["error"]


@pytest.mark.usefixtures("no_preview")
def test_a_height_map_becomes_a_block(page: Page, tmp_path: Path) -> None:
    values = np.sin(np.linspace(0.0, 9.0, 61))[:, None] + np.linspace(0.0, 0.5, 41)
    np.save(tmp_path / "map.npy", values)
    answer = page.upload("map.npy", (tmp_path / "map.npy").read_bytes())
    design = answer["design"]
    assert design["size_mm"] == pytest.approx([20.0, 30.0])
    assert design["texture"] == {"family": "image", "file": "map.npy", "mm_per_pixel": 0.5, "smooth_mm": 0.0}
    header, (top, *_) = unpacked(page.ask(do="picture", design=design))
    assert (header["lines"], float(np.ptp(top))) == ([171, 256], pytest.approx(float(np.ptp(values)), abs=1e-2))
    answer = page.ask(do="write", design=design | {"tolerance_mm": 0.1}, formats=["stl"])
    assert answer["files"][1:] == ["my-texture.toml", "map.npy"]
    assert read_texture(tmp_path / "out" / "my-texture.toml").block.size_mm == pytest.approx((20.0, 30.0))
    assert "height map" in page.upload("bad.png", b"no picture")["error"]


def lines(values: Floats) -> bytes:
    """Return heights (rows, columns) in mm as a CSV file."""
    return "\n".join(",".join(f"{value:.6g}" for value in row) for row in values).encode()


def shown(page: Page, design: Any) -> float:
    """Return the relief of the picture of a state, in mm."""
    return float(np.ptp(unpacked(page.ask(do="picture", design=design))[1][0]))


@pytest.mark.usefixtures("no_preview")
def test_every_tab_keeps_its_own_height_map(page: Page, tmp_path: Path) -> None:
    """Both files have the same name; the relief, 1 mm or 3 mm, says which one is shown and written."""
    ramp = np.tile(np.linspace(0.0, 1.0, 41), (31, 1))
    other = Page(page.client)
    first = page.upload("map.csv", lines(ramp))["design"]
    second = other.upload("map.csv", lines(3.0 * ramp))["design"]
    assert shown(page, first) == pytest.approx(1.0, abs=0.02)
    assert shown(other, second) == pytest.approx(3.0, abs=0.02)
    assert dict(page.ask(do="facts", design=first)["facts"])["relief"].startswith("1 mm")
    third = page.upload("map.csv", lines(2.0 * ramp))["design"]
    assert shown(page, first) == pytest.approx(1.0, abs=0.02), "a state that came before the next upload"
    assert shown(page, third) == pytest.approx(2.0, abs=0.02)
    made = {"do": "write", "formats": ["stl"]}
    answer = page.ask(**made, design=first | {"tolerance_mm": 0.1, "name": "mm1"})
    assert answer["files"][1:] == ["mm1.toml", "map.csv"]
    heights = load(tmp_path / "out" / answer["files"][0]).vertices[:, 2]
    assert heights.max() - heights[heights > 1.0].min() == pytest.approx(1.0, abs=0.11)
    answer = other.ask(**made, design=second | {"tolerance_mm": 0.1, "name": "mm3"})
    assert "already has another content" in answer["error"], "mm1.toml needs its own map.csv"
    assert (tmp_path / "out" / "map.csv").read_bytes() == lines(ramp)
    assert not list((tmp_path / "out").glob("mm3*"))
    assert "is unknown" in other.ask(do="facts", design=second | {"upload": "../out"})["error"]


@pytest.mark.parametrize("name", KNOWN)
def test_the_page_keeps_the_millimetres_of_a_file(name: str, tmp_path: Path) -> None:
    """The block of an opened file, and that of the file which the page writes, agree with a formula in mm."""
    path, pattern = KNOWN[name].write(tmp_path), KNOWN[name].pattern
    design = opened(path.read_text(encoding="utf-8"), path.name, tmp_path)
    path.write_text(toml(design), encoding="utf-8")
    x, y = np.random.default_rng(0).uniform(0.0, 9.0, (2, 500))
    for block in (design.block, Block.of(path)):
        assert np.ptp(block.height_at(x, y) - pattern(x, y)) < 3e-5
    assert np.ptp(design.surface(x, y) - pattern(x, y)) < 3e-5
    assert "_mm" not in design.block.name
