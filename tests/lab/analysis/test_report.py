"""Test the report: a single page with its files next to it and nothing from elsewhere."""

from __future__ import annotations

import base64
import csv
import json
import re
import shutil
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from helpers.studies import GRID, noise_image, texture_image, write_study

pytest.importorskip("cv2")
pytest.importorskip("sklearn")
pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")
threadpoolctl = pytest.importorskip("threadpoolctl")

from tacbench_cad import __version__
from tacbench_cad.cli import report as command
from tacbench_cad.lab.analysis.classification.classify import TRIALS
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.report.page import ReportOptions, copy_files, write_report
from tacbench_cad.lab.analysis.report.parts import table_part
from tacbench_cad.lab.analysis.report.report_figures import draw_frames
from tacbench_cad.lab.analysis.report.report_html import macro, read_image, render_page
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.tables import Shown
from tacbench_cad.lab.runs.checking import Finding, RunReport
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
    """Use one thread, and one trial instead of five."""
    with threadpoolctl.threadpool_limits(1), pytest.MonkeyPatch.context() as patch:
        patch.setitem(TRIALS, "leak-free", 1)
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
    files = write_report([runs], out)
    assert files[0] == out and all(path.is_file() for path in files)
    return out


@pytest.fixture(scope="module")
def page(report: Path) -> Page:
    return Page(report.read_text(encoding="utf-8"))


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


def test_every_number_before_the_fold_is_in_the_document_and_in_the_tables(report: Path, page: Page) -> None:
    text = report.read_text(encoding="utf-8")
    document = json.loads((report.parent / "report_files" / "report.json").read_text(encoding="utf-8"))
    top = Page(f"<body>{text[text.index('<h1>') : text.index('<details')]}</body>")
    values = {key: document[key] for key in ("title", "notice", "summary", "figures", "table")}
    assert len(numbers(top.text)) > 30
    assert set(numbers(top.text)) <= set(numbers(json.dumps(values, ensure_ascii=False)))
    # Numbers that are rounded on the page have all digits in the files.
    with (report.parent / "report_files" / "textures.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    records = document["table"]["records"]
    assert (
        [row["texture"] for row in rows]
        == [record["texture"] for record in records]
        == ["texture-1"] * 2 + ["texture-2"] * 2
    )
    for row, record, shown in zip(rows, records, document["table"]["rows"], strict=True):
        assert row["simulated"] == "true"
        assert (float(row["variance"]), float(row["recall"])) == (record["variance"], record["recall"])
        assert f"{record['variance']:.3g}" in shown and record["hold_out"] == "copy"
    with (report.parent / "report_files" / "variance" / "variance.csv").open(encoding="utf-8", newline="") as stream:
        cells = {(row["texture"], row["printer"]): row for row in csv.DictReader(stream)}
    for record in records:
        cell = cells[record["texture"], record["printer"]]
        assert all(float(cell[name]) == record[name] for name in ("variance", "low", "high", "noise_alone", "prints"))
    answers = {answer["about"]: answer for answer in document["texture_answers"]}
    for record in records:
        answer = answers[record["texture"]]
        assert record["recall"] == pytest.approx(answer["figure"] / 100.0)
        assert record["recall_low"] == pytest.approx(answer["low"] / 100.0)


def test_the_page_depends_only_on_the_document(report: Path) -> None:
    document = json.loads((report.parent / "report_files" / "report.json").read_text(encoding="utf-8"))
    assert render_page(document, report.parent) == report.read_text(encoding="utf-8")


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
    written = {str(path.relative_to(report.parent)) for path in report.with_name("report_files").rglob("*.csv")}
    assert written - named <= {"report_files/classification/predictions.csv"}


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
        "Empty fields of the print records",
        "filament_batch",
        "64 of 64 planned presses are present",
        "with 95 % intervals over prints",
        "protocol leak-free; chance is 50.0 %",
        "random forest (maximum depth 50)",
        "ddof = 0",
        "the study's own grid, 4 positions",
        f"tacbench-cad, version {__version__}",
        "@misc{tacbench_cad",
    ):
        assert words in page.text, words


