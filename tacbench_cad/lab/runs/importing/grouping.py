"""Which samples make up a run, and what words such as positions and forces are as numbers."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tacbench_cad.lab.runs.importing.samples import LeftOut, Sample, Source
from tacbench_cad.lab.study.spec import Specimen
from tacbench_cad.spec.protocol import FORCES_N
from tacbench_cad.util.convert import Word, read_toml
from tacbench_cad.util.errors import InputError

#: More different forces than this, and more than one for every two samples, are no levels but measured forces.
MAX_FORCES = 20
#: The longest word for a label, a print or a name.
MAX_WORD = 100
_NUMBER, _DECIMAL_COMMA = re.compile(r"[1-9]\d{0,5}"), re.compile(r"[+-]?\d+,\d+")


@dataclass(frozen=True, kw_only=True)
class Names:
    """What names in the data mean: a word of the data, in any case, and the name that is to be used.

    Args:
        printers: Printers by their words.
        filaments: Filaments.
        labels: Labels.
    """

    printers: Mapping[str, Word] = field(default_factory=dict)
    filaments: Mapping[str, Word] = field(default_factory=dict)
    labels: Mapping[str, Word] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Names:
        """Those of a TOML file with the tables ``printers``, ``filaments`` and ``labels``.

        Raises:
            InputError: It cannot be read, or has other tables.
        """
        return read_toml(path, cls, "names")


@dataclass(frozen=True, kw_only=True)
class Group:
    """The samples of one run.

    Args:
        specimen: What was pressed.
        samples: Each sample's number from 1, the sample, and the fields of its row.
        sources: Where they come from.
        source: What ``run.json`` says of that, without the checksums of files.
    """

    specimen: Specimen
    samples: Sequence[tuple[int, Sample, Mapping[str, Any]]]
    sources: Sequence[Source]
    source: Mapping[str, Any]

    @property
    def levels(self) -> tuple[int, ...]:
        """The force levels that are known."""
        levels = {row["force_level"] for _, _, row in self.samples}
        return tuple(sorted(levels - {None}))


def grouped(sources: Sequence[Source], names: Names) -> tuple[list[Group], list[LeftOut]]:
    """The runs that some sources become: one for each print that is known apart, else one for each label.

    Args:
        sources: The sources.
        names: What names mean.

    Returns:
        The groups, and the samples that cannot be in one.

    Raises:
        InputError: Labels differ in case only, two printers or filaments have names that become one, or what stands as
            force is no level.
    """
    left_out = [fault for source in sources for fault in source.left_out]
    pairs: list[tuple[Source, Sample]] = []
    for source in sources:
        for sample in source.samples:
            fault = _fault(sample)
            if fault:
                left_out.append(LeftOut(where=sample.where, reason=fault))
            else:
                pairs.append((source, sample))
    samples = [sample for _, sample in pairs]
    label = _labels(samples, names.labels)
    printer, filament = _names("printer", samples, names.printers), _names("filament", samples, names.filaments)
    positions, repeats = (numbered(_words(samples, name)) for name in ("position", "repeat"))
    forces = force_levels(_words(samples, "force"), len(samples))
    from_zero = "0" in _words(samples, "print")  # then these numbers are names: copies are counted from 1
    groups: dict[Specimen, list[tuple[Source, Sample]]] = defaultdict(list)
    for source, sample in pairs:
        said = sample.fields
        copy = said.get("print")
        specimen = Specimen(
            label=label(said.get("label")),
            printer=printer(said.get("printer")),
            filament=filament(said.get("filament")),
            copy=int(copy) if copy and not from_zero and re.fullmatch(r"[1-9]\d{0,2}", copy) else copy,
            session=said.get("session"),
            block=sample.block,
        )
        groups[specimen].append((source, sample))
    result = []
    for specimen, members in groups.items():
        numbers: dict[tuple[Any, ...], str] = {}
        kept: list[tuple[int, Sample, Mapping[str, Any]]] = []
        for number, (_, sample) in enumerate(members, start=1):
            row = _row(sample, positions, repeats, forces)
            key = (row["position"], row["force_level"], row["repeat"])
            if row["position"] and row["repeat"] and numbers.setdefault(key, sample.where) != sample.where:
                what = f"has the print, position, force and repeat of {numbers[key]}"
                left_out.append(LeftOut(where=sample.where, reason=what))
            else:
                kept.append((number, sample, row))
        mine = list(dict.fromkeys(map(id, (source for source, _ in members))))
        of_group = [source for source in sources if id(source) in mine]
        said_of = [[sample.name, dict(sample.fields)] for _, sample, _ in kept]
        document: dict[str, Any] = {"kind": "; ".join(dict.fromkeys(source.kind for source in of_group))}
        for source in of_group:
            document |= source.facts
        codes = {"position": positions, "repeat": repeats}
        document["codes"] = {
            name: {word: code for word, code in of.items() if word != str(code)} for name, of in codes.items()
        }
        document["samples_sha256"] = hashlib.sha256(json.dumps(said_of).encode()).hexdigest()
        result.append(Group(specimen=specimen, samples=kept, sources=of_group, source=document))
    _require_apart(result)
    return result, left_out


def _require_apart(groups: Iterable[Group]) -> None:
    """Refuse two groups whose folders would have the same name on some file system."""
    folders: dict[str, Specimen] = {}
    for group in groups:
        other = folders.setdefault(group.specimen.name.lower(), group.specimen)
        if other is not group.specimen:
            raise InputError("print", group.specimen.name, f"cannot be told from {other.name} by its name; rename one")


def _fault(sample: Sample) -> str:
    """Why a sample's fields are refused; empty if they are not."""
    for name, text in sample.fields.items():
        if len(text) > MAX_WORD or not text.isprintable():
            return f"{name} has more than {MAX_WORD} characters, or a line break or the like in it"
    for name in ("x", "y", "z", "measured_force"):
        if name in sample.fields and _number(sample.fields[name]) is None:
            return f"{name} = {sample.fields[name]!r} is no number"
    return ""


