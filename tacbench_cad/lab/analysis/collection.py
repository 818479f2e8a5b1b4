"""The runs of a study as one table of presses. Frames are read from the disk only when they are needed."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.comparable import require_comparable
from tacbench_cad.lab.analysis.pressing import Pressing
from tacbench_cad.lab.analysis.published import variance_of
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run, find_runs
from tacbench_cad.lab.runs.series import series_rows
from tacbench_cad.lab.study.names import COMBINATIONS
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import natural_unique
from tacbench_cad.util.types import Bools, Floats, Ints

Chosen = Ints | Bools
#: The facts that may be unknown for an imported press, with their fields: in its row, and in the printed block.
_OF_ROWS = {"position": "position", "force": "force_level", "repeat": "repeat"}
_OF_PRINTS = {name: name for name in ("printer", "filament", "session")} | {"label": "texture", "print": "copy"}


def _of_print(name: str) -> cached_property[NDArray[Any]]:
    """Return a property with an attribute of the printed block for each press."""

    def values(self: Collection) -> NDArray[Any]:
        words = [getattr(run.info.printed, name, None) for run in self.runs]
        if not all(isinstance(word, int) for word in words):
            words = [UNKNOWN if word is None else str(word) for word in words]
        return np.array(words)[self.run]

    return cached_property(values)


def _of_press(place: int) -> cached_property[NDArray[Any]]:
    """Return a property with one entry of the row's key for each press."""

    def values(self: Collection) -> NDArray[Any]:
        return np.array([row.key[place] for row in self.rows], dtype=np.int64)

    return cached_property(values)


