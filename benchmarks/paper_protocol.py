"""Measure the paper's whole classification protocol against a plain scikit-learn script of its text.

    python benchmarks/paper_protocol.py [RUNS...] [--cores 2] [--trials 20] [--plain-trials 2]

The protocol has three training combinations, random forest and network, and 20 trials.

* plain: for each trial and combination one PCA of the images and their copies, one forest and one ``MLPClassifier``.
  Only a few trials are run, and their time is multiplied.
* ours: what ``tacbench classify --protocol paper`` does.

Both are child processes on the same cores, one after the other, with the same images. These are the images of run
folders, or synthetic ones of 256 x 192 pixels with textures, prints, positions and noise. The peak memory is the
largest resident size of the process; for ours, that of each worker is added.

Claims: at least 3 times faster, accuracies that agree within 3 standard errors and 0.1 %, and less than a third of
the plain script's peak memory.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.util.types import Bytes, Floats

SELECTED = 3
COMBINATIONS = 9
TEXTURES = 6
CLASSIFIERS = ("forest", "network")
COLUMNS = ("train", "test", "unseen")


class ClassifiedStudy:
    """Images, shape (N, pixels), the texture and the combination of each image, and the combinations for training."""

    def __init__(self, folder: Path) -> None:
        self.images: Bytes = np.load(folder / "images.npy")
        self.texture, self.combination = np.load(folder / "labels.npy")
        counts = np.bincount(self.combination)
        self.selected = sorted(np.argsort(-counts, kind="stable")[:SELECTED].tolist())


def synthetic(folder: Path, selected_count: int, other_count: int, shape: tuple[int, int], seed: int = 1) -> None:
    """Write images of smooth fields: one for each texture, changed by combination, print and position, with noise."""
    random = np.random.default_rng(seed)
    height, width = shape
    up = [np.array([np.interp(np.linspace(0, n - 1, s), range(n), line) for line in np.eye(n)]).T
          for n, s in ((24, height), (32, width))]  # fmt: skip

    def field(size: float, *lead: int) -> Floats:
        return size * random.standard_normal((*lead, 24, 32))

    base, texture, position = 70 + field(15), field(3, TEXTURES), field(5, 25)
    texture_position = field(2, TEXTURES, 25)
    counts = [selected_count if number < SELECTED else other_count for number in range(COMBINATIONS)]
    images = np.empty((TEXTURES * sum(counts), height * width), np.uint8)
    labels = np.empty((2, len(images)), np.int64)
    index = 0
    for combination, count in enumerate(counts):
        combination_texture = field(3, TEXTURES)
        for kind in range(TEXTURES):
            prints = field(2.0 if combination == 0 else 1.0, 6)
            for number in range(count):
                low = (
                    base + texture[kind] + combination_texture[kind] + prints[number // 50 % 6] + position[number % 25]
                )
                low = low + texture_position[kind, number % 25] + field(0.5)
                high = up[0] @ low @ up[1].T + 1.4 * random.standard_normal((height, width))
                images[index] = np.clip(np.rint(high), 0, 255).ravel()
                labels[:, index] = kind, combination
                index += 1
    np.save(folder / "images.npy", images)
    np.save(folder / "labels.npy", labels)


def recorded(folder: Path, runs: list[Path]) -> None:
    """Write the images of run folders, grey and at 40 % of their size."""
    from tacbench_cad import lab

    presses = lab.read(runs)
    np.save(folder / "images.npy", lab.Pixels(resolution=0.4).fit(presses).transform(presses))
    kinds = presses["texture"], presses["printer"] + "_" + presses["filament"]
    np.save(folder / "labels.npy", np.array([np.unique(of, return_inverse=True)[1] for of in kinds]))


class Result:
    """Seconds of each stage, and accuracies of each trial, shape (combination, classifier, column)."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.worker_kb = 0
        self.accuracies: list[list[list[float]]] = []

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


def scored(models: Any, sets: Any) -> list[list[float]]:
    """Return the accuracy of each classifier on each set."""
    return [[float(np.mean(model.predict(rows) == labels)) for rows, labels in sets] for model in models]