@pytest.mark.usefixtures("no_figures")
def test_without_classification_and_with_folders_of_the_commands(runs: Path, report: Path, tmp_path: Path) -> None:
    files = report.with_name("report_files")
    out = tmp_path / "again.html"
    words = [str(runs), "-o", str(out), "--variance", str(files / "variance")]
    answer = CliRunner().invoke(command.command, [*words, "--classify", str(files / "classification"), "--json"])
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert document.pop("report") == str(out)
    assert document.pop("files")[0] == str(tmp_path / "again_files" / "report.json")
    assert render_page(document, tmp_path) == out.read_text(encoding="utf-8")
    again = Page(out.read_text(encoding="utf-8"))
    before = Page(report.read_text(encoding="utf-8"))
    assert again.text == before.text.replace("report_files/", "again_files/")
    assert not (tmp_path / "again_files" / "classification" / "trials").exists()
    plain = CliRunner().invoke(command.command, [*words[:2], str(tmp_path / "short.html"), *words[3:], "--no-classify"])
    assert "files in short_files" in plain.stdout
    short = Page((tmp_path / "short.html").read_text(encoding="utf-8")).text
    assert "What the sensor can tell apart" not in short and "Nothing was classified." in short


@pytest.mark.usefixtures("no_figures")
def test_figures_of_an_earlier_report_are_removed(runs: Path, report: Path, tmp_path: Path) -> None:
    files = report.with_name("report_files")
    stale = tmp_path / "new_files" / "classification" / "confusion_network.png"
    stale.parent.mkdir(parents=True)
    shutil.copy(files / "classification" / "hold_out_levels.png", stale)
    options = ReportOptions(variance=files / "variance", classifications=(files / "classification",))
    written = write_report([runs], tmp_path / "new.html", options)
    assert not stale.exists() and stale not in written
    assert len(Page((tmp_path / "new.html").read_text(encoding="utf-8")).all("img")) >= 7


@pytest.mark.usefixtures("no_figures")
def test_folders_of_other_runs_are_refused(runs: Path, report: Path, tmp_path: Path) -> None:
    files = report.with_name("report_files")
    write_study(tmp_path / "runs", image=noise_image, copies=3)
    with pytest.raises(InputError, match=r"variance = .* must be an analysis of all presses of these runs"):
        write_report([tmp_path / "runs"], tmp_path / "r.html", ReportOptions(variance=files / "variance"))
    options = ReportOptions(variance=None, classifications=(files / "classification",))
    with pytest.raises(InputError, match=r"classify = .* must be an analysis of all presses of these runs"):
        write_report([tmp_path / "runs"], tmp_path / "r.html", options)
    with pytest.raises(InputError, match=r"classification_settings\.json.*cannot be read"):
        write_report([runs], tmp_path / "r.html", ReportOptions(classifications=(files / "variance", tmp_path)))
    assert not (tmp_path / "r.html").exists()


