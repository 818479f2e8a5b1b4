"""The example estimators of ``tacbench classify``: PyTorch trains a network or loads weights in worker processes."""

from __future__ import annotations

import csv
import pickle
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.checkout import ROOT
from helpers.studies import write_study

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install tacbench-cad[cnn]")
pytest.importorskip("skorch")

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]
EXAMPLES = ("convolutional", "frozen_backbone")
NETWORK = "convolutional:Network"
BACKBONE = "frozen_backbone:classifier"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "runs"
    write_study(folder, still=1)
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a working folder that contains the examples."""
    for name in EXAMPLES:
        shutil.copy(ROOT / "examples" / f"{name}.py", tmp_path)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in EXAMPLES:
        sys.modules.pop(name, None)


def words(runs: Path, estimator: str, *more: str, out: str = "out", trials: int = 1, jobs: int = 1) -> list[str]:
    command = ["classify", str(runs), "--estimator", estimator, "--resolution", "1", "--hold-out", "copy", "-o", out]
    return [*command, "--trials", str(trials), "--jobs", str(jobs), *more]


def accuracy(out: Path) -> float:
    with (out / "classification.csv").open(newline="") as stream:
        return float(next(row["accuracy"] for row in csv.DictReader(stream) if row["tested_on"] == "all"))


def predictions(out: str) -> bytes:
    return (Path(out) / "predictions.csv").read_bytes()


def test_the_convolutional_network_learns_and_is_reproducible(runs: Path, folder: Path) -> None:
    assert main(words(runs, NETWORK, trials=2)) == 0
    assert accuracy(folder / "out") > 0.9, "guessing between two textures gives 0.5"
    first = predictions("out")
    assert main(words(runs, NETWORK, out="processes", trials=2, jobs=2)) == 0
    assert predictions("processes") == first
    files = sorted((folder / "out" / "trials").iterdir())
    stamp = files[0].stat().st_mtime_ns
    files[1].unlink()
    assert main(words(runs, NETWORK, trials=2)) == 0
    assert predictions("out") == first and files[0].stat().st_mtime_ns == stamp and files[1].is_file()


def test_trials_depend_on_the_weights(runs: Path, folder: Path) -> None:
    command = words(runs, BACKBONE, "--noise", "none", "--brightness", "none")
    for number in (1, 2):
        write_weights(folder / "resnet18.pth", seed=number)
        assert main(command) == 0
        assert len(list((folder / "out" / "trials").iterdir())) == number, "different weights need a new trial"
    first = predictions("out")
    shutil.rmtree(folder / "out")
    assert main(command) == 0
    assert predictions("out") == first


def write_weights(path: Path, seed: int) -> None:
    """Write random weights in the format of the published weights of ResNet-18."""
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        from frozen_backbone import ResNet18
    finally:
        sys.path.remove(str(ROOT / "examples"))
    torch.manual_seed(seed)
    weights = dict(ResNet18().state_dict())
    learned = sum(tensor.numel() for name, tensor in weights.items() if name.endswith((".weight", ".bias")))
    assert learned == 11_176_512, "the network must be a ResNet-18 without its last layer"
    expected = {"conv1.weight", "layer1.0.bn2.running_var", "layer2.0.downsample.1.bias", "layer4.1.conv2.weight"}
    assert expected < set(weights) and len(weights) == 120
    torch.save({**weights, "fc.weight": torch.zeros(1000, 512), "fc.bias": torch.zeros(1000)}, path)


class Trap:
    """An object that writes a file when it is unpickled without protection."""

    def __reduce__(self) -> Any:
        return (Path.write_text, (Path("sprung"), "code ran"))


def write_trap(path: Path) -> None:
    torch.save({"conv1.weight": Trap()}, path)


def write_pickle(path: Path) -> None:
    path.write_bytes(pickle.dumps(Trap(), protocol=2))


def write_other_network(path: Path) -> None:
    torch.save({"features.0.weight": torch.zeros(3)}, path)


@pytest.mark.parametrize(
    ("write", "needle"),
    [
        (Path.mkdir, "resnet18.pth"),
        (write_trap, "raised UnpicklingError"),
        (write_pickle, "raised UnpicklingError"),
        (write_other_network, "raised RuntimeError: Error(s) in loading state_dict for ResNet18"),
        (None, "resnet18.pth"),
    ],
    ids=["a folder", "with code", "a pickle", "of another network", "none"],
)
def test_weights_that_cannot_be_used_are_refused_in_one_line(
    runs: Path, folder: Path, capsys: Capture, write: Any, needle: str
) -> None:
    if write is not None:
        write(folder / "resnet18.pth")
    assert main(words(runs, BACKBONE)) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "reading" not in line]
    assert len([line for line in lines if line.startswith("error:")]) == 1 and needle in lines[-1]
    assert not (folder / "sprung").exists()
