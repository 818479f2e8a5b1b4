"""The command ``tacbench printer-model``: the file, the picture, the table, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.printers import PRINTER
from helpers.scan_documents import scan_document, write_scan

from tacbench_cad.cli import main
from tacbench_cad.extensions.printer_models.model import read_printer_model
from tacbench_cad.spec.block import Block

Capture = pytest.CaptureFixture[str]


def test_a_folder_of_scans_gives_a_model_and_a_picture(tmp_path: Path, capsys: Capture) -> None:
    for copy in (1, 2, 3):
        write_scan(tmp_path / "scans" / str(copy), scan_document(Block.of(5), PRINTER, copy=copy))
    out = tmp_path / "my-printer.toml"
    assert main(["printer-model", str(tmp_path / "scans"), "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "ender-3 with pla-plus: 3 prints, 3 scans, simulated" in printed
    assert "waves along y" in printed and "not determined" in printed
    assert printed.endswith(f"\nNext: tacbench correct {out} -o corrected\n")
    model = read_printer_model(out)
    assert (model.prints, len(model.transfer_x), model.transfer_y) == (3, 13, ())
    assert out.with_suffix(".png").exists()
    assert main(["printer-model", str(tmp_path / "scans"), "-o", str(out), "--json", "--no-picture"]) == 0
    assert json.loads(capsys.readouterr().out)["scale_x"]["value"] == model.scale_x.value  # type: ignore[union-attr]


def test_the_relief_of_corrected_prints_is_a_choice(tmp_path: Path, capsys: Capture) -> None:
    scan = write_scan(tmp_path / "a", scan_document(Block.of(4), PRINTER))
    for rule in ("formula", "free"):
        out = tmp_path / f"{rule}.toml"
        assert main(["printer-model", str(scan), "--relief", rule, "-o", str(out), "--no-picture"]) == 0
        assert read_printer_model(out).relief_rule == rule
    assert main(["printer-model", str(scan), "--relief", "none", "-o", str(tmp_path / "b.toml")]) == 2
    assert "allowed: formula, free" in capsys.readouterr().err
