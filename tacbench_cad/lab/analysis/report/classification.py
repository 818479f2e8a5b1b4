"""The classifications that a report shows, read from the files of ``tacbench classify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from tacbench_cad.lab.analysis.classification.classify import Progress
from tacbench_cad.lab.analysis.classification.result import COLUMNS, CONFUSION_COLUMNS
from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.report.report_html import macro
from tacbench_cad.lab.analysis.tables import read_csv
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.files import locked


@dataclass(frozen=True, kw_only=True)
class Classification:
    """A classification as a report shows it.

    Args:
        folder: The folder of its files, inside the folder of the report's files.
        record: The settings and the data of the classification.
        methods: A paragraph that says how it was computed.
        answers: The rows of ``texture_answers.csv``; empty if it answers no question.
        scores: The rows of ``classification.csv``.
        confusion: The rows of ``confusion.csv``.
    """

    folder: Path
    record: ClassificationRecord
    methods: str
    answers: pd.DataFrame
    scores: pd.DataFrame
    confusion: pd.DataFrame

    @classmethod
    def read(cls, folder: Path) -> Classification:
        """Read a classification from an output folder of ``tacbench classify``.

        Raises:
            InputError: A file is missing or damaged, or a setting is missing.
        """
        record = ClassificationRecord.read(folder)
        scores = read_csv(folder / "classification.csv", COLUMNS)
        levels = list(dict.fromkeys(scores["hold_out"]))
        return cls(
            folder=folder,
            record=record,
            methods=macro("methods.j2", "classification")(record, levels),
            answers=read_csv(folder / "texture_answers.csv"),
            scores=scores,
            confusion=read_csv(folder / "confusion.csv", CONFUSION_COLUMNS),
        )

    @property
    def chance(self) -> float:
        """The accuracy expected from guessing, from 0 to 1."""
        return 1.0 / len(self.record.textures)


def classify_into(
    collection: Collection,
    folder: Path,
    trials: int | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: Progress = lambda *_: None,
) -> None:
    """Classify with the leak-free protocol and the default settings of ``tacbench classify``.

    Trials whose results are already in the folder are not repeated.

    Args:
        collection: The study.
        folder: The folder of the tables, figures and finished trials.
        trials: The number of trials; None for the default number of the protocol.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler.
        progress: Receives progress updates.

    Raises:
        InputError: The data cannot be classified, or no Dask scheduler answers at the address.
        CheckFailedError: A frame is damaged.
        MissingToolError: scikit-learn or matplotlib is not installed.
    """
    from tacbench_cad.lab.analysis.classification.accuracy_figures import draw_result
    from tacbench_cad.lab.analysis.classification.classify import TRIALS, classify, write_tables
    from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, usual
    from tacbench_cad.lab.analysis.classification.splits import levels_of
    from tacbench_cad.lab.rig.sensor import is_image

    image = is_image(collection.frame(0))
    given = usual("leak-free", ("forest",), image=image, readings=len(collection))
    settings = ClassificationSettings(**given, hold_out=levels_of(collection))

    def show(what: str, done: int, total: int) -> None:
        progress(f"classification: {what}", done, total)

    with locked(folder), workers(jobs, dask) as executor:
        result = classify(
            collection, settings, TRIALS["leak-free"] if trials is None else trials, folder, executor, show
        )
        write_tables(result, folder)
        draw_result(result, folder)
