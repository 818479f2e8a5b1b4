"""Split files: lists of training and test presses, with which any classifier can be scored.

A split file is a JSON document that can be read without this program. It lists all presses, each with its run, press
key, texture and the SHA-256 of its frame's file. Its folds refer to the presses by index. The file has two hashes:

* ``design_sha256`` is the hash of hold-out level, seed, run names, press keys, textures and folds. It is equal for two
  sensors that pressed the same prints in the same way, so their scores can be compared.
* ``data_sha256`` is the hash of run names, press keys and the checksums of the frames. It identifies the data of one
  sensor.

``protocol`` is ``tacbench-split/1:LEVEL:`` followed by the first twelve digits of ``design_sha256``. Papers can cite
it.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from tacbench_cad.lab.analysis.classification.hold_out import FOLDS, folds_of, levels_of
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import sha256, write_text
from tacbench_cad.util.text import natural
from tacbench_cad.util.untrusted import read_document

#: The schema of a split file, and the version that this program reads and writes.
SCHEMA, SCHEMA_VERSION = "tacbench-split", 1


class SplitPress(NamedTuple):
    """One press of a split: its run and press key, the texture to predict, and the checksum of its frame."""

    run: str
    force_level: int
    repeat: int
    position: int
    texture: str
    image_sha256: str


#: The columns that identify a press.
KEY = SplitPress._fields[:4]


class SplitFold(NamedTuple):
    """One fold of a split: the name of the held-out group, ``copy 2``, and the indices of its presses."""

    name: str
    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Split:
    """A split of a study's presses.

    Args:
        hold_out: The hold-out level of the folds.
        seed: The seed of random folds.
        presses: The presses.
        folds: The folds.
        simulated: The simulated parts of the study.
        unknown_groups: See :attr:`.Design.unknown_groups`.

    Raises:
        InputError: A press or a fold occurs twice, a fold has an unknown press or no training or test presses, or a
            press is in both sets of a fold.
    """

    hold_out: str
    seed: int
    presses: tuple[SplitPress, ...]
    folds: tuple[SplitFold, ...]
    simulated: tuple[str, ...] = ()
    unknown_groups: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.folds:
            raise InputError("folds", None, "must have at least one fold")
        _require_once("presses", map(named, self.presses))
        _require_once("folds", [fold.name for fold in self.folds])
        for name, train, test in self.folds:
            where, last = f"fold {name}", len(self.presses) - 1
            if not train or not test:
                raise InputError(where, None, "must have presses both in train and in test")
            if not 0 <= min(train + test) <= max(train + test) <= last:
                raise InputError(where, None, f"train and test must be whole numbers from 0 to {last}")
            if len({*train, *test}) < len(train) + len(test):
                press = next(press for press, count in Counter(train + test).items() if count > 1)
                raise InputError(where, named(self.presses[press]), "must not be twice in train and test")

    @cached_property
    def textures(self) -> tuple[str, ...]:
        """The names of the textures, sorted."""
        return tuple(sorted({press.texture for press in self.presses}, key=natural))

    @cached_property
    def design_sha256(self) -> str:
        """The hash of the design, which the splits of two sensors can have in common."""
        presses = [press[:5] for press in self.presses]
        return _hash([SCHEMA, SCHEMA_VERSION, self.hold_out, self.seed, presses, self.folds])

    @cached_property
    def data_sha256(self) -> str:
        """The hash of the data, including the frames."""
        return _hash([[*press[:4], press.image_sha256] for press in self.presses])

    @property
    def protocol(self) -> str:
        """The name of the split for citations: ``tacbench-split/1:copy:0123456789ab``."""
        return f"{SCHEMA}/{SCHEMA_VERSION}:{self.hold_out}:{self.design_sha256[:12]}"

    def document(self) -> dict[str, Any]:
        """Return the document of the split file."""
        names = ("protocol", "hold_out", "seed", "simulated", "unknown_groups", "design_sha256", "data_sha256")
        return {
            "schema": SCHEMA,
            "version": SCHEMA_VERSION,
            **{name: getattr(self, name) for name in (*names, "textures")},
            "columns": SplitPress._fields,
            "presses": self.presses,
            "folds": [fold._asdict() for fold in self.folds],
        }


def named(press: Sequence[Any]) -> str:
    """Return the name of a press in words: ``RUN force level 2 repeat 1 position 13``."""
    run, level, repeat, position = press[:4]
    return f"{run} force level {level} repeat {repeat} position {position}"


def make_splits(
    presses: pd.DataFrame, levels: Sequence[str] | None = None, *, seed: int = 0, folds: int = FOLDS
) -> tuple[tuple[Split, ...], tuple[str, ...]]:
    """Make the splits of a study, one for each hold-out level.

    Args:
        presses: The table from :func:`tacbench_cad.lab.read`.
        levels: The hold-out levels; None for the default levels of the study.
        seed: The seed that assigns presses and positions to folds.
        folds: The number of folds of presses and of positions.

    Returns:
        The splits of the levels that the data support, and notes on left-out levels and presses with the reasons.

    Raises:
        InputError: A level is unknown, or the data support none; see :func:`.hold_out.folds_of`.
    """
    design = Design.of(presses)
    design.require("a split", "label")
    divided = folds_of(design, levels or levels_of(design), seed=seed, folds=folds)
    table = design.first_steps.assign(force_level=design.first_steps["level"])
    unknown = table["image_sha256"].isna()
    table.loc[unknown, "image_sha256"] = [sha256(Path(frame)) for frame in table.loc[unknown, "frame"]]
    columns = [table[name].tolist() for name in SplitPress._fields]
    how: dict[str, Any] = {"seed": seed, "simulated": design.simulated, "unknown_groups": design.unknown_groups}
    splits = []
    for level in divided.levels:
        mine = [fold for fold in divided.folds if fold.hold_out == level]
        named_folds = tuple(
            SplitFold(fold.group or f"{level} fold {i}", tuple(fold.train.tolist()), tuple(fold.test.tolist()))
            for i, fold in enumerate(mine, start=1)
        )
        splits.append(Split(hold_out=level, presses=tuple(map(SplitPress, *columns)), folds=named_folds, **how))
    return tuple(splits), divided.notes


def write_split(path: Path, split: Split) -> Path:
    """Write a split file, completely or not at all. Equal splits give equal bytes.

    Raises:
        InputError: The file cannot be written.
    """
    lines = []
    for name, value in split.document().items():
        text = json.dumps(value)
        if name in ("presses", "folds"):  # a line for each
            text = "[\n" + ",\n".join(f"  {json.dumps(item, separators=(',', ':'))}" for item in value) + "\n ]"
        lines.append(f" {json.dumps(name)}: {text}")
    write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")
    return path


def read_split(path: Path) -> Split:
    """Read a split file.

    Raises:
        InputError: The file cannot be read, has another schema or version, or its hashes do not match its contents.
    """
    document = read_document(path, "split", "json")
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise InputError("split", str(path), f'is not a split file: "schema" must be "{SCHEMA}"')
    if document.get("version") != SCHEMA_VERSION:
        version = f"has version {document.get('version')!r}, but this program reads version {SCHEMA_VERSION}"
        raise InputError("split", str(path), version)
    fields = Split.__dataclass_fields__
    split = from_plain(Split, {name: value for name, value in document.items() if name in fields}, f"{path}: ")
    for name in ("design_sha256", "data_sha256"):
        if document.get(name) != getattr(split, name):
            allowed = 'does not match the contents of the file, which was changed; write it with "tacbench split" again'
            raise InputError(f"{path}: {name}", document.get(name), allowed)
    return split


def _require_once(where: str, names: Iterable[str]) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(where, twice[0], "occurs twice")


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, separators=(",", ":")).encode()).hexdigest()
