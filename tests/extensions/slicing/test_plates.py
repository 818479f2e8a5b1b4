"""Print plates: all blocks fit without overlap, copies are distributed, and the files state the positions."""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.printers import write_corrected
from helpers.rigs import rig_settings

from tacbench_cad.cli import main
from tacbench_cad.extensions.slicing.plates import Plate, arrange_plates
from tacbench_cad.extensions.slicing.printers import Printer, printers
from tacbench_cad.formats import threemf
from tacbench_cad.lab.acquire.session import places
from tacbench_cad.lab.acquire.study_file import read_study
from tacbench_cad.lab.study.names import PRINTERS
from tacbench_cad.lab.study.plate import read_layout
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

Capture = pytest.CaptureFixture[str]
SIX = [Block.of(number) for number in range(1, 7)]
HEX = '[texture]\nname = "hex"\nfamily = "series"\nlaw = "square"\nN = 5\naxes = "x"\n'


def require_no_overlap(plate: Plate, spacing: float) -> None:
    """Check that the blocks keep the margin, the spacing and the areas that must stay free."""
    printer = plate.printer
    boxes = [(b.x_mm, b.y_mm, b.x_mm + b.block.size_mm[0], b.y_mm + b.block.size_mm[1]) for b in plate.blocks]
    for x0, y0, x1, y1 in boxes:
        assert min(x0, y0) >= printer.margin_mm - 1e-9
        assert x1 <= printer.bed_mm[0] - printer.margin_mm + 1e-9
        assert y1 <= printer.bed_mm[1] - printer.margin_mm + 1e-9
        for u0, v0, u1, v1 in printer.keep_out_mm:
            assert x0 >= u1 or x1 <= u0 or y0 >= v1 or y1 <= v0
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            gap = max(a[0] - b[2], b[0] - a[2], a[1] - b[3], b[1] - a[3])
            assert gap >= spacing - 1e-9


@pytest.mark.parametrize("name", mostly_long(sorted(PRINTERS), "bambu-p1p", "form-3"))
def test_six_copies_of_each_texture_on_each_printer(name: str) -> None:
    plates = arrange_plates(SIX, 6, printers()[name])
    labels = [placed.label for plate in plates for placed in plate.blocks]
    assert sorted(labels) == sorted(f"T{n} PAPER X1 {copy:02d}" for n in range(1, 7) for copy in range(1, 7))
    assert [plate.number for plate in plates] == list(range(1, len(plates) + 1))
    for plate in plates:
        require_no_overlap(plate, 5.0)
        counts = np.unique([placed.block.texture.name for placed in plate.blocks], return_counts=True)[1]
        assert counts.max() - counts.min() <= 1
        # The mean of three copies is 25 mm off the middle for a random order, and 60 mm if sorted by texture.
        assert plate.imbalance_mm < 15.0
        assert all(placed.block.label for placed in plate.blocks)


@pytest.mark.parametrize(
    ("copies", "spacing"), mostly_long([(1, 0.0), (2, 20.0), (5, 0.0), (5, 20.0)], (2, 20.0), (5, 0.0))
)
def test_any_number_of_copies_on_a_small_bed(copies: int, spacing: float) -> None:
    small = Printer(
        name="small", bed_mm=(90.0, 100.0), height_mm=20.0, margin_mm=0.0, keep_out_mm=((0, 0, 9, 9),), filaments=("x",)
    )
    blocks = [Block.of(1), Block.of(2, size_mm=(15.0, 20.0)), Block.of(6)]
    plates = arrange_plates(blocks, copies, small, spacing)
    assert sum(len(plate.blocks) for plate in plates) == 3 * copies
    sizes = [len(plate.blocks) for plate in plates]
    assert max(sizes) - min(sizes) <= 1
    for plate in plates:
        require_no_overlap(plate, spacing)


def test_a_block_that_just_fits_and_one_that_does_not() -> None:
    printer = Printer(name="tight", bed_mm=(27.3, 34.0), height_mm=10.0, margin_mm=2.0, filaments=("x",))
    plates = arrange_plates([Block.of(1)], 2, printer)
    assert [plate.imbalance_mm for plate in plates] == [None, None], "one place cannot be spread over the bed"
    with pytest.raises(InputError, match=r"tight.*27\.3 x 34 mm.*a block of 23\.53 x 30\.3 mm does not fit"):
        arrange_plates([Block.of(1, scale=1.01, height_mm=6.9)], 1, printer)
    with pytest.raises(InputError, match="mm high"):
        arrange_plates([Block.of(1, height_mm=10.1)], 1, printer)
    shut = Printer(**{**vars(printer), "keep_out_mm": ((10.0, 10.0, 11.0, 11.0),)})
    with pytest.raises(InputError, match="does not fit"):
        arrange_plates([Block.of(1)], 1, shut)


