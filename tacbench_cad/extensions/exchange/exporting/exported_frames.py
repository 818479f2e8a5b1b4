"""The frames of runs, which are read one by one as the bytes of their files, with their columns."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.extensions.exchange.exporting.columns import COLUMNS, ExportColumn, values_of
from tacbench_cad.lab.rig import Frame
from tacbench_cad.lab.runs import IMAGE_SUFFIXES, Row, Run, decoded, find_runs
from tacbench_cad.util.errors import InputError

#: A function that is called with the number of frames written so far and the number of all frames.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class ExportedSample:
    """A frame with its columns.

    Args:
        key: A unique name: the frame's number in the export, from ``00000001``.
        data: The bytes of the file. They were compared with the checksum in the row.
        suffix: The suffix of the file name.
        values: The values by column.
    """

    key: str
    data: bytes
    suffix: str
    values: dict[str, Any]

    def decoded(self) -> Frame:
        """Return the frame as an array, in the order of colours inside the program.

        Raises:
            CheckFailedError: The file cannot be decoded.
        """
        return decoded(self.data)


class Samples:
    """The frames of all presses of some runs, in the order of the folder names and of the press numbers.

    Args:
        folders: Run folders, or folders that contain run folders.
        progress: A function that is called after each frame.

    Raises:
        InputError: There are no frames, or a run cannot be read.

    Attributes:
        labels: The number of frames with each label; the key None counts frames without a label.
        unknown: The number of frames without a value, by column.
        simulated: The simulated devices, as keys.
        series: The names of the runs with series of moving frames, as keys. Only the frames of the presses are
            exported.
    """

    def __init__(self, folders: Iterable[Path], progress: Progress = lambda done, count: None) -> None:
        self._folders = find_runs(folders)
        self._progress = progress
        self.labels: Counter[str | None] = Counter()
        self.unknown: Counter[str] = Counter()
        self.simulated: dict[str, None] = {}
        self.series: dict[str, None] = {}
        self.not_images: list[str] = []
        names = Counter(folder.name for folder in self._folders)
        common = Path(os.path.commonpath([folder.absolute().parent for folder in self._folders]))
        self.runs = tuple(
            folder.name if names[folder.name] == 1 else folder.absolute().relative_to(common).as_posix()
            for folder in self._folders
        )
        for _, row, values in self._rows():
            self.labels[values["label"]] += 1
            self.unknown.update(name for name, value in values.items() if value is None)
            if not row.sensor_image.endswith(IMAGE_SUFFIXES):
                self.not_images.append(row.sensor_image)
        if not self.labels:
            raise InputError("runs", str(self._folders[0]), "has no press yet")

    def __len__(self) -> int:
        return self.labels.total()

    def __iter__(self) -> Iterator[ExportedSample]:
        """Yield the samples. Each is compared with its checksum.

        Raises:
            CheckFailedError: A frame is missing, damaged or changed.
        """
        for number, (run, row, values) in enumerate(self._rows(), start=1):
            data = run.read_bytes(row.path, row.image_sha256)
            yield ExportedSample(key=f"{number:08d}", data=data, suffix=Path(row.path).suffix, values=values)
            self._progress(number, len(self))

    @property
    def columns(self) -> tuple[ExportColumn, ...]:
        """The columns that have a value for at least one frame."""
        return tuple(column for column in COLUMNS if self.unknown[column.name] < len(self))

    def require_images(self, what: str) -> None:
        """Check that all frames are images.

        Raises:
            InputError: A frame is not an image.
        """
        if self.not_images:
            raise InputError("to", what, f"is for images, but a run has {self.not_images[0]}; use zarr or npz")

    def _rows(self) -> Iterator[tuple[Run, Row, dict[str, Any]]]:
        for folder, name in zip(self._folders, self.runs, strict=True):
            run = Run.open(folder)
            self.simulated.update(dict.fromkeys(run.info.simulated))
            if run.info.series_frames:
                self.series[name] = None
            for row in sorted(run.rows, key=lambda row: row.number):
                yield run, row, values_of(name, row, run.info)
