"""The runs of a study as one table of presses; readings stay on the disk until they are asked for."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.pressing import Pressing
from tacbench_cad.lab.analysis.published import variance_of
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run, find_runs
from tacbench_cad.lab.study.names import COMBINATIONS
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Ints

Chosen = Ints | Bools
#: What may be unknown of an imported press, and the field that has it: of its row, and of what was pressed.
_OF_ROWS = {"position": "position", "force": "force_level", "repeat": "repeat"}
_OF_PRINTS = {name: name for name in ("printer", "filament", "session")} | {"label": "texture", "print": "copy"}


def _of_print(name: str) -> cached_property[NDArray[Any]]:
    """What each press was made on: an attribute of the printed block."""

    def values(self: Collection) -> NDArray[Any]:
        words = [getattr(run.info.printed, name, None) for run in self.runs]
        if not all(isinstance(word, int) for word in words):
            words = [UNKNOWN if word is None else str(word) for word in words]
        return np.array(words)[self.run]

    return cached_property(values)


def _of_press(place: int) -> cached_property[NDArray[Any]]:
    """What each press was: an entry of its row's key."""

    def values(self: Collection) -> NDArray[Any]:
        return np.array([row.key[place] for row in self.rows], dtype=np.int64)

    return cached_property(values)


@dataclass(frozen=True, kw_only=True, eq=False)
class Collection:
    """Presses of one or many runs that may be compared: the same protocol, grid, kind of block and sensor.

    Every array has one entry a press, in the order of runs and then of press numbers.

    Args:
        runs: The runs.
        run: Index into ``runs``, shape (n,).
        number: Press number within the run, shape (n,).
        features: What is taken of a reading: its numbers, or how far the markers in its image moved.
    """

    runs: tuple[Run, ...]
    run: Ints
    number: Ints
    features: Literal["pixels", "markers"] = "pixels"

    @classmethod
    def open(cls, folders: Sequence[Path]) -> Collection:
        """Open the runs in, or below, some folders.

        Raises:
            InputError: There is no run, one cannot be read or has no press, two are of the same print, or two must not
                be mixed; the message names both and what differs.
        """
        runs = tuple(Run.open(folder) for folder in find_runs(folders))
        _require_mixable(runs)
        empty = next((run for run in runs if not run.rows), None)
        if empty is not None:
            raise InputError("run", str(empty.folder), "has no press yet; finish it or leave it out")
        numbers = [sorted(row.number for row in run.rows) for run in runs]
        collection = cls(
            runs=runs,
            run=np.repeat(np.arange(len(runs)), [len(presses) for presses in numbers]),
            number=np.concatenate([np.array(presses, dtype=np.int64) for presses in numbers]),
        )
        _ = collection.pressing  # refuses levels that contradict each other
        return collection

    def __len__(self) -> int:
        return len(self.run)

    def chosen(self, which: Chosen) -> Collection:
        """The presses at some indices, or where a mask is true."""
        return replace(self, run=self.run[which], number=self.number[which])

    def at_level(self, level: int) -> Collection:
        """The presses of one force level.

        Raises:
            InputError: There is none.
        """
        if level not in self.levels:
            raise InputError("force-level", level, f"the runs have {', '.join(map(str, self.levels))}")
        return self.chosen(self.level == level)

    @property
    def info(self) -> RunInfo:
        """What all runs have in common: the first one's."""
        return self.runs[0].info

    @cached_property
    def pressing(self) -> Pressing:
        """Where, how hard and how often the presses were made, as far as that is known."""
        return Pressing.of(self.runs)

    def has(self, what: str) -> bool:
        """Whether something is known of every press.

        Args:
            what: ``label``, ``printer``, ``filament``, ``print``, ``session``, ``position``, ``force`` or ``repeat``.
        """
        if what in _OF_ROWS:
            return all(getattr(row, _OF_ROWS[what]) is not None for run in self.runs for row in run.rows)
        return all(getattr(run.info.printed, _OF_PRINTS[what], None) is not None for run in self.runs)

    def require(self, purpose: str, *needed: str) -> None:
        """Refuse an analysis that needs what is unknown.

        Args:
            purpose: The analysis: ``the variance table``.
            needed: Words of :meth:`has`; of several in one word (``print or repeat``) one is enough.

        Raises:
            InputError: Something is unknown; the message says which column would be needed.
        """
        for words in needed:
            if not any(self.has(word) for word in words.split(" or ")):
                first = words.partition(" ")[0]
                raise InputError(
                    purpose,
                    None,
                    f"needs the {words} of every sample, which these runs do not have; import them with a column for "
                    f"it: --columns {first}=COLUMN",
                )

    @property
    def simulated(self) -> tuple[str, ...]:
        """What of any run was simulated, each once; empty for real data."""
        return tuple(dict.fromkeys(what for run in self.runs for what in run.info.simulated))

    @property
    def units(self) -> str:
        """The unit of a reading's numbers: ``counts`` for images, ``px`` for displacements of their markers."""
        return "px" if self.features == "markers" else str(self.info.sensor.get("units", "counts"))

    @cached_property
    def beside_paper(self) -> bool:
        """Whether they can stand beside the paper's: planned here, or of the paper's printers and textures by name."""
        return self.info.protocol is not None or any(
            variance_of(*map(str, names)) is not None
            for names in set(zip(self.printer.tolist(), self.filament.tolist(), self.texture.tolist(), strict=True))
        )

    @property
    def in_counts(self) -> bool:
        """Whether readings are counts of an image, as the paper's are."""
        return self.units == "counts"

    @cached_property
    def data_key(self) -> str:
        """Names the presses by the checksums of their readings."""
        digest = hashlib.sha256()
        for run, number in zip(self.run.tolist(), self.number.tolist(), strict=True):
            row = self._rows[run][number]
            digest.update(f"{self.runs[run].info.printed.name} {number} {row.image_sha256}\n".encode())
        return digest.hexdigest()

    #: Name of the texture, printer, filament, and both of these (``bambu-p1p_pla-minus``), each (n,).
    texture = _of_print("texture")
    printer = _of_print("printer")
    filament = _of_print("filament")
    combination = _of_print("combination")
    #: Name of the session in which a press was recorded, (n,).
    session = _of_print("session")
    #: Number of the print's copy, or what the prints are called where one has no number, (n,).
    copy = _of_print("copy")
    #: Force level and position, each from 1 or 0 where it is unknown, (n,).
    level = _of_press(0)
    position = _of_press(2)

    @cached_property
    def print_number(self) -> Ints:
        """The print's copy as a number from 1, (n,)."""
        if self.copy.dtype.kind == "i":
            return self.copy
        return np.unique(self.copy, return_inverse=True)[1] + 1

    @cached_property
    def repeat(self) -> Ints:
        """The repeat from 1, (n,). Where it is unknown, samples of one print, level and position are counted."""
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
        """The textures there are, sorted."""
        return tuple(str(value) for value in np.unique(self.texture))

    @property
    def combinations(self) -> tuple[str, ...]:
        """The printer-filament combinations there are: the paper's in its order, then others by name."""
        order = {f"{printer}_{filament}": i for i, (printer, filament) in enumerate(COMBINATIONS)}
        return tuple(sorted((str(value) for value in np.unique(self.combination)), key=lambda c: (order.get(c, 99), c)))

    @property
    def levels(self) -> tuple[int, ...]:
        """The force levels there are."""
        return tuple(int(value) for value in np.unique(self.level))

    def frame(self, index: int) -> Frame:
        """The reading of a press, as it was recorded.

        Raises:
            CheckFailedError: Its file is missing or damaged; the message names it.
        """
        run = int(self.run[index])
        return self.runs[run].frame(self._rows[run][int(self.number[index])])

    def path(self, index: int) -> str:
        """Where a press's reading lies, from its run folder: ``sensor_images/image_7.png``."""
        return self._rows[int(self.run[index])][int(self.number[index])].path

    @cached_property
    def _rows(self) -> list[dict[int, schema.Row]]:
        return [{row.number: row for row in run.rows} for run in self.runs]


