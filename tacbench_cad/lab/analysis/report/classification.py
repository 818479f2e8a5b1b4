"""The section of a report on what the sensor can tell apart, from the files of ``tacbench classify``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.lab.analysis.classification.classify import SETTINGS_FILE, Progress
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.report.pieces import Piece, Study
from tacbench_cad.lab.analysis.tables import Column, Table, percent, read_settings
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked
from tacbench_cad.util.text import counted

#: Columns of ``classification.csv`` that the page shows.
COLUMNS = (
    *(Column(name) for name in ("estimator", "rung", "train_on", "tested_on")),
    *(Column(name, float, text=percent) for name in ("accuracy", "low", "high")),
    Column("trials", int),
    Column("images", int),
)
_CONFUSION = (
    *(Column(name) for name in ("estimator", "train_on", "tested_on", "rung", "texture", "predicted")),
    Column("share", float),
)
#: What a figure shows, by the beginning of its file's name.
CAPTIONS = {
    "ladder": "Accuracy as what is held out grows: presses, positions, forces, copies, printers.",
    "paper_table": "The paper's classification table beside these data.",
    "confusion": "Which texture (rows) was taken for which (columns).",
    "sweep": "Accuracy along one setting.",
}
#: ``tested_on`` of rows of a whole rung, without single held-out groups.
WHOLE = ("all", "all others")


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
    from tacbench_cad.lab.parallel import workers

    folder = study.files / "classification"
    with locked(folder), workers(jobs, dask) as team:
        classify_into(study.collection, folder, TRIALS["sound"], team, progress)
    return Classification(folder=folder, settings=read_settings(folder / SETTINGS_FILE))


def classify_into(collection: Collection, folder: Path, trials: int, team: Any, progress: Progress) -> None:
    """Classify with the leak-free protocol as ``tacbench classify`` does without options.

    Args:
        collection: The study.
        folder: Folder of tables, figures and finished trials, held by the caller.
        trials: Trials.
        team: Processes.
        progress: Receives what is done, how much of it and of how much.

    Raises:
        InputError: See :func:`tacbench_cad.lab.analysis.classification.classify.classify`.
        CheckFailedError: Likewise.
    """
    from tacbench_cad.lab.analysis.classification.augment import Augmentation
    from tacbench_cad.lab.analysis.classification.classify import classify, write_tables
    from tacbench_cad.lab.analysis.classification.figures import draw_result
    from tacbench_cad.lab.analysis.classification.settings import Settings
    from tacbench_cad.lab.rig.sensor import is_image

    image = is_image(collection.frame(0))
    settings = Settings(augmentation=Augmentation() if image else Augmentation(noise=None, brightness=()))

    def show(what: str, done: int, total: int) -> None:
        progress(f"classification: {what}", done, total)

    result = classify(collection, settings, trials, folder, team, show)
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
        textures = [str(texture) for texture in classification.settings["textures"]]
        chance = f"chance is {100.0 / len(textures):.1f} %"
        title = f"Accuracy in per cent with 95 % intervals, protocol {protocol}; {chance}"
        yield study.table(
            Table.read(classification.folder / "classification.csv", COLUMNS, title), f"{name}/classification.csv"
        )
        yield study.table(_recall(classification, textures), f"{name}/confusion.csv")
        for stem, caption in CAPTIONS.items():
            for path in sorted(classification.folder.glob(f"{stem}*.png")):
                yield study.figure(f"{name}/{path.stem}", caption)


def _recall(classification: Classification, textures: Sequence[str]) -> Table:
    recalls: dict[tuple[str, ...], dict[str, Any]] = {}
    for row in Table.read(classification.folder / "confusion.csv", _CONFUSION).rows:
        if row["texture"] == row["predicted"] and row["tested_on"] in (*WHOLE, row["train_on"]):
            key = {name: row[name] for name in ("estimator", "rung", "train_on")}
            recalls.setdefault(tuple(key.values()), key)[row["texture"]] = row["share"]
    columns = [Column("estimator"), Column("rung"), Column("train_on", head="trained on")]
    columns += [Column(texture, head=texture, text=percent) for texture in textures]
    empty = dict.fromkeys(textures)
    title = "Recall: of a hundred readings of a texture, how many were predicted to be of it"
    return Table(columns=tuple(columns), rows=tuple({**empty, **row} for row in recalls.values()), title=title)


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
    if settings["protocol"] == "sound":
        sentences.append(
            "Copies, scaling and principal components were made and fitted inside each training fold. Held out were, "
            f"one after another: {', '.join(settings['rungs'])} (presses and positions in {settings['folds']} folds, "
            "the others one group at a time)."
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
