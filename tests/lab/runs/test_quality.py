"""Test the quality of frames: problems of light, focus and camera are reported, and nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.dots import REST, dots_at_rest, dots_frame
from helpers.frame_kinds import frames_of
from helpers.lookalikes import LOOKS, draw
from helpers.studies import GRID, write_study

from tacbench_cad.cli import main
from tacbench_cad.lab.rig.frames import FrameLimits
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.quality import Judge, beside_each_other
from tacbench_cad.lab.runs.reading import find_runs
from tacbench_cad.lab.runs.region import Region
from tacbench_cad.lab.runs.region_search import find_region
from tacbench_cad.lab.runs.typical_frame import TypicalFrame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.types import Floats


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
    judge = replace(judge, typical=TypicalFrame(frames=frames))
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
    assert "the picture is shifted by 8." in shifted[0][2]


def blurred_in_the_dome(frame: Frame) -> Frame:
    """Return a frame of the TacTip ``A`` whose dome is blurred by sigma 2."""
    y, x = np.mgrid[: frame.shape[0], : frame.shape[1]]
    look = LOOKS["A"]
    dome = np.hypot(x - look.centre[0], y - look.centre[1]) < 0.97 * look.radius
    blurred = frame.copy()
    blurred[dome] = cv2.GaussianBlur(frame, (0, 0), 2.0)[dome]
    return blurred


def noisy(frame: Frame) -> Frame:
    noise = np.random.default_rng(1).normal(0.0, 20.0, frame.shape)
    return np.clip(np.rint(frame + noise), 0, 255).astype(np.uint8)


def shifted_by_5(frame: Frame) -> Frame:
    return np.asarray(np.pad(frame, ((3, 0), (4, 0), (0, 0))[: frame.ndim], mode="edge"))[:-3, :-4]


#: What is wrong with a frame, and the kind of finding.
FAULTS: dict[str, tuple[Callable[[Frame], Frame], str]] = {
    "red and blue swapped": (lambda frame: frame[..., ::-1].copy(), "colour"),
    "mirrored": (lambda frame: frame[:, ::-1].copy(), "orientation"),
    "upside down": (lambda frame: frame[::-1].copy(), "orientation"),
    "shift of 5 px": (shifted_by_5, "moved"),
    "noise of sigma 20": (noisy, "noise"),
    "blur of sigma 2 in the dome": (blurred_in_the_dome, "blurred"),
}
#: The faults that cannot be seen in frames of a kind: grey ones have no colours to swap, a binary one has no focus, a
#: centred dome is symmetric, and the edges of a gel are those of the object.
UNSEEN = {
    "tactip": (),
    "tactip_binary": ("red and blue swapped", "mirrored", "upside down", "blur of sigma 2 in the dome"),
    "tactip_127": ("red and blue swapped", "blur of sigma 2 in the dome"),
    "gelsight_dots": ("blur of sigma 2 in the dome",),
    "digit": ("blur of sigma 2 in the dome",),
    "gelsight_mini": ("blur of sigma 2 in the dome",),
}


def imported(folder: Path, frames: Sequence[Frame]) -> Path:
    (folder / "class").mkdir(parents=True)
    for number, frame in enumerate(frames, start=1):
        cv2.imwrite(str(folder / "class" / f"{number:03d}.png"), frame)
    assert main(["import-frames", str(folder / "class"), "-o", str(folder / "runs")]) == 0
    (run,) = find_runs([folder / "runs"])
    return run


@pytest.mark.parametrize("kind", mostly_long(UNSEEN, "digit"))
def test_good_frames_of_every_kind_pass_and_each_fault_is_found(kind: str, tmp_path: Path) -> None:
    frames = [shot.image for shot in frames_of(kind, 20, seed=6)]
    good = imported(tmp_path / "good", frames)
    assert [finding for finding in check_run(good).findings if finding.kind in JUDGED] == []
    faults = [(change, kind_of) for name, (change, kind_of) in FAULTS.items() if name not in UNSEEN[kind]]
    for number, (change, _) in enumerate(faults):
        frames[2 * number + 1] = change(frames[2 * number + 1])
    findings = check_run(imported(tmp_path / "faulty", frames)).findings
    expected = {f"sensor_images/image_{2 * number + 2}.png": kind_of for number, (_, kind_of) in enumerate(faults)}
    assert {each.where: each.kind for each in findings if each.kind in JUDGED} == expected


def pins(places: Sequence[tuple[float, float]], size: tuple[int, int], width_px: float, edge_px: float) -> Floats:
    """Return bright discs with a height of 1 on black."""
    y, x = np.mgrid[: size[0], : size[1]]
    image = np.zeros(size)
    for column, row in places:
        outside = np.clip((np.hypot(x - column, y - row) - width_px / 2.0) / edge_px, -30.0, 30.0)
        image = np.maximum(image, 1.0 / (1.0 + np.exp(outside)))
    return image


def pressed(count: int, spacing: float, push_px: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Return a square field of markers around 0, which a contact pushes away from a place."""
    grid = spacing * (np.arange(count) - (count - 1) / 2.0)
    places = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    away = places - rng.uniform(-0.2, 0.2, 2) * spacing * count
    push = rng.uniform(0.0, push_px) * np.exp(-np.sum(away**2, axis=1) / (2.0 * (2.0 * spacing) ** 2)) / spacing
    return [(float(column), float(row)) for column, row in places + away * push[:, None]]


def on_black(rng: np.random.Generator) -> Frame:
    """Return a frame of a few bright pins on a black background, which is most of the frame."""
    places = [(320.0 + column, 240.0 + row) for column, row in pressed(7, 30.0, 8.0, rng)]
    noise = rng.normal(0.0, 1.0, (480, 640))
    return np.clip(np.rint(200.0 * pins(places, (480, 640), 8.0, 0.5) + noise), 0, 255).astype(np.uint8)