def _require_mixable(runs: Sequence[Run]) -> None:
    """Refuse runs that cannot stand in one table.

    Raises:
        InputError: Two runs are of the same print, or differ in what makes presses comparable.
    """
    first = runs[0]
    seen: dict[str, Run] = {}
    for run in runs:
        known = _common(first.info)
        for what, value in _common(run.info).items():
            expected = known.get(what, value)  # of an imported run, the block may be known in one and not in another
            if value != expected:
                raise InputError(
                    what, value, f"in {run.folder}, but {expected!r} in {first.folder}; analyse them apart"
                )
        name = run.info.printed.name
        if name in seen:
            raise InputError("run", str(run.folder), f"is of the same print as {seen[name].folder}: {name}")
        seen[name] = run


def _common(info: RunInfo) -> dict[str, object]:
    """What must be equal for presses to be comparable."""
    block, protocol, common = info.printed.block, info.protocol, dict[str, object]()
    if protocol is not None:
        levels = "forces_n" if protocol.contact == "force" else "depths_mm"
        common = {"contact": protocol.contact, levels: list(getattr(protocol, levels))}
        common["grid"] = [[round(place, 9) for place in line] for line in (protocol.grid.x_mm, protocol.grid.y_mm)]
    if block is not None:
        common |= {"block size": [round(side, 9) for side in block.size_mm]}
        common |= {"preset": block.preset, "scale": block.scale}
    return {
        "protocol": "none" if protocol is None else "planned",
        **common,
        "sensor": info.sensor.get("name"),
        "sensor shape": list(info.frame_shape or ()),
        "sensor units": info.sensor.get("units"),
    }
