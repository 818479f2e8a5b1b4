"""Test the quality of frames: problems of light, focus and camera are reported, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.lookalikes import LOOKS, draw
from helpers.studies import GRID, write_study

from tacbench_cad.lab.rig.frames import FrameLimits
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.quality import Judge, beside_each_other
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.lab.vision.region import Region, find_region


@pytest.fixture(scope="module", params=LOOKS)
def look(request: pytest.FixtureRequest) -> tuple[Judge, list[Frame]]:
    """Return a judge and two frames of a look: at rest and pressed."""
    frames = [draw(LOOKS[request.param], 1).image, draw(LOOKS[request.param], 2, 12.0).image]
    return Judge(limits=FrameLimits(), region=find_region(frames[:1])), frames


def kinds(judge: Judge, frame: Frame) -> list[str]:
    return [kind for kind, _ in judge.faults(judge.measure(frame))]


def inside_blurred(judge: Judge, frame: Frame, sigma: float) -> Frame:
    """Return a frame that is blurred inside the sensor's region and sharp outside it."""
    assert judge.region is not None
    blurred = frame.copy()
    blurred[judge.region.mask] = cv2.GaussianBlur(frame, (0, 0), sigma)[judge.region.mask]
    return blurred


def test_frames_of_every_look_pass_and_a_blurred_dome_is_reported(look: tuple[Judge, list[Frame]]) -> None:
    judge, frames = look
    for frame in frames:
        assert kinds(judge, frame) == []
        assert kinds(judge, inside_blurred(judge, frame, 5.0)) == ["blurred"]


def test_a_dark_dome_in_bright_surroundings_is_dark_and_not_blurred(look: tuple[Judge, list[Frame]]) -> None:
    judge, frames = look
    assert judge.region is not None
    dark = frames[0].copy()
    dark[judge.region.mask] //= 16
    assert kinds(judge, dark) == ["dark"]


def test_a_saturated_dome_is_reported(look: tuple[Judge, list[Frame]]) -> None:
    judge, frames = look
    bright = np.minimum(frames[0].astype(int) * 12, 255).astype(np.uint8)
    assert "saturated" in kinds(judge, bright)


def findings(frames: Sequence[Frame], judge: Judge) -> list[tuple[str, str, str]]:
    names = [str(number) for number in range(len(frames))]
    measured = dict(zip(names, map(judge.measure, frames), strict=True))
    return list(beside_each_other(measured, names, {"still": names[:5]}))


def scaled(frame: Frame, light: float) -> Frame:
    return np.clip(np.rint(frame * light), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def dome() -> tuple[Judge, Frame]:
    frame = draw(LOOKS["C"], 1).image
    return Judge(limits=FrameLimits(), region=find_region([frame])), frame


def test_a_region_too_narrow_for_a_margin_is_judged_completely() -> None:
    mask = np.zeros((60, 80), dtype=bool)
    mask[30:32] = True
    judge = Judge(limits=FrameLimits(), region=Region(text="rect:0,30,79,31", mask=mask))
    measured = judge.measure(np.full((60, 80), 250, np.uint8))
    assert measured.quality.saturated == 1.0


def test_normal_drift_and_flicker_cause_no_findings(dome: tuple[Judge, Frame]) -> None:
    judge, frame = dome
    light = np.concatenate([np.full(5, 1.0) + 0.002 * np.array([-1, 1, -1, 1, 0]), np.linspace(1.0, 0.97, 15)])
    varied = [np.roll(scaled(frame, factor), i % 2, axis=1) for i, factor in enumerate(light)]
    assert findings(varied, judge) == []


def test_a_file_that_is_darker_than_the_others_is_reported(dome: tuple[Judge, Frame]) -> None:
    judge, frame = dome
    frames = [frame] * 19 + [scaled(frame, 117.0 / 143.0)]
    ((kind, where, text),) = findings(frames, judge)
    assert (kind, where) == ("brightness", "19")
    assert text.startswith("is 18 % darker than the run's median")
    assert text.endswith("(limit 12 %)")


def test_flicker_drift_and_a_moved_camera_are_reported(dome: tuple[Judge, Frame]) -> None:
    judge, frame = dome
    assert [kind for kind, *_ in findings([scaled(frame, 1.0 - 0.04 * (i % 2)) for i in range(6)], judge)] == [
        "flicker"
    ]
    falling = findings([scaled(frame, 1.0 - 0.005 * max(0, i - 5)) for i in range(24)], judge)
    assert [kind for kind, *_ in falling] == ["drift"]
    assert "fell by" in falling[0][2]
    shifted = findings([frame] * 12 + [np.roll(frame, (4, 7), axis=(0, 1))], judge)
    assert [(kind, where) for kind, where, _ in shifted] == [("moved", "12")]
    assert float(shifted[0][2].split()[11]) == pytest.approx(np.hypot(4, 7), abs=0.1)
    assert "px away from its median position" in shifted[0][2]


def test_the_check_of_a_run_reports_numbers_and_limits(tmp_path: Path) -> None:
    y, x = np.mgrid[:96, :128]
    inside = np.hypot(x - 64, y - 50) < 36
    clean = np.where(inside, 60.0 + 80.0 * ((x // 6 + y // 6) % 2), 210.0)

    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        picture = clean * (0.8 if press.number == 3 else 1.0)
        if press.number == 5:
            picture = np.where(inside, cv2.GaussianBlur(picture, (0, 0), 5.0), picture)
        return np.clip(np.rint(picture + rng.standard_normal(clean.shape)), 0, 255).astype(np.uint8)

    (folder,) = write_study(
        tmp_path, image=image, shape=clean.shape, textures=(1,), copies=1, prints=(("form-3", "grey-v4"),), grid=GRID
    )
    judged = {finding.where: finding for finding in check_run(folder).findings if finding.kind in JUDGED}
    assert {where: finding.kind for where, finding in judged.items()} == {
        "sensor_images/image_3.png": "brightness",
        "sensor_images/image_5.png": "blurred",
    }
    assert "20 % darker" in judged["sensor_images/image_3.png"].text
    assert "inside the sensor's region" in judged["sensor_images/image_5.png"].text


JUDGED = ("dark", "blurred", "saturated", "brightness", "flicker", "drift", "moved")
