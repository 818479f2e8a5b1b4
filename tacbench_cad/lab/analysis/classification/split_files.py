"""Split files: which presses are trained on and which are tested on, so that anybody's classifier can be scored.

A split file is one JSON document that needs nothing of ours to be read: the presses once, each with its run, press key,
texture and the SHA-256 of its reading's file, and folds that name them by their index. It carries two hashes:

* ``design_sha256`` of rung, seed, run names, press keys, textures and folds. Two sensors that pressed the same prints
  in the same way have the same one, so their scores stand on the same split;
* ``data_sha256`` of run names, press keys and checksums of the readings. It is that of one sensor's data alone.

``protocol`` is ``tacbench-split/1:RUNG:`` and the first twelve digits of the former: what a paper names.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.splits import FOLDS, RUNGS, ladder
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import replacing

#: What a split file calls itself, and the version of its layout that this program writes and reads.
SCHEMA = "tacbench-split"
#: The version of a split file's layout.
SCHEMA_VERSION = 1
#: What stands in a press's entry.
PRESS_COLUMNS = ("run", "force_level", "repeat", "position", "texture", "image_sha256")

#: A press: name of its run, force level, repeat, position.
Key = tuple[str, int, int, int]


@dataclass(frozen=True, kw_only=True)
class SplitPress:
    """One press of a split.

    Args:
        key: Name of its run, force level, repeat, position.
        texture: The texture that was pressed: what is to be predicted.
        image_sha256: SHA-256 of its reading's file.
    """

    key: Key
    texture: str
    image_sha256: str


@dataclass(frozen=True, kw_only=True)
class SplitFold:
    """One fold of a split.

    Args:
        name: What is held out: ``copy 2``.
        train: Indices of the presses that may be learnt from.
        test: Indices of the presses to predict.
    """

    name: str
    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Split:
    """A split of a study's presses.

    Args:
        rung: What its folds hold out.
        seed: Seed of what is random in it.
        presses: The presses.
        folds: The folds.
        simulated: What of the study was simulated.

    Raises:
        InputError: A press or a fold stands there twice, or a fold names a press that is not there, tests nothing,
            trains on nothing, or tests on what it trains on.
    """

    rung: str
    seed: int
    presses: tuple[SplitPress, ...]
    folds: tuple[SplitFold, ...]
    simulated: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.folds:
            raise InputError("folds", None, "there is none")
        _once("presses", (named(one.key) for one in self.presses))
        _once("folds", (one.name for one in self.folds))
        count = len(self.presses)
        for fold in self.folds:
            for what, indices in (("train", fold.train), ("test", fold.test)):
                where = f"fold {fold.name} {what}"
                if not indices:
                    raise InputError(where, None, "is empty")
                wrong = next((i for i in indices if isinstance(i, bool) or not isinstance(i, int)), None)
                if wrong is not None or not 0 <= min(indices) <= max(indices) < count:
                    raise InputError(where, wrong, f"must be whole numbers from 0 to {count - 1}")
                _once(where, map(str, indices))
            both = set(fold.train) & set(fold.test)
            if both:
                press = named(self.presses[min(both)].key)
                raise InputError(f"fold {fold.name}", press, f"is trained on and tested ({len(both)} such presses)")

    @cached_property
    def textures(self) -> tuple[str, ...]:
        """The textures there are, sorted."""
        return tuple(sorted({one.texture for one in self.presses}))

    @cached_property
    def design_sha256(self) -> str:
        """Hash of what two sensors' splits have in common."""
        presses = [[*one.key, one.texture] for one in self.presses]
        folds = [[one.name, one.train, one.test] for one in self.folds]
        return _hash([SCHEMA, SCHEMA_VERSION, self.rung, self.seed, presses, folds])

    @cached_property
    def data_sha256(self) -> str:
        """Hash of what was split, readings included."""
        return _hash([[*one.key, one.image_sha256] for one in self.presses])

    @property
    def protocol(self) -> str:
        """What a paper names: ``tacbench-split/1:copy:0123456789ab``."""
        return f"{SCHEMA}/{SCHEMA_VERSION}:{self.rung}:{self.design_sha256[:12]}"

    def as_dict(self) -> dict[str, Any]:
        """The document of the split file."""
        return {
            "schema": SCHEMA,
            "version": SCHEMA_VERSION,
            "protocol": self.protocol,
            "rung": self.rung,
            "seed": self.seed,
            "simulated": list(self.simulated),
            "design_sha256": self.design_sha256,
            "data_sha256": self.data_sha256,
            "textures": list(self.textures),
            "columns": list(PRESS_COLUMNS),
            "presses": [[*one.key, one.texture, one.image_sha256] for one in self.presses],
            "folds": [{"name": one.name, "train": list(one.train), "test": list(one.test)} for one in self.folds],
        }


