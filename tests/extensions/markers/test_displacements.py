"""Test the displacements of markers in imported runs, with and without frames of the sensor at rest."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.dots import REST, dots_at_rest, dots_frame

from tacbench_cad.cli import main
from tacbench_cad.extensions.markers.displacements import MarkerFeatures
from tacbench_cad.lab.runs.reading import Run, find_runs

#: The displacement of every dot in the frames of a class, in px, as column and row.
PUSHED = {"cork": (6.0, 1.0), "felt": (0.0, -3.0)}
FRAMES = 6


@pytest.fixture
def imported(tmp_path: Path) -> Path:
    """Import six frames of two classes, in which the dots are displaced by known distances."""
    rng = np.random.default_rng(1)
    for name, push in PUSHED.items():
        (tmp_path / "photographs" / name).mkdir(parents=True)
        for number in range(FRAMES):
            frame = dots_frame(np.add(push, rng.normal(0.0, 0.3, (len(REST), 2))), rng)
            cv2.imwrite(str(tmp_path / "photographs" / name / f"{number}.png"), frame)
    assert main(["import-frames", str(tmp_path / "photographs"), "-o", str(tmp_path / "runs")]) == 0
    return tmp_path / "runs"


def displacements(runs: list[Run]) -> dict[str, tuple[float, float]]:
    """Return the median displacement in the frames of each class, in px."""
    features, medians = MarkerFeatures.learn(runs), {}
    for run in runs:
        frames = [np.median(features.displacement_px(run.folder, run.folder / row.path), axis=0) for row in run.rows]
        medians[str(run.info.printed.texture)] = tuple(np.round(np.median(frames, axis=0), 1).tolist())
    return medians


def test_without_frames_at_rest_displacements_are_relative_to_the_median_position(imported: Path) -> None:
    runs = [Run.open(folder) for folder in find_runs([imported])]
    found = displacements(runs)
    # The difference between the classes remains, and the median over the frames of both is the origin.
    assert np.subtract(found["cork"], found["felt"]) == pytest.approx(np.subtract(*PUSHED.values()), abs=0.2)
    assert np.add(found["cork"], found["felt"]) == pytest.approx((0.0, 0.0), abs=0.3)


def test_reference_frames_give_the_displacements_from_rest(
    imported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    order = ["markers", str(imported), "-o", str(tmp_path / "pictures")]
    assert main(order) == 0
    assert "displacements are measured from the median position of each marker" in capsys.readouterr().out
    (tmp_path / "rest").mkdir()
    for number in range(2):
        frame = dots_at_rest(np.random.default_rng(number))
        cv2.imwrite(str(tmp_path / "rest" / f"{number}.png"), frame)
    assert main([*order, "--reference", str(tmp_path / "rest"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["markers"], document["expected"]) == (49, 49)
    assert document["displacement_from"] == "position without contact"
    found = displacements([Run.open(folder) for folder in find_runs([imported])])
    assert found == {name: pytest.approx(push, abs=0.2) for name, push in PUSHED.items()}
    assert main(["check-runs", str(imported)]) == 0
    assert main([*order, "--reference", str(tmp_path / "rest")]) == 2
    assert "every run has frames without contact" in capsys.readouterr().err


@pytest.mark.parametrize(("content", "message"), [(None, "contains no image"), (b"x", "small.png"), ("small", "shape")])
def test_unusable_reference_frames_are_refused(
    imported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | str | None, message: str
) -> None:
    (tmp_path / "rest").mkdir()
    if isinstance(content, bytes):
        (tmp_path / "rest" / "small.png").write_bytes(content)
    elif content:
        cv2.imwrite(str(tmp_path / "rest" / "small.png"), np.zeros((20, 20), np.uint8))
    order = ["markers", str(imported), "-o", str(tmp_path / "pictures")]
    assert main([*order, "--reference", str(tmp_path / "rest")]) == 2
    assert message in capsys.readouterr().err
    assert not any(Run.open(folder).references for folder in find_runs([imported]))
