"""Test which frame of a video a time means: each frame of the test videos shows its own number."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tacbench_cad.extensions.exchange.importing.videos import Video
from tacbench_cad.lab import Run, import_samples

FRAMES = 90


def picture(number: int) -> np.ndarray:
    """Return a frame whose eight squares are the bits of a number."""
    image = np.zeros((32, 128, 3), np.uint8)
    for bit in range(8):
        image[:, 16 * bit : 16 * bit + 16] = 255 * (number >> bit & 1)
    return image


def number_of(image: np.ndarray) -> int:
    return sum(int(image[16, 16 * bit + 8].mean() > 127) << bit for bit in range(8))


def write(path: Path, codec: str, fps: float, count: int = FRAMES) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, (128, 32))
    if not writer.isOpened():
        pytest.skip(f"this build of OpenCV writes no {codec}")
    for number in range(count):
        writer.write(picture(number))
    writer.release()
    return path


@pytest.mark.parametrize(("name", "codec"), [("a.avi", "MJPG"), ("a.mp4", "mp4v"), ("a.mkv", "mp4v")])
@pytest.mark.parametrize("fps", [30.0, 29.97, 25.0])
def test_a_rounded_time_means_the_frame_that_it_was_taken_from(
    name: str, codec: str, fps: float, tmp_path: Path
) -> None:
    video = Video(write(tmp_path / name, codec, fps))
    for decimals in (2, 3, 4, 9):
        assert [video.nearest(round(n / fps, decimals))[0] for n in range(FRAMES)] == list(range(FRAMES))
    assert [number_of(video.frame(n)) for n in (0, 7, 40, 89, 3)] == [0, 7, 40, 89, 3]


def test_the_import_stores_these_frames_and_says_where_they_came_from(table: Any, tmp_path: Path) -> None:
    video = write(tmp_path / "press.mp4", "mp4v", 30.0)
    order = np.random.default_rng(1).permutation(FRAMES)
    rows = [(f"{n / 30.0:.3f}", "gel", f"note {n}") for n in order]
    times = table(tmp_path / "times.csv", ("time", "label", "remark"), rows)
    report = import_samples([video, times], tmp_path / "out")
    assert report.ok and not any("warning" in note for note in report.notes)
    run = Run.open(tmp_path / "out" / "gel")
    assert [number_of(run.frame(row)) for row in run.rows] == order.tolist()
    for row, n in zip(run.rows, order, strict=True):
        origin = run.origins[row.sensor_image]
        assert (origin["source_file"], origin["source_frame"], origin["remark"]) == ("press.mp4", str(n), f"note {n}")


def test_a_time_far_from_every_frame_is_warned_about_or_left_out(table: Any, tmp_path: Path) -> None:
    video = write(tmp_path / "press.avi", "MJPG", 10.0, count=20)
    rows = [("1.9", "a"), ("1.94", "a"), ("1.97", "a"), ("2.3", "a")]
    report = import_samples([video, table(tmp_path / "times.csv", ("time", "label"), rows)], tmp_path / "out")
    run = Run.open(tmp_path / "out" / "a")
    assert [number_of(run.frame(row)) for row in run.rows] == [19, 19, 19]
    (warning,) = [note for note in report.notes if "warning" in note]
    assert "1 time is more than half a frame from every frame" in warning
    assert "times.csv line 4: 1.97 s, nearest frame at 1.9 s" in warning
    assert [each.reason for each in report.left_out] == [
        "video = 'press.avi': has no frame at 2.3 s; its last frame is at 1.9 s"
    ]


def test_dropped_frames_do_not_shift_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A file whose frames 3 and 4 are missing: the times that it states, not a constant rate, decide.
    stated_s = [0.0, 0.1, 0.2, 0.5, 0.6, 0.7]

    class Capture:
        def __init__(self, _: str) -> None:
            self.at = -1
            self.isOpened = lambda: True

        def grab(self) -> bool:
            self.at += 1
            return self.at < len(stated_s)

        def get(self, prop: int) -> float:
            return 10.0 if prop == cv2.CAP_PROP_FPS else 1000.0 * stated_s[self.at]

    (tmp_path / "a.avi").write_bytes(b"RIFF")
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    video = Video(tmp_path / "a.avi")
    assert [video.nearest(time)[0] for time in (0.2, 0.3, 0.44, 0.5, 0.6)] == [2, 2, 3, 3, 4]


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Write a video of two seconds with 10 frames per second, each of a single grey level."""
    path = tmp_path / "press.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (32, 24))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV writes no videos")
    for number in range(20):
        writer.write(np.full((24, 32, 3), 10 * number, np.uint8))
    writer.release()
    return path


def test_frames_of_a_video_at_the_times_of_a_table(video: Path, table: Any, tmp_path: Path) -> None:
    rows = [("0", "a"), ("0.55", "a"), ("0.6", "b"), ("1.9", "a"), ("0.1", "a"), ("2.5", "a"), ("-1", "a"), ("x", "b")]
    times = table(tmp_path / "times.csv", ("time", "label"), rows)
    report = import_samples([video, times], tmp_path / "out")
    run = Run.open(tmp_path / "out" / "a")
    levels = [round(float(run.frame(row).mean()) / 10) for row in run.rows]
    assert levels == [0, 5, 19, 1]
    assert [sample.where.partition(" (")[0] for sample in report.left_out] == [
        "times.csv line 7",
        "times.csv line 8",
        "times.csv line 9",
    ]
    assert "has no frame at 2.5 s; its last frame is at 1.9 s" in report.left_out[0].reason
