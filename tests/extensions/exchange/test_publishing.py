"""Test ``tacbench publish``: an RO-Crate with everything, whose metadata contain only known information."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from tacbench_cad.cli import main
from tacbench_cad.extensions.exchange.publishing.crate import publish
from tacbench_cad.extensions.exchange.publishing.metadata import datacite
from tacbench_cad.extensions.exchange.publishing.publication import FORM_FILE, Publication, read_publication, write_form
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import CheckFailedError, InputError

rocrate = pytest.importorskip("rocrate.rocrate")

Capture = pytest.CaptureFixture[str]
ABOUT = """
title = "Presses on one block"
year = 2026
publisher = "Zenodo"
licence = "CC-BY-4.0"
description = "A test."
related = ["10.1000/182", "https://example.org/study"]
[[authors]]
family_name = "Carberry"
given_names = "Josiah"
affiliation = "Brown University"
orcid = "0000-0002-1825-0097"
[[authors]]
family_name = "Doe"
given_names = "Jane"
affiliation = "An Institute"
"""


@pytest.fixture
def about(tmp_path: Path) -> Path:
    path = tmp_path / "about.toml"
    path.write_text(ABOUT)
    return path


def write_parts(blocks: Any, folder: Path) -> None:
    for block in blocks:
        (folder / f"{block.name}.stl").write_bytes(b"solid")


def published(run_folder: Path, about: Path, out: Path, **more: Any) -> list[Path]:
    def write_report(path: Path) -> None:
        path.write_text("<p>report</p>")

    return publish([run_folder], out, read_publication(about), report=write_report, parts=write_parts, **more)


def test_the_crate_contains_everything(run_folder: Path, about: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    files = published(run_folder, about, out)
    crate = rocrate.ROCrate(out)
    assert crate.name == "Presses on one block"
    assert crate.root_dataset["license"].id == "https://spdx.org/licenses/CC-BY-4.0.html"
    assert [author["name"] for author in crate.root_dataset["author"]] == ["Josiah Carberry", "Jane Doe"]
    assert crate.root_dataset["author"][0].id == "https://orcid.org/0000-0002-1825-0097"
    entities = {entity.id: entity for entity in crate.data_entities}
    assert "16 frames; simulated (stage: stage model)" in entities["runs/run/"]["description"]
    part = f"parts/{Block.of(4).name}.stl"
    assert entities[part]["encodingFormat"] == "model/stl"
    assert entities[part]["sha256"] == hashlib.sha256(b"solid").hexdigest()
    assert {"report.html", "LICENSE.txt", "datacite.json", ".zenodo.json", "README.md"} <= set(entities)
    assert "A 3D-Printable Dataset" in crate.root_dataset["citation"]["name"]
    assert "simulated" in crate.root_dataset["keywords"] and "Simulated data" in crate.description
    for name in (path for path in entities if not path.startswith("http")):
        assert (out / name).exists()
    copies = {path.relative_to("runs/run") for path in files if path.parts[0] == "runs"}
    assert copies == {path.relative_to(run_folder) for path in run_folder.rglob("*") if path.is_file()}


def test_the_metadata_match_datacites_schema(run_folder: Path, about: Path, tmp_path: Path) -> None:
    schema = pytest.importorskip("datacite.schema45")
    published(run_folder, about, tmp_path / "out")
    document = json.loads((tmp_path / "out" / "datacite.json").read_text())
    schema.validator.validate(document)
    assert document["publicationYear"] == "2026" and "doi" not in document
    assert [item["relatedIdentifierType"] for item in document["relatedIdentifiers"]] == ["DOI", "URL"]
    assert document["creators"][1] == {
        "name": "Doe, Jane",
        "nameType": "Personal",
        "givenName": "Jane",
        "familyName": "Doe",
        "affiliation": [{"name": "An Institute"}],
    }


def test_zenodos_file_has_the_fields_of_its_form(run_folder: Path, about: Path, tmp_path: Path) -> None:
    published(run_folder, about, tmp_path / "out")
    document = json.loads((tmp_path / "out" / ".zenodo.json").read_text())
    assert document["upload_type"] == "dataset" and document["license"] == "CC-BY-4.0"
    assert document["creators"][0] == {
        "name": "Carberry, Josiah",
        "affiliation": "Brown University",
        "orcid": "0000-0002-1825-0097",
    }


def test_a_zip_file_is_a_crate(run_folder: Path, about: Path, tmp_path: Path) -> None:
    files = published(run_folder, about, tmp_path / "new" / "out.zip")
    with zipfile.ZipFile(tmp_path / "new" / "out.zip") as archive:
        assert sorted(archive.namelist()) == sorted(path.as_posix() for path in files)
    assert rocrate.ROCrate(tmp_path / "new" / "out.zip").name == "Presses on one block"
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["out.zip"]


@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_a_changed_frame_and_an_interruption_leave_nothing(
    name: str, run_folder: Path, about: Path, tmp_path: Path
) -> None:
    def stop(what: str, done: int, count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        published(run_folder, about, tmp_path / name, progress=stop)
    (run_folder / "stationary" / "end_free_01.png").write_bytes(b"x")
    with pytest.raises(CheckFailedError, match=r"end_free_01.png: was changed"):
        published(run_folder, about, tmp_path / name)
    (run_folder / "stationary" / "end_free_01.png").unlink()
    with pytest.raises(CheckFailedError, match=r"end_free_01.png: is missing, but a row refers to it"):
        published(run_folder, about, tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["about.toml", "run"]


@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_existing_output_is_not_overwritten(name: str, run_folder: Path, about: Path, tmp_path: Path) -> None:
    published(run_folder, about, tmp_path / name)
    with pytest.raises(InputError, match="already exists"):
        published(run_folder, about, tmp_path / name)


def test_a_link_out_of_a_run_is_refused(run_folder: Path, about: Path, tmp_path: Path) -> None:
    (run_folder / "photo.jpg").symlink_to(about)
    with pytest.raises(InputError, match="is a link to a file outside"):
        published(run_folder, about, tmp_path / "out")


def test_the_form_is_refused_until_it_is_filled_in(tmp_path: Path) -> None:
    form = tmp_path / "about.toml"
    write_form(form)
    assert form.read_text() == FORM_FILE.read_text()
    with pytest.raises(InputError, match="already exists"):
        write_form(form)
    with pytest.raises(InputError, match=r"about.toml: .*is empty; fill it in"):
        read_publication(form)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('title = "Presses on one block"', 'title = " "', "title is empty|title: is empty"),
        ('licence = "CC-BY-4.0"\n', "", "licence"),
        ('licence = "CC-BY-4.0"', 'licence = "all rights reserved"', "SPDX"),
        ("year = 2026", "year = 26", "1900 or later"),
        ('affiliation = "An Institute"', 'affiliation = ""', r"about.toml: \[authors 2\] affiliation: is empty"),
        ("0000-0002-1825-0097", "0000-0002-1825-0098", r"\[authors 1\] orcid = '.*98': must be an ORCID"),
        ("10.1000/182", "see the paper", "must be a DOI"),
        ("title", "titel", "titel"),
    ],
)
def test_missing_or_wrong_entries_are_reported(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "about.toml"
    path.write_text(ABOUT.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_publication(path)


def test_the_licences_text_and_a_doi_are_included(run_folder: Path, about: Path, tmp_path: Path) -> None:
    (tmp_path / "own.txt").write_text("Do as you like.")
    about.write_text('licence_file = "own.txt"\ndoi = "10.5281/zenodo.1234567"\n' + ABOUT)
    published(run_folder, about, tmp_path / "out")
    assert (tmp_path / "out" / "LICENSE.txt").read_text() == "Do as you like."
    publication = read_publication(about)
    assert isinstance(publication, Publication)
    assert datacite(publication, "", [])["doi"] == "10.5281/zenodo.1234567"


def test_the_command_includes_existing_files_and_a_report(
    run_folder: Path, about: Path, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "x.step").write_text("step")
    (tmp_path / "r.html").write_text("page")
    (tmp_path / "r_files").mkdir()
    (tmp_path / "r_files" / "t.csv").write_text("a")
    words = ["publish", str(run_folder), "--about", str(about), "--parts", str(tmp_path / "made")]
    assert main([*words, "--report", str(tmp_path / "r.html"), "-o", str(tmp_path / "out"), "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert {"parts/x.step", "report.html", "report_files/t.csv"} <= set(files)


def test_unknown_properties_of_imported_images_are_not_stated(about: Path, tmp_path: Path, capsys: Capture) -> None:
    import cv2
    import numpy as np

    for label in ("felt", "cork"):
        (tmp_path / "images" / label).mkdir(parents=True)
        image = np.random.default_rng(len(label)).integers(0, 256, (24, 32), np.uint8)
        cv2.imwrite(str(tmp_path / "images" / label / "1.png"), image + (label == "cork"))
    assert main(["import-frames", str(tmp_path / "images"), "-o", str(tmp_path / "runs")]) == 0
    words = ["publish", str(tmp_path / "runs"), "--about", str(about), "--no-report", "-o", str(tmp_path / "out")]
    assert main(words) == 0
    crate = rocrate.ROCrate(tmp_path / "out")
    assert crate.description == (
        "A test. 2 frames of a tactile sensor, in 2 runs (2 labels). Nothing is marked as simulated."
    )
    assert crate.root_dataset.get("citation") is None and not (tmp_path / "out" / "parts").exists()
    words = ["export-runs", str(tmp_path / "runs"), "--to", "webdataset", "-o", str(tmp_path / "tar")]
    assert main(words) == 0
    page = (tmp_path / "tar" / "README.md").read_text()
    assert "printer` |" not in page and "| cork | 1 |" in page
