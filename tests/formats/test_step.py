"""Writing and reading of STEP files: one valid solid with its name and colour, in millimetres."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("OCP")

from tacbench_cad.checks import solidcheck
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats.step import read_step, write_step
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.spec.block import Block


@pytest.mark.parametrize("block", [Block.of(1), Block.of(2, key_mm=3.0), Block.of(5, "released")], ids=lambda b: b.name)
def test_file_contains_one_valid_solid(block: Block, tmp_path: Path) -> None:
    part = block_part(block)
    write_step(part, tmp_path / "a.step")
    shape = read_step(tmp_path / "a.step")
    assert all(check.ok for check in solidcheck.solid_checks(shape))
    assert solidcheck.measure(shape).volume_mm3 == pytest.approx(part.solid[1].volume_mm3, rel=1e-4)
    report = verify(part, tmp_path / "a.step")
    assert report.ok, report.faults
    assert report.deviation_mm is not None
    assert report.deviation_mm <= 0.001


def test_header_has_schema_and_name_but_no_time(tmp_path: Path) -> None:
    part = block_part(Block.of(1))
    write_step(part, tmp_path / "a.step")
    text = (tmp_path / "a.step").read_text()
    assert "FILE_SCHEMA(('AUTOMOTIVE_DESIGN" in text
    assert re.search(rf"FILE_NAME\('{part.name}','1980-01-01T00:00:00',\(''\),\(''\)", text)
    assert f"PRODUCT('{part.name}','{part.name}'" in text
    assert "COLOUR_RGB" in text
    assert "SI_UNIT(.MILLI.,.METRE.)" in text
    assert str(tmp_path) not in text


def test_another_reader_finds_name_and_colour(tmp_path: Path) -> None:
    from OCP.Quantity import Quantity_Color
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDF import TDF_LabelSequence
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    part = block_part(Block.of(1))
    write_step(part, tmp_path / "a.step")
    document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
    reader = STEPCAFControl_Reader()
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    reader.ReadFile(str(tmp_path / "a.step"))
    assert reader.Transfer(document)
    labels = TDF_LabelSequence()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(labels)
    assert labels.Length() == 1
    name = TDataStd_Name()
    assert labels.Value(1).FindAttribute(TDataStd_Name.GetID_s(), name)
    assert name.Get().ToExtString() == part.name
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    colour = Quantity_Color()
    kinds = (XCAFDoc_ColorType.XCAFDoc_ColorGen, XCAFDoc_ColorType.XCAFDoc_ColorSurf)
    assert any(colours.GetColor_s(labels.Value(1), kind, colour) for kind in kinds)


def test_cadquery_and_build123d_import_one_solid(tmp_path: Path) -> None:
    import build123d
    import cadquery

    part = block_part(Block.of(1))
    write_step(part, tmp_path / "a.step")
    imported = cadquery.importers.importStep(str(tmp_path / "a.step"))
    assert imported.solids().size() == 1
    assert imported.val().isValid()
    assert imported.val().Volume() == pytest.approx(part.solid[1].volume_mm3, rel=1e-4)
    solids = build123d.import_step(tmp_path / "a.step").solids()
    assert len(solids) == 1
    assert pytest.approx(7.0, abs=1e-3) == solids[0].bounding_box().size.Z