def small_binary(rng: np.random.Generator) -> Frame:
    """Return a binary frame whose pins are 5.2 px apart, about as far as the shift."""
    places = [(63.5 + column, 63.5 + row) for column, row in pressed(18, 5.2, 2.0, rng)]
    return np.where(pins(places, (128, 128), 2.6, 0.3) > 0.5, 255, 0).astype(np.uint8)


def soft_pins_in_a_sharp_rim(rng: np.random.Generator) -> Frame:
    """Return a dome whose pins have softer edges than its rim."""
    y, x = np.mgrid[:240, :320]
    distance = np.hypot(x - 160, y - 120)
    places = [(160.0 + column, 120.0 + row) for column, row in pressed(9, 14.0, 5.0, rng)]
    dome = 90.0 + 140.0 * pins(places, (240, 320), 9.0, 1.1)
    image = np.where(distance < 100.0, dome, np.where(distance < 110.0, 248.0, 190.0))
    noise = rng.normal(0.0, 0.5, image.shape)
    return np.clip(np.rint(cv2.GaussianBlur(image, (0, 0), 0.8) + noise), 0, 255).astype(np.uint8)


def blurred_pins(frame: Frame) -> Frame:
    y, x = np.mgrid[: frame.shape[0], : frame.shape[1]]
    return np.where(np.hypot(x - 160, y - 120) < 95.0, cv2.GaussianBlur(frame, (0, 0), 2.0), frame)


@pytest.mark.parametrize(
    ("draw_one", "change", "kind"),
    mostly_long(
        [
            (on_black, shifted_by_5, "moved"),
            (small_binary, shifted_by_5, "moved"),
            (soft_pins_in_a_sharp_rim, shifted_by_5, "moved"),
            (soft_pins_in_a_sharp_rim, blurred_pins, "blurred"),
        ],
        (small_binary, shifted_by_5, "moved"),
        (soft_pins_in_a_sharp_rim, blurred_pins, "blurred"),
    ),
)
def test_a_fault_is_found_where_most_pixels_do_not_show_it(
    draw_one: Callable[[np.random.Generator], Frame], change: Callable[[Frame], Frame], kind: str
) -> None:
    rng = np.random.default_rng(4)
    frames = [draw_one(rng) for _ in range(12)]
    judge = Judge(limits=FrameLimits(), region=None, any_kind=True)
    assert findings(frames, judge) == []
    frames[7] = change(frames[7])
    assert [(found, where) for found, where, _ in findings(frames, judge)] == [(kind, "7")]


def test_a_frame_at_rest_among_frames_with_contact_is_not_mirrored() -> None:
    rng = np.random.default_rng(1)
    frames = [dots_frame(np.add((6.0, 1.0), rng.normal(0.0, 0.3, (len(REST), 2))), rng) for _ in range(6)]
    frames += [dots_at_rest(np.random.default_rng(number)) for number in range(2)]
    judge = Judge(limits=FrameLimits(), region=None, any_kind=True)
    assert [each for each in findings(frames, judge) if each[0] == "orientation"] == []


def lit_gel(rng: np.random.Generator) -> Frame:
    """Return a soft image, lit from three sides, of a large and strong contact with waves at a random phase."""
    y, x = np.mgrid[:240, :320].astype(float)
    centre, width = rng.uniform(0.35, 0.65, 2) * (320, 240), rng.uniform(45.0, 75.0)
    patch = np.exp(-((((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2.0 * width**2)) ** 2))
    angles, steps = np.random.default_rng(24).uniform((0.0, 0.05), (np.pi, 0.35), (4, 2)).T
    waves = sum(
        np.sin(step * (x * np.cos(angle) + y * np.sin(angle)) + rng.uniform(0.0, 6.0))
        for angle, step in zip(angles, steps, strict=True)
    )
    height = cv2.GaussianBlur(patch * (waves * rng.uniform(0.6, 1.4) + 4.0), (0, 0), 2.2)
    slope_y, slope_x = np.gradient(height)
    image = 20.0 + rng.normal(0.0, 1.2, (240, 320, 3))
    for column, row, along_x, along_y, colour in (
        (160.0, 264.0, 0.0, -1.0, (44.0, 44.0, 165.0)),
        (-16.0, -10.0, 0.87, 0.5, (44.0, 165.0, 44.0)),
        (336.0, -10.0, -0.87, 0.5, (165.0, 50.0, 44.0)),
    ):
        light = np.exp(-np.hypot(x - column, y - row) / 288.0) * (1.0 + 1.2 * (slope_x * along_x + slope_y * along_y))
        image += light[..., None] * np.array(colour)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("count", mostly_long([1, 4], 1))
def test_a_large_contact_with_a_soft_gel_is_no_motion_of_the_camera(count: int) -> None:
    rng = np.random.default_rng(3)
    judge = Judge(limits=FrameLimits(), region=None, any_kind=True)
    runs = [[lit_gel(rng) for _ in range(25)] for _ in range(count)]
    assert [each for frames in runs for each in findings(frames, judge) if each[0] == "moved"] == []


def test_frames_of_a_soft_gel_and_binary_frames_were_all_faulty_by_fixed_limits() -> None:
    judge = Judge(limits=FrameLimits(), region=None)
    assert Counter(kind for shot in frames_of("digit", 6, seed=6) for kind in kinds(judge, shot.image))["blurred"] >= 3
    assert kinds(replace(judge, any_kind=True), frames_of("digit", 1, seed=6)[0].image) == []


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


JUDGED = ("dark", "blurred", "saturated", "brightness", "flicker", "drift", "moved", "noise", "colour", "orientation")