def peak_kb() -> int:
    """Return the largest resident size of this process, in kB.

    On Linux it is read from /proc, because ``getrusage`` also counts the parent process before exec.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = status.read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def plain(study: ClassifiedStudy, trials: int, epochs: int) -> Result:
    """Run the script that follows the text of the paper."""
    from sklearn.decomposition import PCA
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.model_selection import train_test_split
    from sklearn.neural_network import MLPClassifier

    result = Result()
    for combination in study.selected:
        chosen = study.combination == combination
        for trial in range(trials):
            random = np.random.default_rng(trial)
            with result.timed("augmenting, PCA"):
                images = study.images[chosen].astype(float)
                noisy = images + random.normal(0, 5, images.shape)
                augmented = np.concatenate([images, noisy, images + 10, images - 10])
                labels = np.tile(study.texture[chosen], 4)
                pca = PCA(n_components=25, random_state=trial)
                scores = pca.fit_transform(augmented)
                unseen = pca.transform(study.images[~chosen].astype(float))
            rows = train_test_split(scores, labels, test_size=0.2, random_state=trial)
            with result.timed("forest"):
                forest = RandomForestClassifier(max_depth=50, random_state=trial).fit(rows[0], rows[2])
            with result.timed("network"):
                network = MLPClassifier((50,), max_iter=epochs, n_iter_no_change=epochs, tol=0, random_state=trial)
                network.fit(rows[0], rows[2])
            with result.timed("predicting"):
                sets = [(rows[0], rows[2]), (rows[1], rows[3]), (unseen, study.texture[~chosen])]
                result.accuracies.append(scored((forest, network), sets))
    return result


def workers_kb() -> int:
    """Return the sum of the largest resident sizes of the child processes, in kB (Linux; otherwise 0)."""
    total = 0
    for children in Path("/proc/self/task").glob("*/children"):
        for pid in children.read_text().split():
            lines = Path(f"/proc/{pid}/status").read_text().splitlines()
            total += next((int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)
    return total


def study_of(study: ClassifiedStudy, epochs: int) -> Any:
    """Return the images as the data of the package for the paper's protocol."""
    import pandas as pd

    from tacbench_cad import lab
    from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
    from tacbench_cad.lab.analysis.classification.training_rows import PAPER_COPIES
    from tacbench_cad.lab.analysis.classification.trials import TrialData
    from tacbench_cad.lab.analysis.study_design import Design

    table = {"texture": study.texture.astype(str), "printer": study.combination.astype(str), "filament": ""}
    presses = pd.DataFrame({"run": "images", "press": np.arange(len(study.images)), "frame": "", **table, "copy": 1})
    selected = tuple(f"{number}_" for number in study.selected)
    settings = ClassificationSettings(
        protocol="paper", estimators=CLASSIFIERS, augmentation=PAPER_COPIES, epochs=epochs, train_on=selected
    )
    return TrialData(settings=settings, design=Design.of(presses), feature=lab.Pixels(), rows=study.images)


def ours(study: ClassifiedStudy, trials: int, epochs: int, cores: int) -> Result:
    """Run the steps of ``tacbench classify --protocol paper`` after reading the images."""
    from tacbench_cad.lab.analysis.classification.paper_protocol import calls
    from tacbench_cad.lab.parallel import workers

    result, data = Result(), study_of(study, epochs)
    with workers(cores) as executor:
        for combination in data.settings.train_on:
            with result.timed("inner products, PCA"):
                trials_to_run = calls(data, combination, range(1, trials + 1))
            with result.timed("forest, network, predicting"):
                trained = list(executor(trials_to_run))
            for outcomes in trained:
                right = outcomes["predicted"] == study.texture[outcomes["press"]].astype(str)
                accuracies = right.groupby([outcomes["estimator"], outcomes["hold_out"]]).mean()
                result.accuracies.append([[accuracies[name, column] for column in COLUMNS] for name in CLASSIFIERS])
        result.worker_kb = workers_kb()
    return result


def child(part: str, folder: Path, trials: int, epochs: int, cores: int) -> None:
    """Run the plain script or ours, and print times, memory and accuracies as JSON."""
    import warnings

    warnings.simplefilter("ignore")
    study = ClassifiedStudy(folder)
    start = time.perf_counter()
    result = plain(study, trials, epochs) if part == "plain" else ours(study, trials, epochs, cores)
    wall = time.perf_counter() - start
    peak = peak_kb() + result.worker_kb
    answer = {"wall": wall, "peak_gb": peak / 1e6, "seconds": result.seconds, "accuracies": result.accuracies}
    print(json.dumps(answer))