@dataclass(frozen=True, kw_only=True, eq=False)
class Courses:
    """The times and positions of the series of n presses, with T frames each.

    Args:
        digests: A checksum of the frames and forces of each series.
        time_s: The time since the first frame, (n, T).
        pose_mm: The position of the sensor, (n, T, 3).
    """

    digests: list[bytes]
    time_s: Floats
    pose_mm: Floats

    @property
    def distance_mm(self) -> Floats:
        """The distance of the sensor from its position in the first frame, (n, T)."""
        return np.asarray(np.linalg.norm(self.pose_mm - self.pose_mm[:, :1], axis=2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Collection:
    """The presses of one or several comparable runs: same protocol, grid, size and preset of the block, and sensor.

    Every array has one entry for each press, sorted by run and then by press number.

    Args:
        runs: The runs.
        run: The index into ``runs``, shape (n,).
        number: The press number within the run, shape (n,).
        series: Whether the series of moving frames of each press are analysed instead of the frames of the presses.
        frames: The number of frames that are used from the start of each series; None for all.
    """

    runs: tuple[Run, ...]
    run: Ints
    number: Ints
    series: bool = False
    frames: int | None = None

    @classmethod
    def open(cls, folders: Sequence[Path]) -> Collection:
        """Open the runs in the given folders and in their subfolders.

        Raises:
            InputError: There is no run, a run cannot be read or has no press, two runs have the same print, or two runs
                are not comparable. The message names both runs and the difference.
        """
        runs = tuple(Run.open(folder) for folder in find_runs(folders))
        require_comparable(runs)
        empty = next((run for run in runs if not run.rows), None)
        if empty is not None:
            raise InputError("run", str(empty.folder), "has no press yet; finish it or leave it out")
        numbers = [sorted(row.number for row in run.rows) for run in runs]
        collection = cls(
            runs=runs,
            run=np.repeat(np.arange(len(runs)), [len(presses) for presses in numbers]),
            number=np.concatenate([np.array(presses, dtype=np.int64) for presses in numbers]),
        )
        _ = collection.pressing  # checks that the force levels of the runs agree
        return collection

    def __len__(self) -> int:
        return len(self.run)

    def chosen(self, which: Chosen) -> Collection:
        """Return the presses at some indices, or where a mask is true."""
        return replace(self, run=self.run[which], number=self.number[which])

    def at_level(self, level: int) -> Collection:
        """Return the presses at one force level.

        Raises:
            InputError: No press has this level.
        """
        if level not in self.levels:
            raise InputError("force-level", level, f"must be a level of the runs: {', '.join(map(str, self.levels))}")
        return self.chosen(self.level == level)

    def viewed(self, series: bool, frames: int | None = None) -> Collection:
        """Return the same presses, with or without the series of moving frames.

        Args:
            series: See :class:`Collection`.
            frames: See :class:`Collection`.

        Raises:
            InputError: A run has no series, two runs have different motions, or the series have fewer frames.
        """
        for run in self.runs if series else ():
            if not run.info.series_frames:
                what = "has no series of frames: its protocol has no motion, or it was imported; leave out --series"
                raise InputError("run", str(run.folder), what)
            motion, first = (info.protocol and info.protocol.motion for info in (run.info, self.info))
            if motion != first:
                other = f"in {run.folder}, but {first} in {self.runs[0].folder}"
                raise InputError("motion", str(motion), f"{other}; analyse the series of these runs separately")
        if frames is not None and not 1 <= frames <= self.info.series_frames:
            raise InputError("frames", frames, f"must be from 1 to {self.info.series_frames}, the length of a series")
        return replace(self, series=series, frames=frames)

    @property
    def info(self) -> RunInfo:
        """The information of the first run, for facts that all runs have in common."""
        return self.runs[0].info

    @cached_property
    def pressing(self) -> Pressing:
        """The known positions, forces and repeats of the presses."""
        return Pressing.of(self.runs)

    def has(self, what: str) -> bool:
        """Whether a fact is known for every press.

        Args:
            what: The fact: ``label``, ``printer``, ``filament``, ``print``, ``session``, ``position``, ``force`` or
                ``repeat``.
        """
        if what in _OF_ROWS:
            return all(getattr(row, _OF_ROWS[what]) is not None for run in self.runs for row in run.rows)
        return all(getattr(run.info.printed, _OF_PRINTS[what], None) is not None for run in self.runs)

    @property
    def unknown_groups(self) -> tuple[str, ...]:
        """The unknown groups of imported samples, of ``prints`` and ``sessions``; empty for runs of a protocol."""
        if self.info.protocol is not None:
            return ()
        return tuple(f"{group}s" for group in ("print", "session") if not self.has(group))

    def require(self, purpose: str, *needed: str) -> None:
        """Check that the facts are known that an analysis needs.

        Args:
            purpose: The analysis: ``the variance table``.
            needed: Facts as in :meth:`has`. An argument such as ``print or repeat`` needs only one of its facts.

        Raises:
            InputError: A fact is unknown. The message says which column is missing.
        """
        for words in needed:
            if not any(self.has(word) for word in words.split(" or ")):
                first = words.partition(" ")[0]
                raise InputError(
                    purpose,
                    None,
                    f"needs the {words} of every sample, which is unknown for these runs; import them with a column "
                    f"for it: --columns {first}=COLUMN",
                )

    @property
    def simulated(self) -> tuple[str, ...]:
        """The simulated parts of the runs, each part once; empty for real data."""
        return tuple(dict.fromkeys(what for run in self.runs for what in run.info.simulated))

    @property
    def units(self) -> str:
        """The unit of the sensor's frames: ``counts`` for images."""
        return str(self.info.sensor.get("units", "counts"))

    @cached_property
    def beside_paper(self) -> bool:
        """Whether a comparison with the paper makes sense.

        It does if the runs follow a protocol, or if the paper has a figure for one of their printers, filaments and
        textures. It never does for series, because the paper's sensor did not move in contact.
        """
        if self.series:
            return False
        return self.info.protocol is not None or any(
            variance_of(*map(str, names)) is not None
            for names in set(zip(self.printer.tolist(), self.filament.tolist(), self.texture.tolist(), strict=True))
        )

    @property
    def in_counts(self) -> bool:
        """Whether the frames have counts of images, as in the paper."""
        return self.units == "counts"

    @cached_property
    def data_key(self) -> str:
        """A checksum that identifies the presses and their frames, or their series."""
        digest = hashlib.sha256()
        for index, (run, number) in enumerate(zip(self.run.tolist(), self.number.tolist(), strict=True)):
            row = self._rows[run][number]
            digest.update(f"{self.runs[run].info.printed.name} {number} {row.image_sha256}\n".encode())
            if self.series:
                digest.update(self.courses.digests[index])
        return digest.hexdigest()

    #: The names of the texture, the printer, the filament, and printer_filament (``bambu-p1p_pla-minus``), each (n,).
    texture = _of_print("texture")
    printer = _of_print("printer")
    filament = _of_print("filament")
    combination = _of_print("combination")
    #: The name of the session in which a press was recorded, (n,).
    session = _of_print("session")
    #: The copy number of the print, or the names of the prints if some have no number, (n,).
    copy = _of_print("copy")
    #: The force level and the position, each from 1, or 0 if unknown, (n,).
    level = _of_press(0)
    position = _of_press(2)

    @cached_property
    def print_number(self) -> Ints:
        """The copy of the print as a number from 1, (n,)."""
        if self.copy.dtype.kind == "i":
            return self.copy
        return np.unique(self.copy, return_inverse=True)[1] + 1

    @cached_property
    def repeat(self) -> Ints:
        """The repeat from 1, (n,). If it is unknown, the samples of one print, level and position are numbered."""
        if self.info.protocol is not None:
            return np.array([row.key[1] for row in self.rows], dtype=np.int64)
        counts: Counter[tuple[Any, ...]] = Counter()
        repeats = []
        columns = (self.combination, self.texture, self.copy, self.level, self.position)
        for key in zip(*(column.tolist() for column in columns), strict=True):
            counts[key] += 1
            repeats.append(counts[key])
        return np.array(repeats, dtype=np.int64)

    @property
    def rows(self) -> list[schema.Row]:
        """The row of each press."""
        pairs = zip(self.run.tolist(), self.number.tolist(), strict=True)
        return [self._rows[run][number] for run, number in pairs]

    @property
    def textures(self) -> tuple[str, ...]:
        """The names of the textures in natural order: ``material-2`` before ``material-10``."""
        return tuple(natural_unique(self.texture)[0].tolist())

    @property
    def combinations(self) -> tuple[str, ...]:
        """The printer-filament combinations: first the paper's, in its order, then others by name."""
        order = {f"{printer}_{filament}": i for i, (printer, filament) in enumerate(COMBINATIONS)}
        names = natural_unique(self.combination)[0].tolist()
        return tuple(sorted(names, key=lambda name: order.get(name, 99)))

    @property
    def levels(self) -> tuple[int, ...]:
        """The force levels, sorted."""
        return tuple(int(value) for value in np.unique(self.level))

    def frame(self, index: int) -> Frame:
        """Return the frame of a press, as it was recorded.

        Raises:
            CheckFailedError: The file is missing or damaged; the message names it.
        """
        run = int(self.run[index])
        return self.runs[run].frame(self._rows[run][int(self.number[index])])

    def paths(self, index: int) -> tuple[str, ...]:
        """Return the paths of the files of a press that are analysed, relative to its run folder.

        These are the frame of the press (``sensor_images/image_7.png``), or all frames of its series
        (``series/press_7/frame_01.png`` and so on).
        """
        run, number = int(self.run[index]), int(self.number[index])
        if not self.series:
            return (self._rows[run][number].path,)
        folder = schema.series_folder(number)
        count, suffix = self.info.series_frames, Path(self._rows[run][number].path).suffix
        used = range(1, (self.frames or count) + 1)
        return tuple(f"{folder}/{schema.moving_name(i, count, suffix)}" for i in used)

    @cached_property
    def courses(self) -> Courses:
        """The times and positions of all series. This reads the table of each series.

        Raises:
            CheckFailedError: A table is missing or incomplete.
            InputError: A table cannot be read.
        """
        count = self.frames or self.info.series_frames
        courses = Courses(digests=[], time_s=np.empty((len(self), count)), pose_mm=np.empty((len(self), count, 3)))
        for index in range(len(self)):
            rows = self.moving(index)
            text = "".join(f"{row.sha256} {row.force_n}\n" for row in rows)
            courses.digests.append(hashlib.sha256(text.encode()).digest())
            courses.time_s[index] = [row.time_s for row in rows]
            courses.pose_mm[index] = [row.pose_mm for row in rows]
        return courses

    def moving(self, index: int) -> tuple[schema.MovingRow, ...]:
        """Return the rows of the used part of a press's series: the time, the pose and the force of each frame.

        Raises:
            CheckFailedError: The table is missing, damaged or incomplete.
            InputError: The table cannot be read.
        """
        run, number = int(self.run[index]), int(self.number[index])
        return series_rows(self.runs[run].folder, number, self.info.series_frames)[: self.frames]

    @cached_property
    def _rows(self) -> list[dict[int, schema.Row]]:
        return [{row.number: row for row in run.rows} for run in self.runs]