def _words(samples: Iterable[Sample], name: str) -> list[str]:
    """The different words of a field in the order of the samples."""
    return list(dict.fromkeys(sample.fields[name] for sample in samples if name in sample.fields))


def _number(text: str) -> float | None:
    try:
        value = float(text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def numbered(words: Sequence[str]) -> dict[str, int]:
    """Numbers from 1 for words: whole numbers from 1 stay, other numbers and words are counted in their order."""
    if all(_NUMBER.fullmatch(word) for word in words):
        return {word: int(word) for word in words}
    values = [_number(word) for word in words]
    if None in values:
        return {word: number for number, word in enumerate(sorted(words), start=1)}
    order = sorted({value for value in values if value is not None})
    return {word: order.index(value) + 1 for word, value in zip(words, values, strict=True) if value is not None}


def force_levels(words: Sequence[str], samples: int) -> dict[str, tuple[int, float | None]]:
    """The level of each word for a force, and its newtons if it is a number.

    Levels rise with the force. The paper's forces have the paper's levels, whichever of them are there.

    Raises:
        InputError: There are so many that they must be measured forces.
    """
    if len(words) > MAX_FORCES and 2 * len(words) > samples:
        what = f"has {len(words):,} different values in {samples:,} samples, so these are measured forces and no levels"
        raise InputError("columns force", None, f"{what}; map them as --columns measured_force=COLUMN")
    values = {word: _number(word) for word in words}
    if None in values.values():
        return {word: (level, None) for word, level in numbered(words).items()}
    paper = [value in FORCES_N for value in values.values()]
    order = list(FORCES_N) if all(paper) else sorted({value for value in values.values() if value is not None})
    return {word: (order.index(value) + 1, value) for word, value in values.items() if value is not None}


def _row(
    sample: Sample,
    positions: Mapping[str, int],
    repeats: Mapping[str, int],
    forces: Mapping[str, tuple[int, float | None]],
) -> dict[str, Any]:
    """What a sample's row of ``targets.csv`` says beside what its run says."""
    said = sample.fields
    level, force_n = forces[said["force"]] if "force" in said else (None, None)
    measured = {name: _number(said[name]) if name in said else None for name in ("x", "y", "z", "measured_force")}
    turns = dict.fromkeys(f"{what}_r{axis}" for what in ("pose", "shear") for axis in "xyz")
    return {
        **{f"pose_{axis}": measured[axis] for axis in "xyz"},
        **turns,
        **dict.fromkeys(f"shear_{axis}" for axis in "xyz"),
        "position": positions.get(said.get("position", "")),
        "repeat": repeats.get(said.get("repeat", "")),
        "force_level": level,
        "target_force_n": force_n,
        "measured_force_n": measured["measured_force"],
        **dict.fromkeys(("force_after_n", "in_band", "time_utc", "reference_age_s")),
    }


def _labels(samples: Sequence[Sample], mapping: Mapping[str, str]) -> Callable[[str | None], str | None]:
    """What becomes of a label.

    Raises:
        InputError: Two labels differ in case only.
    """
    chosen = {word.casefold(): name for word, name in mapping.items()}
    seen: dict[str, tuple[str, str]] = {}
    for sample in samples:
        word = sample.fields.get("label")
        if word is not None and word.casefold() not in chosen:
            first, where = seen.setdefault(word.casefold(), (word, sample.where))
            if first != word:
                what = f"differs in case only from {first!r} in {where}; write one of them, or map both with --names"
                raise InputError(f"{sample.where}: label", word, what)
    return lambda word: None if word is None else chosen.get(word.casefold(), word)


def _names(what: str, samples: Sequence[Sample], mapping: Mapping[str, str]) -> Callable[[str | None], str | None]:
    """What becomes of the name of a printer or a filament: spellings that differ in case only are one.

    Raises:
        InputError: Two that differ in more than case become the same name.
    """
    words = _words(samples, what)
    chosen = {word.casefold(): name for word, name in mapping.items()}
    result: dict[str, str] = {}
    spelled: dict[str, str] = {}
    for word in words:
        name = re.sub(r"[^\w.+-]+|_", "-", chosen.get(word.casefold(), word).casefold()).strip("-.")
        if not name:
            raise InputError(what, word, "has no letter or digit")
        other = spelled.setdefault(name, word)
        if other.casefold() != word.casefold() and not {word.casefold(), other.casefold()} <= set(chosen):
            raise InputError(what, word, f"and {other!r} would both become {name}; say with --names what they are")
        result[word] = name
    return lambda word: None if word is None else result[word]
