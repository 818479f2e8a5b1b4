"""The presses of a study as they are sent to other processes."""

from __future__ import annotations

from typing import NamedTuple

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.runs.reading import Run

#: The printer-filament and the texture of a cell.
CellKey = tuple[str, str]


class SentPress(NamedTuple):
    """A press as it is sent to other processes."""

    level: int
    position: int
    combination: str
    texture: str
    copy: int
    repeat: int
    run: int
    paths: tuple[str, ...]

    @property
    def cell(self) -> CellKey:
        """The printer-filament and the texture."""
        return (self.combination, self.texture)


def presses_of(collection: Collection, feature: Feature) -> list[SentPress]:
    """Return the presses of a study, in the order of the study, with the files that a feature transforms."""
    columns = (
        *(collection.level, collection.position, collection.combination, collection.texture),
        *(collection.print_number, collection.repeat, collection.run),
    )
    values = zip(*(column.tolist() for column in columns), strict=True)
    return [SentPress._make((*press, feature.paths(collection, i))) for i, press in enumerate(values)]


def runs_to_send(collection: Collection) -> tuple[Run, ...]:
    """Return the runs for other processes, without the data that this process has already read.

    Their paths are absolute, because the workers of a cluster have other working folders.
    """
    return tuple(Run(folder=run.folder.absolute(), info=run.info) for run in collection.runs)