def test_an_analysis_file_that_is_a_link_out_of_its_folder_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (tmp_path / "secret.csv").write_text("1")
    (source / "variance.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(InputError, match="is a link to a file outside"):
        copy_files(source, tmp_path / "copy")
    assert not list((tmp_path / "copy").iterdir())


@pytest.mark.usefixtures("no_figures")
def test_a_study_with_too_few_data_gets_a_page_with_reasons(tmp_path: Path) -> None:
    """One texture, one copy and one repeat for each position allow neither a variance nor a classification."""

    def dull(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Bytes:
        return np.full((24, 32), 7, dtype=np.uint8)

    write_study(tmp_path / "runs", textures=[1], copies=1, prints=[("ender-3", "petg")], image=dull, still=0)
    out = tmp_path / "page.html"
    write_report([tmp_path / "runs"], out)
    text = Page(out.read_text(encoding="utf-8")).text
    assert "These data have no classification: " in text
    assert "Findings, at most 5 for each run" in text and "dark" in text
    assert "Simulated" not in text and "simulated data" not in text
    assert "ender-3 petg: cannot be said: there is only one print of each texture" in text
    assert "Look at the problems of texture-1_" in text, "what to do next"


@pytest.mark.usefixtures("no_figures")
def test_a_damaged_image_is_reported_and_the_rest_is_analysed(tmp_path: Path) -> None:
    folders = write_study(tmp_path / "runs", image=texture_image, grid=GRID)
    picture = folders[0] / "sensor_images" / "image_3.png"
    picture.write_bytes(picture.read_bytes()[:40])
    out = tmp_path / "page.html"
    write_report([tmp_path / "runs"], out)
    text = Page(out.read_text(encoding="utf-8")).text
    assert "image_3.png" in text.split("Data quality")[-1]
    assert "the check found" in text and "1 unreadable" in text
    assert "1 frame could not be used and was left out" in text
    assert "These data have no classification: " in text
    assert (tmp_path / "page_files" / "variance" / "variance.csv").is_file()


@pytest.mark.usefixtures("no_figures")
def test_a_damaged_record_is_reported(runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs, tmp_path / "runs")
    first = sorted((tmp_path / "runs").iterdir())[0]
    (first / "print.toml").write_text("nozzle = ")
    out = tmp_path / "page.html"
    write_report([tmp_path / "runs"], out, ReportOptions(classify=False))
    text = Page(out.read_text(encoding="utf-8")).text
    assert "Print records that cannot be read:" in text and f"{first.name}/print.toml" in text


@pytest.mark.parametrize("name", ["report.txt", "report"])
def test_a_page_must_be_html(runs: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"must end in \.html"):
        write_report([runs], tmp_path / name)


def test_the_sheet_shows_a_good_frame_of_each_texture_and_lists_textures_without(tmp_path: Path) -> None:
    folders = write_study(tmp_path / "runs", prints=[("ender-3", "petg")], textures=(1, 2, 3), copies=1, still=0)
    for folder in folders:
        for number in range(1, 9) if "texture-3" in folder.name else [1] if "texture-1" in folder.name else []:
            (folder / "sensor_images" / f"image_{number}.png").write_bytes(b"")
    study = Collection.open([tmp_path / "runs"])
    first = study.frame(1)
    finding = Finding(
        kind="blurred", where=study.paths(int(np.flatnonzero(study.texture == "texture-2")[0]))[0], text=""
    )
    report = RunReport(folder=folders[1], name="", simulated=(), planned=8, findings=(finding,))
    drawn: list[tuple[str, Any]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("matplotlib.axes.Axes.set_title", lambda axes, name, **_: drawn.append((name, axes.images[0])))
        caption = draw_frames(Results(collection=study, reports=(report,)), tmp_path)
    assert caption.endswith("without a problem. No frame of texture-3 can be read.")
    assert [name for name, _ in drawn] == ["texture-1", "texture-2"]
    expected = first, study.frame(int(np.flatnonzero(study.texture == "texture-2")[1]))
    assert all(np.array_equal(image.get_array(), frame) for (_, image), frame in zip(drawn, expected, strict=True))
    assert read_image(tmp_path / "frames.png").width < 400 and (tmp_path / "frames.pdf").is_file()


def test_a_texture_whose_frames_all_have_findings_is_shown_too(tmp_path: Path) -> None:
    folders = write_study(tmp_path / "runs", prints=[("ender-3", "petg")], textures=(1, 2), copies=1, still=0)
    study = Collection.open([tmp_path / "runs"])
    paths = [study.paths(at)[0] for at in np.flatnonzero(study.texture == "texture-2").tolist()]
    findings = tuple(Finding(kind="blurred", where=path, text="") for path in paths)
    report = RunReport(folder=folders[1], name="", simulated=(), planned=8, findings=findings)
    drawn: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("matplotlib.axes.Axes.set_title", lambda _, name, **__: drawn.append(name))
        caption = draw_frames(Results(collection=study, reports=(report,)), tmp_path)
    assert drawn == ["texture-1", "texture-2"]
    assert caption.endswith("without a problem. All frames of texture-2 have a finding of the check.")


def test_table_cells_are_escaped() -> None:
    table = Shown("a < b", pd.DataFrame({"<h>": ["<script>alert(1)</script>"], "n": [1234]}))
    document = {"version": "1", "folder": "f", "title": "t", "simulated": ["<i>"], "notice": "<b>", "summary": []}
    text = render_page({**document, "figures": [], "table": table_part(table), "sections": []}, Path())
    assert "<script>" not in text and "a &lt; b" in text and "<b>" not in text and "<i>" not in text
    assert '<td class="n">1,234</td>' in text and '<th scope="col">&lt;h&gt;</th>' in text
    Page(text)


def test_a_figure_must_be_a_png(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path / "f.png")
    (tmp_path / "f.png").write_bytes(b"<svg>")
    with pytest.raises(InputError, match="is not a PNG file"):
        read_image(tmp_path / "f.png")


def test_depth_mode_is_not_comparable_with_forces(runs: Path) -> None:
    from dataclasses import replace

    collection = Collection.open([runs])
    design = macro("methods.j2", "design")
    assert "Target forces were 0.08045 ± 0.00195 N" in design(collection)
    first = collection.runs[0]
    info = replace(first.info, protocol=first.info.protocol.changed(contact="depth", touch="sensor"))
    changed = replace(collection, runs=(replace(first, info=info), *collection.runs[1:]))
    assert "0.35 mm below first contact (detected by a change of the sensor's frames)" in design(changed)
