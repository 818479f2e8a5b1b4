"""What a report shows of a classification, from the files of ``tacbench classify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.lab.analysis.answers import COLUMNS as ANSWER_COLUMNS
from tacbench_cad.lab.analysis.answers import shown
from tacbench_cad.lab.analysis.classification.classify import Progress
from tacbench_cad.lab.analysis.classification.result import COLUMNS, CONFUSION_COLUMNS, recall_table
from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.report.rendering import macro
from tacbench_cad.lab.analysis.tables import Table
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.files import locked

_SHOWN = ("estimator", "hold_out", "train_on", "tested_on", "accuracy", "low", "high", "trials", "images")


@dataclass(frozen=True, kw_only=True)
class Classification:
    """A classification as a report shows it.

    Args:
        folder: Folder of its files within the report's.
        record: What was asked for.
        methods: How it was computed: a paragraph.
        answers: Which textures can be told apart; without rows where it does not say.
        scores: Accuracies with intervals.
        recall: Recall of each texture.
    """

    folder: Path
    record: ClassificationRecord
    methods: str
    answers: Table
    scores: Table
    recall: Table

    @classmethod
    def read(cls, folder: Path) -> Classification:
        """The classification in a folder that ``tacbench classify`` wrote.

        Raises:
            InputError: A file is missing or damaged, or the settings lack something.
        """
        record = ClassificationRecord.read(folder)
        chance = 100.0 / len(record.textures)
        title = f"Accuracy in per cent with 95 % intervals, protocol {record.protocol}; chance is {chance:.1f} %"
        return cls(
            folder=folder,
            record=record,
            methods=macro("methods.j2", "classification")(record),
            answers=shown(Table.read(folder / "texture_answers.csv", ANSWER_COLUMNS)),
            scores=Table.read(folder / "classification.csv", COLUMNS, title).select(*_SHOWN),
            recall=recall_table(Table.read(folder / "confusion.csv", CONFUSION_COLUMNS)),
        )


def classify_into(
    collection: Collection,
    folder: Path,
    trials: int | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: Progress = lambda *_: None,
) -> None:
    """Classify with the leak-free protocol as ``tacbench classify`` does without options, or what of it is missing.

    Args:
        collection: The study.
        folder: Folder of tables, figures and finished trials.
        trials: Trials; None for the usual number.
        jobs: Processes of this machine.
        dask: Address of a Dask scheduler.
        progress: Receives progress updates.

    Raises:
        InputError: The data do not allow it, or nothing answers at the Dask address.
        CheckFailedError: A reading is damaged.
        MissingToolError: scikit-learn or matplotlib is not installed.
    """
    from tacbench_cad.lab.analysis.classification.classify import TRIALS, classify, write_tables
    from tacbench_cad.lab.analysis.classification.figures import draw_result
    from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, usual
    from tacbench_cad.lab.rig.sensor import is_image

    image = is_image(collection.frame(0))
    settings = ClassificationSettings(**usual("leak-free", ("forest",), image=image, readings=len(collection)))

    def show(what: str, done: int, total: int) -> None:
        progress(f"classification: {what}", done, total)

    with locked(folder), workers(jobs, dask) as executor:
        result = classify(
            collection, settings, TRIALS["leak-free"] if trials is None else trials, folder, executor, show
        )
        write_tables(result, folder)
        draw_result(result, folder)