def run(part: str, folder: Path, trials: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Run the plain script or ours as a process with its number of cores and threads."""
    threads = {f"{name}_NUM_THREADS": str(arguments.cores) for name in ("OMP", "OPENBLAS", "MKL")}
    argv = [sys.executable, __file__, "--part", part, "--folder", str(folder), "--trials", str(trials)]
    argv += ["--epochs", str(arguments.epochs), "--cores", str(arguments.cores)]
    process = subprocess.run(argv, env={**os.environ, **threads}, stdout=subprocess.PIPE, check=True, text=True)
    answer: dict[str, Any] = json.loads(process.stdout.splitlines()[-1])
    return answer


def show(study: ClassifiedStudy, answers: dict[str, dict[str, Any]], trials: dict[str, int], count: int) -> bool:
    """Print times, memory and accuracies; return whether the claims hold."""
    pixels = study.images.shape[1]
    rows = [int(np.sum(study.combination == number)) for number in study.selected]
    print(f"{len(study.images)} images of {pixels} pixels; trained on {rows} images, four copies each")
    total_s = {part: answer["wall"] * count / trials[part] for part, answer in answers.items()}
    for part, answer in answers.items():
        print(f"\n{part}: {trials[part]} trials in {answer['wall']:.1f} s; peak memory {answer['peak_gb']:.2f} GB")
        for stage, seconds in answer["seconds"].items():
            per_trial = seconds / trials[part] / len(study.selected)
            print(f"  {stage:<30}{seconds:>9.1f} s{per_trial:>9.2f} s for each trial and combination")
    note = f"{trials['plain']} trials, multiplied by {count / trials['plain']:g}"
    print(f"\n{count} trials: plain {total_s['plain']:.0f} s ({note}), ours {total_s['ours']:.0f} s", end="")
    faster = total_s["plain"] / total_s["ours"]
    print(f": {faster:.1f} times faster")
    print(f"\n{'accuracy, %':<26}{'plain':>8}{'ours':>8}{'std':>8}   (std: standard deviation of our trials)")
    agree = True
    tables = {
        part: 100 * np.array(answer["accuracies"]).reshape(len(study.selected), trials[part], 2, 3)
        for part, answer in answers.items()
    }
    for index, combination in enumerate(study.selected):
        for position, classifier in enumerate(CLASSIFIERS):
            for column, name in enumerate(COLUMNS):
                plain_percent, our_percent = (tables[part][index, :, position, column] for part in ("plain", "ours"))
                deviation = our_percent.std(ddof=1) if len(our_percent) > 1 else 0.0
                error = deviation * np.sqrt(1 / len(plain_percent) + 1 / len(our_percent))
                means = plain_percent.mean(), our_percent.mean()
                agrees = abs(means[0] - means[1]) <= 3 * error + 0.1
                agree &= bool(agrees)
                label = f"{combination + 1} {classifier} {name}"
                mark = "" if agrees else "   differ"
                print(f"{label:<26}{means[0]:>8.2f}{means[1]:>8.2f}{deviation:>8.2f}{mark}")
    verdicts = {
        "at least 3 times faster": faster >= 3,
        "accuracies agree (3 standard errors + 0.1 %)": agree,
        "peak memory below a third": answers["ours"]["peak_gb"] < answers["plain"]["peak_gb"] / 3,
    }
    print()
    for claim, holds in verdicts.items():
        print(f"{claim}: {'yes' if holds else 'NO'}")
    return all(verdicts.values())


def main() -> int:
    """Print the tables; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path, help="run folders; default: synthetic images")
    parser.add_argument("--cores", type=int, default=2, help="threads and processes of both (default 2)")
    parser.add_argument("--trials", type=int, default=20, help="trials of the protocol (default 20)")
    parser.add_argument("--plain-trials", type=int, default=2, help="trials of the plain script (default 2)")
    parser.add_argument("--epochs", type=int, default=1500, help="epochs of the networks (default 1500)")
    parser.add_argument("--selected", type=int, default=300, help="images per trained texture (default 300)")
    parser.add_argument("--others", type=int, default=75, help="images per other texture (default 75)")
    parser.add_argument("--size", default="256x192", help="width and height of synthetic images (default 256x192)")
    parser.add_argument("--part", choices=("plain", "ours"), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[: arguments.cores]))
    if arguments.part:
        child(arguments.part, arguments.folder, arguments.trials, arguments.epochs, arguments.cores)
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.runs:
            recorded(folder, arguments.runs)
        else:
            width, height = (int(side) for side in arguments.size.split("x"))
            synthetic(folder, arguments.selected, arguments.others, (height, width))
        trials = {"plain": arguments.plain_trials, "ours": arguments.trials}
        answers = {part: run(part, folder, count, arguments) for part, count in trials.items()}
        return 0 if show(ClassifiedStudy(folder), answers, trials, arguments.trials) else 1


if __name__ == "__main__":
    sys.exit(main())
