"""Find domes and gels in frames of all looks, and read, store and refuse regions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.frame_kinds import frames_of
from helpers.lookalikes import LOOKS, Look, draw, gel

from tacbench_cad.cli import main
from tacbench_cad.lab.runs.region import SURE, Region, parse_region, store_region, stored_region
from tacbench_cad.lab.runs.region_search import find_region
from tacbench_cad.util.errors import InputError

DARK = replace(LOOKS["A"], surround=(4, 2), leds=(0, 0.0, 0.0), skin=(40, 40, 40), beyond=45)


def numbers(region: Region) -> list[float]:
    return [float(number) for number in region.text.partition(":")[2].split(",")]


@pytest.mark.parametrize(
    ("look", "press"),
    [(LOOKS[name], 0.0) for name in LOOKS]
    + [(LOOKS["E"], 12.0), (DARK, 0.0), (replace(LOOKS["B"], surround=(300, 300)), 0.0)],
    ids=[*LOOKS, "pressed", "dark surround", "saturated surround"],
)
def test_a_dome_is_found_in_all_surroundings(look: Look, press: float) -> None:
    region = find_region([draw(look, 1, press).image])
    assert region.text.startswith("circle:")
    assert numbers(region) == pytest.approx([*look.centre, look.radius], abs=1.5)
    assert region.sureness >= SURE
    assert region.outside == pytest.approx(1.0 - np.pi * look.radius**2 / (640 * 480), abs=0.02)


def test_a_gel_is_found() -> None:
    region = find_region([gel(1).image])
    assert region.text.startswith("rect:")
    assert numbers(region) == pytest.approx([60.0, 30.0, 580.0, 450.0], abs=2.5)
    assert region.sureness >= SURE


@pytest.mark.parametrize("kind", mostly_long(["digit", "gelsight_mini", "gelsight_dots"], "gelsight_mini"))
def test_a_patch_of_light_is_no_dome(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = [shot.image for shot in frames_of(kind, 3, seed=4)]
    with pytest.raises(InputError, match="found no dome or gel in these frames; leave it out to use the whole frame"):
        find_region(frames)
    (tmp_path / "class").mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / "class" / f"{number}.png"), frame)
    assert main(["import-frames", str(tmp_path / "class"), "-o", str(tmp_path / "runs")]) == 0
    for more in ([], ["--roi", "auto"]):
        assert main(["roi", str(tmp_path / "runs"), *more]) == 0
        assert "no dome or gel was found: the whole frame is used" in capsys.readouterr().out
    assert not list(tmp_path.glob("runs/*/roi.json"))


def test_an_empty_image_has_no_region() -> None:
    noise = np.random.default_rng(0).integers(90, 110, (120, 160), dtype=np.uint8)
    for frames in ([noise], []):
        with pytest.raises(InputError, match=r"roi|frames"):
            find_region(frames)


@pytest.mark.parametrize(
    ("text", "pixels"), [("circle:50,40,20", 1257), ("circle 50,40,20", 1257), ("rect:10,20,29,39", 400)]
)
def test_a_region_is_read(text: str, pixels: int) -> None:
    region = parse_region(text, 80, 100)
    assert region.mask.sum() == pytest.approx(pixels, abs=5)
    assert parse_region(region.text, 80, 100).mask.sum() == region.mask.sum()
    assert region.scaled(40, 50).sum() == pytest.approx(pixels / 4, rel=0.06)


@pytest.mark.parametrize(
    "text", ["", "auto", "circle:1,2", "circle:1,2,x", "rect:9,9,1,1", "circle:500,500,10", "mask.jpg", "missing.png"]
)
def test_invalid_regions_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="roi"):
        parse_region(text, 80, 100)


def test_a_picture_can_be_a_region_and_is_stored_with_a_run(tmp_path: Path) -> None:
    picture = np.zeros((80, 100, 3), dtype=np.uint8)
    picture[10:60, 20:70] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), picture)
    region = parse_region(str(tmp_path / "mask.png"), 80, 100)
    assert region.mask.sum() == 2500
    with pytest.raises(InputError, match="is 100 x 80 pixels; the frames are 50 x 40"):
        parse_region(str(tmp_path / "mask.png"), 40, 50)
    assert stored_region(tmp_path) is None
    store_region(tmp_path, region)
    kept = stored_region(tmp_path)
    assert kept is not None
    assert np.array_equal(kept.mask, region.mask)
    store_region(tmp_path, parse_region("circle:50,40,20", 80, 100))
    kept = stored_region(tmp_path)
    assert kept is not None
    assert kept.text == "circle:50,40,20"
    assert kept.drawn(picture).shape == picture.shape


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "[]",
        '{"roi": "circle:50,40,20", "width": 0, "height": 80}',
        '{"roi": "../x.png", "width": 100, "height": 80}',
        '{"roi": "roi.png", "width": 100, "height": 80}',
        '{"roi": "circle:50,40,20", "width": 100, "height": 80, "sureness": 2}',
    ],
)
def test_a_damaged_stored_region_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "roi.json").write_text(text)
    with pytest.raises(InputError, match=r"roi"):
        stored_region(tmp_path)
