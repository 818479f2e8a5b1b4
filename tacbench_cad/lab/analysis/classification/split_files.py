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
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from tacbench_cad.lab.analysis.classification.splits import FOLDS, PressTable, folds_of, levels_of
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import replacing
from tacbench_cad.util.text import natural
from tacbench_cad.util.untrusted import read_document

#: The schema of a split file, and the version that this program reads and writes.
SCHEMA, SCHEMA_VERSION = "tacbench-split", 1

#: The key of a press: the name of its run, force level, repeat, position.
Key = tuple[str, int, int, int]


@dataclass(frozen=True, kw_only=True)
class SplitPress:
    """One press of a split: its run and press key, the texture to predict, and the checksum of its frame."""

    run: str
    force_level: int
    repeat: int
    position: int
    texture: str
    image_sha256: str

    @property
    def key(self) -> Key:
        """The name of the run, force level, repeat and position."""
        return (self.run, self.force_level, self.repeat, self.position)


#: The columns of a press's entry.
PRESS_COLUMNS = tuple(field.name for field in fields(SplitPress))


@dataclass(frozen=True, kw_only=True)
class SplitFold:
    """One fold of a split.

    Args:
        name: The held-out group: ``copy 2``.
        train: The indices of the training presses.
        test: The indices of the presses to predict.
    """

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
        unknown_groups: See :attr:`.Collection.unknown_groups`.

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
        _once("presses", (named(press.key) for press in self.presses))
        _once("folds", (fold.name for fold in self.folds))
        count = len(self.presses)
        for fold in self.folds:
            for what, indices in (("train", fold.train), ("test", fold.test)):
                where = f"fold {fold.name} {what}"
                if not indices:
                    raise InputError(where, None, "is empty")
                if not 0 <= min(indices) <= max(indices) < count:
                    raise InputError(where, None, f"must be whole numbers from 0 to {count - 1}")
                _once(where, map(str, indices))
            both = set(fold.train) & set(fold.test)
            if both:
                press = named(self.presses[min(both)].key)
                what = f"must not be both in train and in test; this fold has {len(both)} of these presses"
                raise InputError(f"fold {fold.name}", press, what)

    @cached_property
    def textures(self) -> tuple[str, ...]:
        """The names of the textures, sorted."""
        return tuple(sorted({press.texture for press in self.presses}, key=natural))

    @cached_property
    def design_sha256(self) -> str:
        """The hash of the design, which the splits of two sensors can have in common."""
        presses = [[*press.key, press.texture] for press in self.presses]
        folds = [astuple(fold) for fold in self.folds]
        return _hash([SCHEMA, SCHEMA_VERSION, self.hold_out, self.seed, presses, folds])

    @cached_property
    def data_sha256(self) -> str:
        """The hash of the data, including the frames."""
        return _hash([[*press.key, press.image_sha256] for press in self.presses])

    @property
    def protocol(self) -> str:
        """The name of the split for citations: ``tacbench-split/1:copy:0123456789ab``."""
        return f"{SCHEMA}/{SCHEMA_VERSION}:{self.hold_out}:{self.design_sha256[:12]}"

    def document(self) -> dict[str, Any]:
        """Return the document of the split file."""
        plain = to_plain(self)
        return {
            "schema": SCHEMA,
            "version": SCHEMA_VERSION,
            "protocol": self.protocol,
            **{name: plain[name] for name in ("hold_out", "seed", "simulated", "unknown_groups")},
            **{name: getattr(self, name) for name in ("design_sha256", "data_sha256")},
            "textures": list(self.textures),
            "columns": list(PRESS_COLUMNS),
            "presses": [list(press.values()) for press in plain["presses"]],
            "folds": plain["folds"],
        }


def named(key: Key) -> str:
    """Return the name of a press in words: ``RUN force level 2 repeat 1 position 13``."""
    run, level, repeat, position = key
    return f"{run} force level {level} repeat {repeat} position {position}"


def split_presses(collection: Collection) -> tuple[SplitPress, ...]:
    """Return the presses of a collection for a split, in the order of the collection."""
    names = [run.info.printed.name for run in collection.runs]
    return tuple(
        SplitPress(
            run=names[run],
            **dict(zip(("force_level", "repeat", "position"), row.key, strict=True)),
            texture=texture,
            image_sha256=row.image_sha256,
        )
        for run, row, texture in zip(collection.run.tolist(), collection.rows, collection.texture.tolist(), strict=True)
    )


def make_splits(
    collection: Collection, levels: Sequence[str] | None = None, *, seed: int = 0, folds: int = FOLDS
) -> tuple[tuple[Split, ...], tuple[str, ...]]:
    """Make the splits of a study, one for each hold-out level.

    Args:
        collection: The study.
        levels: The hold-out levels; None for the default levels of the study.
        seed: The seed that assigns presses and positions to folds.
        folds: The number of folds of presses and of positions.

    Returns:
        The splits of the levels that the data support, and notes on left-out levels and presses with the reasons.

    Raises:
        InputError: A level is unknown, or the data support none; see
            :func:`tacbench_cad.lab.analysis.classification.splits.folds_of`.
    """
    collection.require("a split", "label")
    drawn = folds_of(PressTable.of(collection), levels or levels_of(collection), seed=seed, folds=folds)
    presses = split_presses(collection)
    splits = []
    for level in drawn.levels:
        mine = [fold for fold in drawn.folds if fold.hold_out == level]
        of_level = tuple(
            SplitFold(
                name=fold.group or f"{level} fold {i}",
                train=tuple(fold.train.tolist()),
                test=tuple(fold.test.tolist()),
            )
            for i, fold in enumerate(mine, start=1)
        )
        splits.append(
            Split(
                hold_out=level,
                seed=seed,
                presses=presses,
                folds=of_level,
                simulated=collection.simulated,
                unknown_groups=collection.unknown_groups,
            )
        )
    return tuple(splits), drawn.notes


def write_split(path: Path, split: Split) -> Path:
    """Write a split file, completely or not at all. Equal splits give equal bytes.

    Raises:
        InputError: The file cannot be written.
    """
    lines = [f" {json.dumps(name)}: {_value(name, value)}" for name, value in split.document().items()]
    with replacing(path) as temporary:
        temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8", newline="\n")
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
    plain = {field.name: document[field.name] for field in fields(Split) if field.name in document}
    try:
        plain["presses"] = [dict(zip(PRESS_COLUMNS, press, strict=True)) for press in document["presses"]]
    except (KeyError, TypeError, ValueError) as error:
        allowed = f"each press must have {len(PRESS_COLUMNS)} values ({', '.join(PRESS_COLUMNS)}): {error}"
        raise InputError(f"{path}: presses", None, allowed) from None
    split = from_plain(Split, plain, f"{path}: ")
    for name in ("design_sha256", "data_sha256"):
        if document.get(name) != getattr(split, name):
            allowed = 'does not match the contents of the file, which was changed; write it with "tacbench split" again'
            raise InputError(f"{path}: {name}", document.get(name), allowed)
    return split


def _value(name: str, value: Any) -> str:
    """Return a value as JSON; lists of presses and folds have a line for each item."""
    if name in ("presses", "folds"):
        return "[\n" + ",\n".join(f"  {json.dumps(item, separators=(',', ':'))}" for item in value) + "\n ]"
    return json.dumps(value)


def _once(where: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(where, name, "occurs twice")
        seen.add(name)


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, separators=(",", ":")).encode()).hexdigest()