def named(key: Key) -> str:
    """A press in words: ``RUN force level 2 repeat 1 position 13``."""
    run, level, repeat, position = key
    return f"{run} force level {level} repeat {repeat} position {position}"


def split_presses(collection: Collection) -> tuple[SplitPress, ...]:
    """The presses of a collection as a split names them, in its order."""
    presses = []
    rows = [run.by_key for run in collection.runs]
    names = [run.info.printed.name for run in collection.runs]
    keys = np.stack([collection.run, collection.level, collection.repeat, collection.position], axis=1)
    for (run, level, repeat, position), texture in zip(keys.tolist(), collection.texture.tolist(), strict=True):
        row = rows[run][level, repeat, position]
        key = (names[run], level, repeat, position)
        presses.append(SplitPress(key=key, texture=texture, image_sha256=row.image_sha256))
    return tuple(presses)


def make_splits(
    collection: Collection, rungs: Sequence[str] = RUNGS, *, seed: int = 0, folds: int = FOLDS
) -> tuple[tuple[Split, ...], tuple[str, ...]]:
    """The splits of a study, one a rung of the ladder.

    Args:
        collection: The study.
        rungs: Which rungs.
        seed: Draws presses and positions into folds.
        folds: Folds of presses and of positions.

    Returns:
        The splits of the rungs that the data support, and what is left out, each with the reason.

    Raises:
        InputError: A rung is unknown, or the data support none; see
            :func:`tacbench_cad.lab.analysis.classification.splits.ladder`.
    """
    found = ladder(collection, rungs, seed=seed, folds=folds)
    presses = split_presses(collection)
    splits = []
    for rung in found.rungs:
        of_rung = tuple(
            SplitFold(
                name=one.held_out or f"{rung} fold {i}",
                train=tuple(one.train.tolist()),
                test=tuple(one.test.tolist()),
            )
            for i, one in enumerate(found.of(rung), start=1)
        )
        splits.append(Split(rung=rung, seed=seed, presses=presses, folds=of_rung, simulated=collection.simulated))
    return tuple(splits), found.notes


def write_split(path: Path, split: Split) -> Path:
    """Write a split file, whole or not at all. The same split gives the same bytes.

    Raises:
        InputError: The file cannot be written.
    """
    lines = [f" {json.dumps(name)}: {_value(name, value)}" for name, value in split.as_dict().items()]
    with replacing(path) as temporary:
        temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8", newline="\n")
    return path


def read_split(path: Path) -> Split:
    """Read a split file.

    Raises:
        InputError: It cannot be read, is of another kind or version, or does not have the hashes that it names.
    """
    try:
        document = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError("split", str(path), f"cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError("split", str(path), "is not valid JSON") from None
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise InputError("split", str(path), f'is no split file: "schema" must be "{SCHEMA}"')
    if document.get("version") != SCHEMA_VERSION:
        wanted = f"has version {document.get('version')!r}, this program reads {SCHEMA_VERSION}"
        raise InputError("split", str(path), wanted)
    try:
        split = Split(
            rung=str(document["rung"]),
            seed=int(document["seed"]),
            presses=tuple(_press(one) for one in document["presses"]),
            folds=tuple(
                SplitFold(name=str(one["name"]), train=tuple(one["train"]), test=tuple(one["test"]))
                for one in document["folds"]
            ),
            simulated=tuple(document["simulated"]),
        )
        hashes = {name: document[name] for name in ("design_sha256", "data_sha256")}
    except InputError as error:
        raise InputError(f"{path}: {error.field}", error.value, error.allowed) from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("split", str(path), f"holds a wrong or missing value: {error!r}") from None
    for name, value in hashes.items():
        if value != getattr(split, name):
            raise InputError(f"{path}: {name}", value, "is not the hash of what stands in the file: it was changed")
    return split


def _press(entry: Sequence[Any]) -> SplitPress:
    run, level, repeat, position, texture, digest = entry
    key = (str(run), int(level), int(repeat), int(position))
    return SplitPress(key=key, texture=str(texture), image_sha256=str(digest))


def _value(name: str, value: Any) -> str:
    """A value in JSON; lists of presses and folds have a line for each."""
    if name in ("presses", "folds"):
        return "[\n" + ",\n".join(f"  {json.dumps(one, separators=(',', ':'))}" for one in value) + "\n ]"
    return json.dumps(value)


def _once(where: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(where, name, "stands there twice")
        seen.add(name)


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, separators=(",", ":")).encode()).hexdigest()
