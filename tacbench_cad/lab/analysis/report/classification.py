"""The section of a report on what the sensor distinguishes, from the files of ``tacbench classify``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.lab.analysis.classification.classify import SETTINGS_FILE, Progress
from tacbench_cad.lab.analysis.classification.result import COLUMNS, CONFUSION_COLUMNS, recall_table
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.report.pieces import Piece, Study
from tacbench_cad.lab.analysis.tables import Table, read_settings
from tacbench_cad.lab.parallel import Executor, workers
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked
from tacbench_cad.util.text import counted

_SHOWN = ("estimator", "hold_out", "train_on", "tested_on", "accuracy", "low", "high", "trials", "images")
#: What a figure shows, by the beginning of its file's name.
CAPTIONS = {
    "hold_out_levels": "Accuracy as what is held out grows: presses, positions, forces, copies, printers.",
    "paper_table": "The paper's classification table beside these data.",
    "confusion": "Which texture (rows) was taken for which (columns).",
    "sweep": "Accuracy along one setting.",
}


@dataclass(frozen=True, kw_only=True)
class Classification:
    """A classification's files within the report's.

    Args:
        folder: Their folder.
        settings: What was asked for.
    """

    folder: Path
    settings: Mapping[str, Any]


def computed(study: Study, jobs: int, dask: str | None, progress: Progress) -> Classification:
    """Classify with the leak-free protocol, or what of it is missing in the report's folder.

    Raises:
        InputError: The data do not allow it, or nothing answers at the Dask address.
        CheckFailedError: A reading is damaged.
        MissingToolError: scikit-learn or matplotlib is not installed.
    """
    from tacbench_cad.lab.analysis.classification.classify import TRIALS

    folder = study.files / "classification"
    with locked(folder), workers(jobs, dask) as executor:
        classify_into(study.collection, folder, TRIALS["leak-free"], executor, progress)
    return Classification(folder=folder, settings=read_settings(folder / SETTINGS_FILE))


def classify_into(collection: Collection, folder: Path, trials: int, executor: Executor, progress: Progress) -> None:
    """Classify with the leak-free protocol as ``tacbench classify`` does without options.

    Args:
        collection: The study.
        folder: Folder of tables, figures and finished trials, held by the caller.
        trials: Trials.
        executor: Worker processes.
        progress: Receives progress updates.

    Raises:
        InputError: See :func:`tacbench_cad.lab.analysis.classification.classify.classify`.
        CheckFailedError: Likewise.
    """
    from tacbench_cad.lab.analysis.classification.augment import Augmentation
    from tacbench_cad.lab.analysis.classification.classify import classify, write_tables
    from tacbench_cad.lab.analysis.classification.figures import draw_result
    from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
    from tacbench_cad.lab.rig.sensor import is_image

    image = is_image(collection.frame(0))
    settings = ClassificationSettings(augmentation=Augmentation() if image else Augmentation(noise=None, brightness=()))

    def show(what: str, done: int, total: int) -> None:
        progress(f"classification: {what}", done, total)

    result = classify(collection, settings, trials, folder, executor, show)
    write_tables(result, folder)
    draw_result(result, folder)


def refusal_of(error: InputError | CheckFailedError) -> str:
    """Why there is no classification, as the end of a sentence.

    Raises:
        InputError: The error is none of the data's.
    """
    if isinstance(error, InputError) and error.field in ("dask", "jobs", "output folder", "output file"):
        raise error
    return str(error)


def section(study: Study, classifications: Sequence[Classification]) -> Iterator[Piece]:
    """Accuracies, recall, confusion matrices, of one or several classifications."""
    for classification in classifications:
        protocol, name = str(classification.settings["protocol"]), classification.folder.name
        if len(classifications) > 1:
            yield Piece("heading", f"Protocol {protocol}")
        notes = [str(note) for note in classification.settings.get("notes", ())]
        if notes:
            yield Piece("list", items=notes)
        chance = f"chance is {100.0 / len(classification.settings['textures']):.1f} %"
        title = f"Accuracy in per cent with 95 % intervals, protocol {protocol}; {chance}"
        scores = Table.read(classification.folder / "classification.csv", COLUMNS, title).select(*_SHOWN)
        confusion = Table.read(classification.folder / "confusion.csv", CONFUSION_COLUMNS)
        yield study.table(scores, f"{name}/classification.csv")
        yield study.table(recall_table(confusion), f"{name}/confusion.csv")
        for stem, caption in CAPTIONS.items():
            for path in sorted(classification.folder.glob(f"{stem}*.png")):
                yield study.figure(f"{name}/{path.stem}", caption)


def methods_text(classification: Classification) -> str:
    """How a classification was computed: a paragraph.

    Raises:
        InputError: the settings' file lacks something.
    """
    try:
        return _methods(classification.settings)
    except (KeyError, TypeError, ValueError) as error:
        path = classification.folder / SETTINGS_FILE
        raise InputError("settings", str(path), f"holds a wrong or missing value: {error}") from None


def _methods(settings: Mapping[str, Any]) -> str:
    copies = settings["augmentation"]
    kinds = ["the reading itself"]
    if copies["noise"] is not None:
        kinds.append(f"one with Gaussian noise of standard deviation {copies['noise']:g}")
    kinds += [f"one with {level:+g} added" for level in copies["brightness"]]
    estimators = ", ".join(_estimator(str(name), settings) for name in settings["estimators"])
    components = settings["components"]
    reduced = "" if components is None else f", {components} principal components"
    sentences = [
        f"Textures were classified by {estimators} from readings at {settings['resolution']:g} of their width and "
        f"height{reduced}. Each training reading stood in the training set as: {', '.join(kinds)}"
        f" ({'clipped to 0 to 255' if settings['clip'] else 'not clipped'})."
    ]
    if settings["protocol"] == "leak-free":
        sentences.append(
            "Copies, scaling and principal components were made and fitted inside each training fold. Held out were, "
            f"one after another: {', '.join(settings['hold_out'])} (presses and positions in {settings['folds']} "
            "folds, the others one group at a time)."
        )
    else:
        sentences.append(
            "As in the paper's text, copies were made and principal components fitted before 20 % of the rows were "
            "split off, so copies of one reading lie on both sides and the test column is inflated; training was on "
            f"{', '.join(settings['train_on'])}, each tested on all others [1]."
        )
    sentences.append(
        f"Averaged over {counted(settings['trials'], 'trial')}; seed {settings['seed']}. Intervals (95 %) have the "
        "held-out groups, within them the prints, as their unit."
    )
    return " ".join(sentences)


def _estimator(name: str, settings: Mapping[str, Any]) -> str:
    if name == "forest":
        return f"a random forest (largest depth {settings['depth']})"
    if name == "network":
        return (
            f"a network with one hidden layer of 50 (Adam at 0.001, {settings['epochs']} epochs, batches of "
            f"{settings['batch_size']})"
        )
    return name