@pytest.mark.parametrize(("copies", "spacing", "field"), [(0, 5.0, "copies"), (1, -1.0, "spacing"), (1, math.nan, "s")])
def test_impossible_numbers_are_refused(copies: int, spacing: float, field: str) -> None:
    with pytest.raises(InputError, match=field):
        arrange_plates(SIX, copies, printers()["form-3"], spacing)


@pytest.mark.parametrize(
    ("change", "needles"),
    [
        ("", []),
        ("hieght_mm = 3\n", ["hieght_mm", 'did you mean "height_mm"']),
        ("margin_mm = 70\n", ["margin_mm", "70"]),
        ("margin_mm = -1\n", ["margin_mm", "-1"]),
        ("keep_out_mm = [[5, 5, 4, 9]]\n", ["keep_out_mm", "x low"]),
        ("keep_out_mm = [[5, 5, 4]]\n", ["keep_out_mm"]),
        ("[printers.x]\n", ["printers", 'did you mean "printer"']),
    ],
)
def test_printers_of_a_users_file(tmp_path: Path, change: str, needles: list[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('[printer.delta]\nbed_mm = [100, 120]\nheight_mm = 90\nfilaments = ["abs"]\n' + change)
    if not needles:
        assert printers(path)["delta"].bed_mm == (100.0, 120.0) and "form-3" in printers(path)
        return
    with pytest.raises(InputError) as refused:
        printers(path)
    assert all(needle in str(refused.value) for needle in ["mine.toml", *needles])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("lib3mf")
    parent = tmp_path_factory.mktemp("plates")
    (parent / "hex.toml").write_text(HEX)
    options = ("--copies", "2", "--key", "3", "--texture", f"1,{parent / 'hex.toml'}", "--filament", "pla-lite")
    assert main(["plate", "--printer", "bambu-p1p", *options, "--out", str(parent / "out")]) == 0
    return parent / "out"


STEM = "bambu-p1p_pla-minus_plate01"


def test_the_files_of_a_plate(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    expected = {"hex.toml", f"{STEM}.3mf", f"{STEM}.csv", f"{STEM}_print.toml", f"{STEM}.png"}
    assert names == expected - ({f"{STEM}.png"} if "matplotlib" not in sys.modules else set())
    mesh, entries = threemf.read_3mf(folder / f"{STEM}.3mf")
    places = json.loads(entries["parts"])
    assert entries["kind"] == "plate" and len(places) == 4
    low = mesh.bounds_mm[0]
    assert low == pytest.approx([min(place[1] for place in places), min(place[2] for place in places), 0.0], abs=1e-4)
    volume = 2.0 * sum(block.volume_mm3(block.datum_mm) for block in _blocks(folder))
    assert mesh.volume_mm3 == pytest.approx(volume, rel=2e-3)


def _blocks(folder: Path) -> list[Block]:
    from tacbench_cad.spec.texture_files import read_texture

    return [Block.of(1, key_mm=3.0, copy=1), Block.of(read_texture(folder / "hex.toml"), key_mm=3.0, copy=1)]


def test_the_layout_names_blocks_as_acquire_asks_for_them(folder: Path) -> None:
    settings = rig_settings()
    study = folder.parent / "labels.toml"
    study.write_text(f'[study]\nlayouts = ["out/{STEM}.csv"]\n')
    labels = [place.label for place in places(read_study(study).study, settings, folder)]
    with (folder / f"{STEM}.csv").open(newline="") as stream:
        assert sorted(row["label"] for row in csv.DictReader(stream)) == sorted(labels)
    assert sorted(labels) == ["HEX PAPER X1 01", "HEX PAPER X1 02", "T1 PAPER X1 01", "T1 PAPER X1 02"]


def test_acquire_reads_the_layout(folder: Path) -> None:
    blocks = read_layout(folder / f"{STEM}.csv")
    names = sorted(block.name for block in blocks)
    assert names == sorted(
        f"{texture}_paper_x1_key3_bambu-p1p_pla-minus_copy{copy:02d}"
        for texture in ("texture-1", "hex")
        for copy in (1, 2)
    )
    study = folder.parent / "study.toml"
    study.write_text(f'[study]\nlayouts = ["out/{STEM}.csv"]\n')
    settings = read_study(study).study
    assert sorted(block.printed.name for block in settings.blocks) == names
    assert all(block.levels == (1, 2, 3) for block in settings.blocks)


def test_a_completed_print_record_is_kept(folder: Path) -> None:
    record = folder / f"{STEM}_print.toml"
    text = record.read_text()
    assert 'filament = "pla-minus"' in text and "4 blocks" in text
    record.write_text(text + "# mine\n")
    options = ("--copies", "2", "--texture", "1", "--filament", "pla-minus")
    assert main(["plate", "--printer", "bambu-p1p", *options, "--out", str(folder)]) == 0
    assert record.read_text().endswith("# mine\n")


def test_old_plates_of_a_larger_request_are_refused_and_kept(tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("lib3mf")

    def plates(copies: int, filament: str = "petg") -> int:
        options = ("--texture", "1", "--scale", "2", "--spacing", "30", "--filament", filament)
        return main(["plate", "--printer", "ender-3", "--copies", str(copies), *options, "--out", str(tmp_path)])

    assert plates(10) == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert "ender-3_petg_plate02.3mf" in before
    capsys.readouterr()
    assert plates(1) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert "ender-3_petg_plate02.3mf" in err and "ender-3_petg_plate02.csv" in err and "plate01" not in err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert plates(10) == 0 and plates(1, "pla-plus") == 0
    # The print records of the old plates do not matter, because a user may have completed them.
    (tmp_path / "ender-3_petg_plate02.3mf").unlink()
    (tmp_path / "ender-3_petg_plate02.csv").unlink()
    assert plates(1) == 0 and (tmp_path / "ender-3_petg_plate02_print.toml").exists()


@pytest.mark.parametrize(
    ("content", "needles"),
    [
        ("", ["is empty"]),
        ("texture,preset\n1,paper\n", ["no column scale"]),
        ("texture,preset,scale,key_mm,copy,printer,filament\n", ["has no block"]),
        ("texture,preset,scale,key_mm,copy,printer,filament\n9,paper,1,,1,a,b\n", ["line 2", "texture = '9'"]),
        ("texture,preset,scale,key_mm,copy,printer,filament\n1,paper,big,,1,a,b\n", ["scale", "big"]),
        ("texture,preset,scale,key_mm,copy,printer,filament\n1,paper,1,,x,a,b\n", ["copy", "whole number"]),
        (
            "texture,preset,scale,key_mm,copy,printer,filament\n1,paper,1\n",
            ["line 2", "3 fields, but the header has 7"],
        ),
    ],
)
def test_a_layout_with_a_mistake(tmp_path: Path, content: str, needles: list[str]) -> None:
    path = tmp_path / "layout.csv"
    path.write_text(content)
    with pytest.raises(InputError) as refused:
        read_layout(path)
    assert all(needle in str(refused.value) for needle in ["layout.csv", *needles])


def test_a_study_refuses_several_scales_and_textures_beside_a_layout(tmp_path: Path) -> None:
    head = "texture,preset,scale,key_mm,copy,printer,filament\n"
    (tmp_path / "a.csv").write_text(f"{head}1,paper,1,,1,a,b\n")
    (tmp_path / "b.csv").write_text(f"{head}1,paper,2,,1,a,b\n")
    study = tmp_path / "study.toml"
    for text, needle in (
        ('layouts = ["a.csv", "b.csv"]', "several scales"),
        ('layouts = ["a.csv"]\ntextures = [1]', "textures"),
        ('layouts = ["a.csv", "a.csv"]', "twice"),
        ('layouts = ["none.csv"]', "cannot be read"),
    ):
        study.write_text(f"[study]\n{text}\n")
        with pytest.raises(InputError, match=needle):
            read_study(study)


@pytest.mark.parametrize(
    ("options", "needle"),
    [
        (["--printer", "ender3"], 'did you mean "ender-3"'),
        (["--printer", "form-3", "--scale", "6"], "does not fit"),
        (["--printer", "form-3", "--copies", "0"], "copies = 0"),
        (["--printer", "form-3", "--copies", "six"], "whole number"),
        (["--printer", "form-3", "--spacing", "-3"], "spacing = -3.0"),
        (["--printer", "form-3", "--filament", "PLA PLUS"], "filament"),
        (["--printer", "form-3", "--printers", "none.toml"], "none.toml"),
        (["--printer", "form-3", "--texture", "7"], "texture = '7'"),
        ([], "--printer"),
    ],
)
def test_wrong_input_is_one_line(
    options: list[str], needle: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["plate", *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1
    assert needle in err
    assert list(tmp_path.iterdir()) == []


def test_a_plate_of_other_files_names_the_files_and_the_textures_of_the_prints(tmp_path: Path, capsys: Capture) -> None:
    corrected = write_corrected(tmp_path / "corrected", Block.of(1))
    out = tmp_path / "plates"
    options = ("--texture", "1", "--copies", "2", "--files", str(tmp_path / "corrected"), "--out", str(out))
    assert main(["plate", "--printer", "ender-3", "--filament", "pla-plus", *options]) == 0
    assert "T1-CORR PAPER X1 01" in capsys.readouterr().out
    printed = read_layout(out / "ender-3_pla-plus_plate01.csv")
    assert [each.block for each in printed] == [Block.of(1)] * 2
    assert [each.file and each.file.size_mm for each in printed] == [corrected.file.size_mm] * 2
    parts, _ = threemf.read_parts(out / "ender-3_pla-plus_plate01.3mf")
    assert parts[0][1].bounds_mm[1][0] - parts[0][1].bounds_mm[0][0] == pytest.approx((23.3 - 0.1) / 0.996, abs=1e-4)
