"""Test the report: a single page with its files next to it and nothing from elsewhere."""

from __future__ import annotations

import base64
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from helpers.studies import GRID, noise_image, texture_image, write_study
from PIL import Image

pytest.importorskip("cv2")
threadpoolctl = pytest.importorskip("threadpoolctl")

from tacbench_cad import __version__, lab
from tacbench_cad.cli import report as command
from tacbench_cad.lab.analysis.classification.classification import Classification
from tacbench_cad.lab.analysis.report.facts import forces_in_words
from tacbench_cad.lab.analysis.report.page import narrow, readable, write_files
from tacbench_cad.lab.analysis.report.report_figures import draw_frames
from tacbench_cad.lab.analysis.report.results import ReportSection, Results
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.tables import Shown
from tacbench_cad.lab.runs.checking import Finding, RunReport
from tacbench_cad.lab.runs.press_table import read_frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes

VOID = {"meta", "img", "link", "br", "hr", "input"}


class Page(HTMLParser):
    """The contents of a page; raises an error if the page is not well formed."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"{tag} closes {self.open[-1:]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.texts.append(data)

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())


@pytest.fixture(scope="module", autouse=True)
def quick(few_trees: None) -> Iterator[None]:
    """Use one thread."""
    with threadpoolctl.threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "runs"
    write_study(folder, simulated="a <formula> & noise")
    return folder


@pytest.fixture(scope="module")
def report(runs: Path) -> Path:
    """Return a complete report with a classification."""
    out = runs.parent / "report.html"
    files = lab.report(lab.read(runs), out)
    assert files[0] == out and all(path.is_file() for path in files)
    return out


@pytest.fixture(scope="module")
def page(report: Path) -> Page:
    return Page(report.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def document(report: Path) -> dict[str, Any]:
    """Return the document of the report."""
    parsed: dict[str, Any] = json.loads((report.parent / "report_files" / "report.json").read_text(encoding="utf-8"))
    return parsed


def test_the_page_loads_nothing_from_elsewhere(report: Path, page: Page) -> None:
    assert not {"script", "link", "iframe", "object", "video", "audio"} & {tag for tag, _ in page.tags}
    for tag, attributes in page.tags:
        for name, value in attributes.items():
            if name in ("href", "src", "srcset", "action", "data", "poster", "background"):
                assert value.startswith(("#", "data:image/png;base64,")), (tag, name, value[:60])
    text = re.sub(r'src="data:[^"]*"', "", report.read_text(encoding="utf-8"))
    assert not re.search(r"https?:|url\(|@import|//", text.replace("</", ""))


def test_the_answers_come_first_and_everything_else_is_folded(page: Page) -> None:
    tags = [tag for tag, _ in page.tags]
    first = tags[: tags.index("details")]
    assert (first.count("h1"), first.count("dd"), first.count("figure"), first.count("table")) == (1, 5, 2, 1)
    assert set(tags[tags.index("details") :]) & {"table", "figure"}
    folded = page.all("details")
    assert all("open" not in attributes for attributes in folded)
    assert [attributes["id"] for attributes in folded] == [
        *("steps", "design", "quality", "variance", "published", "maps", "classification", "methods", "prints")
    ]


def numbers(text: str) -> list[str]:
    """Return every number in a text as it is written."""
    return re.findall(r"(?<![\w.-])\d[\d,]*(?:\.\d+)?", text)


def test_the_numbers_before_the_fold_are_those_of_the_tables(report: Path, document: dict[str, Any]) -> None:
    text = report.read_text(encoding="utf-8")
    top = Page(f"<body>{text[text.index('<h1>') : text.index('<section>')]}</body>")
    values = {key: document[key] for key in ("title", "notice", "summary", "figures")}
    assert len(numbers(top.text)) > 20
    assert set(numbers(top.text)) <= set(numbers(json.dumps(values, ensure_ascii=False)))
    # Numbers that are rounded on the page have all digits in the files.
    files = report.with_name("report_files")
    rows = pd.read_csv(files / "textures.csv")
    assert rows["texture"].tolist() == ["texture-1"] * 2 + ["texture-2"] * 2
    assert set(rows["hold_out"]) == {"copy"} and rows["simulated"].all()
    cells = pd.read_csv(files / "variance" / "variance.csv").set_index(["printer", "texture"])
    answers = {answer["about"]: answer for answer in document["classifications"][0]["texture_answers"]}
    for row, record in zip(rows.to_dict("records"), document["textures"], strict=True):
        cell, answer = cells.loc[(row["printer"], row["texture"])], answers[row["texture"]]
        for name in ("variance", "low", "high", "noise_alone", "prints"):
            assert row[name] == record[name] == cell[name].iloc[0]
        for name, of_answer in {"recall": "figure", "recall_low": "low", "recall_high": "high"}.items():
            assert row[name] == record[name] == pytest.approx(answer[of_answer] / 100.0)
        assert f">{row['variance']:.3g}<" in text


def test_every_picture_equals_its_file_and_has_an_alternative_text(report: Path, page: Page) -> None:
    files = report.with_name("report_files")
    there = {path.read_bytes() for path in files.rglob("*.png")}
    images = page.all("img")
    assert len(images) >= 7 and len(there) == len(images)
    for picture in images:
        assert base64.b64decode(picture["src"].split(",", 1)[1]) in there
        assert len(picture["alt"]) > 20 and int(picture["width"]) > 100
    for path in files.rglob("*.png"):
        assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")


def test_every_file_named_on_the_page_exists(report: Path, page: Page) -> None:
    named = set(re.findall(r"report_files/[\w./-]+\.(?:csv|png|pdf)", page.text))
    assert len(named) > 20
    assert all((report.parent / name).is_file() for name in named)


def test_simulated_data_are_marked_once_at_the_top_and_in_each_file(report: Path, page: Page) -> None:
    assert page.text.count("Simulated data, not from a real sensor: sensor: a <formula> & noise.") == 1
    described = next(meta for meta in page.all("meta") if meta.get("name") == "description")
    assert described["content"] == "simulated data: sensor: a <formula> & noise"
    for path in report.with_name("report_files").rglob("*.csv"):
        lines = path.read_text(encoding="utf-8").splitlines()
        assert lines[0].endswith(",simulated") and all(line.endswith(",true") for line in lines[1:]), path
    for path in report.with_name("report_files").rglob("*.png"):
        with Image.open(path) as image:
            assert image.info["Description"] == "simulated data: sensor: a <formula> & noise"


def test_the_page_has_the_main_facts(page: Page) -> None:
    for words in (
        "64 presses on 8 prints",
        "2 prints of 2 textures on ender-3 in pla-plus",
        "The fields of 8 print records",
        "filament_batch",
        "64 of 64 planned presses are present",
        "with 95 % intervals over prints",
        "protocol leak-free, in %; chance is 50.0",
        "random forest (maximum depth 50)",
        "ddof = 0",
        f"tacbench-cad, version {__version__}",
        "@misc{tacbench_cad",
    ):
        assert words in page.text, words


@pytest.mark.usefixtures("no_figures")
def test_an_earlier_classification_is_shown_or_none(runs: Path, report: Path, tmp_path: Path) -> None:
    earlier = report.with_name("report_files") / "classification"
    words, stale = (
        [str(runs), "-o", str(tmp_path / "again.html")],
        tmp_path / "again_files" / "classification" / "old.png",
    )
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"a figure of an earlier report")
    answer = CliRunner().invoke(command.command, [*words, "--classify", str(earlier), "--json"])
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert (document["report"], document["folder"]) == (str(tmp_path / "again.html"), "again_files")
    again = Page((tmp_path / "again.html").read_text(encoding="utf-8"))
    before = Page(report.read_text(encoding="utf-8"))
    assert again.text == before.text.replace("report_files/", "again_files/")
    assert not stale.exists() and not stale.with_name("trials").exists()
    plain = CliRunner().invoke(command.command, [*words, "--no-classify"])
    assert "files in again_files" in plain.stdout
    short = Page((tmp_path / "again.html").read_text(encoding="utf-8")).text
    assert "What the sensor can tell apart" not in short and "Nothing was classified." in short
    both = CliRunner().invoke(command.command, [*words, "--no-classify", "--classify", str(earlier)])
    assert "cannot be combined with --classify" in str(both.exception)


def test_classifications_of_other_runs_and_damaged_files_are_refused(report: Path, tmp_path: Path) -> None:
    write_study(tmp_path / "runs", image=noise_image, copies=3)
    earlier = report.with_name("report_files") / "classification"
    with pytest.raises(InputError, match=r"classify = .* must be a classification of all presses of these runs"):
        Classification.open(earlier, Design.of(lab.read(tmp_path / "runs")))
    damaged = Path(shutil.copytree(earlier, tmp_path / "damaged"))
    for content in ("estimator,trial\nforest,1\n", "", 'estimator\n"forest'):
        (damaged / "predictions.csv").write_text(content)
        with pytest.raises(InputError, match=r"predictions\.csv.*classify again"):
            Classification.open(damaged)


@pytest.mark.usefixtures("no_figures")
def test_a_study_with_too_few_data_gets_a_page_with_reasons(tmp_path: Path) -> None:
    """One texture, one copy and one repeat for each position allow neither a variance nor a classification."""

    def dull(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Bytes:
        return np.full((24, 32), 7, dtype=np.uint8)

    write_study(tmp_path / "runs", textures=[1], copies=1, prints=[("ender-3", "petg")], image=dull, still=0)
    lab.report(lab.read(tmp_path / "runs"), tmp_path / "page.html")
    text = Page((tmp_path / "page.html").read_text(encoding="utf-8")).text
    assert "These data have no classification: " in text
    assert "Findings, at most 5 for each run" in text and "dark" in text
    assert "Simulated" not in text and "simulated data" not in text
    assert "ender-3 petg: cannot be said: there is only one print of each texture" in text
    assert "Look at the problems of texture-1_" in text, "what to do next"


@pytest.mark.usefixtures("no_figures")
def test_damaged_files_are_reported_and_the_rest_is_analysed(tmp_path: Path) -> None:
    folders = write_study(tmp_path / "runs", image=texture_image, grid=GRID)
    picture = folders[0] / "sensor_images" / "image_3.png"
    picture.write_bytes(picture.read_bytes()[:40])
    (folders[1] / "print.toml").write_text("nozzle = ")
    lab.report(lab.read(tmp_path / "runs"), tmp_path / "page.html")
    text = Page((tmp_path / "page.html").read_text(encoding="utf-8")).text
    assert "image_3.png" in text.split("Data quality")[-1]
    assert "the check found" in text and "1 unreadable" in text
    assert "1 frame could not be used and was left out" in text
    assert "These data have no classification: " in text
    assert "Print records that cannot be read:" in text and f"{folders[1].name}/print.toml" in text
    assert (tmp_path / "page_files" / "variance" / "variance.csv").is_file()


@pytest.mark.usefixtures("no_figures")
def test_images_that_were_not_imported_get_a_page(tmp_path: Path) -> None:
    for label, level in (("cork", 40), ("felt", 90)):
        (tmp_path / "photographs" / label).mkdir(parents=True)
        for number in range(8):
            image = np.random.default_rng([level, number]).integers(level, level + 40, (12, 16), dtype=np.uint8)
            Image.fromarray(image).save(tmp_path / "photographs" / label / f"{number}.png")
    lab.report(lab.read(tmp_path / "photographs"), tmp_path / "page.html")
    text = Page((tmp_path / "page.html").read_text(encoding="utf-8")).text
    assert "16 samples of 2 labels" in text and "random split, may leak" in text
    assert "16 samples were imported from a folder of images, with 2 labels" in text


def test_a_page_must_be_html(runs: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must end in \.html"):
        lab.report(lab.read(runs), tmp_path / "report.txt")


def test_the_sheet_shows_a_good_frame_of_each_texture_and_lists_textures_without(tmp_path: Path) -> None:
    folders = write_study(tmp_path / "runs", prints=[("ender-3", "petg")], textures=(1, 2, 3), copies=1, still=0)
    for folder in folders:
        for number in range(1, 9) if "texture-3" in folder.name else [1] if "texture-1" in folder.name else []:
            (folder / "sensor_images" / f"image_{number}.png").write_bytes(b"")
    findings = (Finding(kind="blurred", where="sensor_images/image_1.png", text=""),)
    report = RunReport(folder=folders[1], name="", simulated=(), planned=8, findings=findings)
    design, drawn = Design.of(lab.read(tmp_path / "runs")), list[tuple[str, Any]]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("matplotlib.axes.Axes.set_title", lambda axes, name, **_: drawn.append((name, axes.images[0])))
        caption = draw_frames(Results(design=design, reports=(report,)), tmp_path)
    assert caption.endswith("if there is one. No frame of texture-3 can be read.")
    assert [name for name, _ in drawn] == ["texture-1", "texture-2"]
    for (_, image), folder in zip(drawn, folders, strict=False):
        assert np.array_equal(image.get_array(), read_frame(folder / "sensor_images" / "image_2.png"))
    assert (tmp_path / "frames.pdf").is_file()


def test_sections_of_others_are_shown_and_escaped(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", textures=(1,), prints=(("ender-3", "pla-plus"),), copies=1)
    results = Results(design=Design.of(lab.read(tmp_path / "runs")))
    table = pd.DataFrame({"<h>": ["<script>alert(1)</script>"] * 60, "n": [1234] * 60})
    section = ReportSection(title="<t>", parts=["<p>", ["<l>"], Shown("a < b", table)], tables={"own.csv": table})
    vars(results)["added"] = {"own": section}
    text = write_files(results, tmp_path / "files")
    assert "<script>" not in text and "a &lt; b (the first 50 of 60)" in text and "<li>&lt;l&gt;</li>" in text
    assert text.count('<td class="n">1,234</td>') == 50 and '<th scope="col">&lt;h&gt;</th>' in text
    assert (tmp_path / "files" / "own.csv").is_file() and "files/own.csv" in Page(text).text


def test_depth_mode_is_not_comparable_with_forces(runs: Path) -> None:
    design = Design.of(lab.read(runs))
    assert "Target forces were 0.08045 ± 0.00195 N" in forces_in_words(design)
    first = design.runs[0]
    info = replace(first.info, protocol=first.info.protocol.changed(contact="depth", touch="sensor"))
    changed = replace(design, runs=(replace(first, info=info), *design.runs[1:]))
    assert "0.35 mm below first contact (detected by a change of the sensor's frames)" in forces_in_words(changed)


def test_tables_fit_on_paper() -> None:
    row = pd.DataFrame({"estimator": ["forest"], **{f"texture_{n}": [float(n)] for n in range(20)}, "empty": [None]})
    pieces = list(narrow(readable("recall", row)))
    assert [len(piece.heads) for piece in pieces] == [9, 9, 5]
    assert all(piece.texts[0][0] == "forest" and piece.title == "recall" for piece in pieces)
    assert [text for piece in pieces for text in piece.texts[0][1:]] == [str(n) for n in range(20)]
    assert pieces[0].heads[1] == "texture 0"
    assert [piece.heads for piece in narrow(Shown("", row[["estimator"]]))] == [["estimator"]]
