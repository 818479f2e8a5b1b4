"""Grouping of samples into runs, and conversion of positions, repeats and forces from words to numbers."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tacbench_cad.lab.runs.importing.sources import MEASURED, LeftOutFile, Sample, Source
from tacbench_cad.lab.runs.origins import FILE, INDEX, column_of
from tacbench_cad.lab.study.spec import Specimen
from tacbench_cad.spec.protocol import FORCES_N
from tacbench_cad.util.convert import read_toml
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import natural

#: A word that may also be written as a whole number.
Word = str | int
#: The largest number of force levels. If there are more different forces than this, and more than one for every two
#: samples, they are taken for measured forces.
MAX_FORCES = 20
#: The largest number of characters of a label, a print or a name.
MAX_WORD = 100
_NUMBER, _DECIMAL_COMMA = re.compile(r"[1-9]\d{0,5}"), re.compile(r"[+-]?\d+,\d+")


@dataclass(frozen=True, kw_only=True)
class Names:
    """The names to use for the words in the data. Upper and lower case of the words do not matter.

    Args:
        printers: The names of printers, by word.
        filaments: The names of filaments, by word.
        labels: The labels, by word.
    """

    printers: Mapping[str, Word] = field(default_factory=dict)
    filaments: Mapping[str, Word] = field(default_factory=dict)
    labels: Mapping[str, Word] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Names:
        """Read the names from a TOML file with the tables ``printers``, ``filaments`` and ``labels``.

        Raises:
            InputError: The file cannot be read, or has other tables.
        """
        return read_toml(path, cls, "names")


#: The fields of a row of ``targets.csv`` that do not follow from its run.
Fields = Mapping[str, Any]
#: The number of a sample in its run, from 1, the sample, and the fields of its row.
GroupedSample = tuple[int, Sample, Fields]


@dataclass(frozen=True, kw_only=True)
class Group:
    """The samples of a run.

    Args:
        specimen: The pressed specimen.
        samples: The number of each sample (from 1), the sample, and the fields of its row.
        origins: What the sources say about each sample, by its number and by column.
        sources: The sources of the samples.
        source: The description of the sources for ``run.json``, without the checksums of files.
    """

    specimen: Specimen
    samples: Sequence[GroupedSample]
    origins: Mapping[int, Mapping[str, str]]
    sources: Sequence[Source]
    source: Mapping[str, Any]

    @property
    def threads(self) -> bool:
        """Whether several threads may load frames, in any order."""
        return all(source.threads for source in self.sources)

    @property
    def levels(self) -> tuple[int, ...]:
        """The known force levels."""
        levels = {row["force_level"] for _, _, row in self.samples}
        return tuple(sorted(levels - {None}))


def grouped(sources: Sequence[Source], names: Names) -> tuple[list[Group], list[LeftOutFile]]:
    """Group the samples of sources into runs.

    There is one run for each print if the data tell the prints apart, otherwise one for each label.

    Args:
        sources: The sources.
        names: The names to use for the words in the data.

    Returns:
        The groups, and the samples that belong to no group.

    Raises:
        InputError: Two labels differ only in case, two printers or filaments get the same name, or the column of forces
            has measured forces instead of levels.
    """
    left_out = [fault for source in sources for fault in source.left_out]
    pairs: list[tuple[Source, Sample]] = []
    for source in sources:
        for sample in source.samples:
            fault = _fault(sample)
            if fault:
                left_out.append(LeftOutFile(where=sample.where, reason=fault))
            else:
                pairs.append((source, sample))
    samples = [sample for _, sample in pairs]
    label = _names("label", samples, names.labels)
    printer, filament = _names("printer", samples, names.printers), _names("filament", samples, names.filaments)
    positions, repeats = (numbered(_words(samples, name)) for name in ("position", "repeat"))
    forces = force_levels(_words(samples, "force"), len(samples))
    from_zero = "0" in _words(samples, "print")  # copies are counted from 1, so these numbers are only names
    groups: dict[Specimen, list[tuple[Source, Sample]]] = defaultdict(list)
    for source, sample in pairs:
        fields = sample.fields
        copy = fields.get("print")
        specimen = Specimen(
            label=label(fields.get("label")),
            printer=printer(fields.get("printer")),
            filament=filament(fields.get("filament")),
            copy=int(copy) if copy and not from_zero and re.fullmatch(r"[1-9]\d{0,2}", copy) else copy,
            session=fields.get("session"),
            block=sample.block,
        )
        groups[specimen].append((source, sample))
    result = []
    for specimen, members in groups.items():
        numbers: dict[tuple[Any, ...], str] = {}
        kept: list[GroupedSample] = []
        origins = {}
        for number, (source, sample) in enumerate(members, start=1):
            origins[number] = _origin(source, sample)
            row = _row(sample, positions, repeats, forces)
            key = (row["position"], row["force_level"], row["repeat"])
            if row["position"] and row["repeat"] and numbers.setdefault(key, sample.where) != sample.where:
                what = f"has the same print, position, force and repeat as {numbers[key]}"
                left_out.append(LeftOutFile(where=sample.where, reason=what))
            else:
                kept.append((number, sample, row))
        mine = list(dict.fromkeys(map(id, (source for source, _ in members))))
        of_group = [source for source in sources if id(source) in mine]
        described = [[sample.name, dict(sample.fields), origins[number]] for number, sample, _ in kept]
        document: dict[str, Any] = {"kind": "; ".join(dict.fromkeys(source.kind for source in of_group))}
        for source in of_group:
            document |= source.facts
        codes = {"position": positions, "repeat": repeats}
        document["codes"] = {
            name: {word: code for word, code in of.items() if word != str(code)} for name, of in codes.items()
        }
        document["samples_sha256"] = hashlib.sha256(json.dumps(described).encode()).hexdigest()
        result.append(Group(specimen=specimen, samples=kept, origins=origins, sources=of_group, source=document))
    alike = Counter(group.specimen.name.lower() for group in result)  # some file systems ignore case
    distinct = (replace(group.specimen, distinct=alike[group.specimen.name.lower()] > 1) for group in result)
    return [replace(group, specimen=specimen) for group, specimen in zip(result, distinct, strict=True)], left_out


def _origin(source: Source, sample: Sample) -> dict[str, str]:
    """Return the row of a sample in the table of its run's origins, without the name of the frame."""
    file = sample.file.absolute()
    name = file.relative_to(source.base).as_posix() if file.is_relative_to(source.base) else file.name
    place = {FILE: name} | ({} if sample.index is None else {INDEX: str(sample.index)})
    return place | {column_of(name): text for name, text in sample.columns.items()}


def _fault(sample: Sample) -> str:
    """Return why a sample's fields are refused; an empty text if they are allowed."""
    for name, text in sample.fields.items():
        if len(text) > MAX_WORD or not text.isprintable():
            return f"{name} has more than {MAX_WORD} characters, or characters that cannot be printed (a line break)"
    for name in MEASURED:
        if name in sample.fields and _number(sample.fields[name]) is None:
            return f"{name} = {sample.fields[name]!r} is not a number"
    return ""


def _words(samples: Iterable[Sample], name: str) -> list[str]:
    """Return the different words of a field, in the order of the samples."""
    return list(dict.fromkeys(sample.fields[name] for sample in samples if name in sample.fields))


def _number(text: str) -> float | None:
    try:
        value = float(text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def numbered(words: Sequence[str]) -> dict[str, int]:
    """Return a number from 1 for each word.

    Whole numbers from 1 are kept. Other numbers are numbered in increasing order, and words in alphabetical order.
    """
    if all(_NUMBER.fullmatch(word) for word in words):
        return {word: int(word) for word in words}
    values = [_number(word) for word in words]
    if None in values:
        return {word: number for number, word in enumerate(sorted(words, key=natural), start=1)}
    order = sorted({value for value in values if value is not None})
    return {word: order.index(value) + 1 for word, value in zip(words, values, strict=True) if value is not None}


def force_levels(words: Sequence[str], samples: int) -> dict[str, tuple[int, float | None]]:
    """Return the level of each word for a force, with the force in N if the word is a number.

    A higher force has a higher level. The forces of the paper always have the levels of the paper, even if some of them
    are missing.

    Raises:
        InputError: There are too many forces, so they must be measured forces.
    """
    if len(words) > MAX_FORCES and 2 * len(words) > samples:
        what = f"has {len(words):,} different values in {samples:,} samples, so these are measured forces, not levels"
        raise InputError("columns force", None, f"{what}; use --columns measured_force=COLUMN")
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
    """Return the values in a sample's row of ``targets.csv`` that do not follow from its run."""
    known = sample.fields
    level, force_n = forces[known["force"]] if "force" in known else (None, None)
    measured = {name: _number(known[field]) if field in known else None for field, name in MEASURED.items()}
    return {
        **measured,
        "position": positions.get(known.get("position", "")),
        "repeat": repeats.get(known.get("repeat", "")),
        "force_level": level,
        "target_force_n": force_n,
    }


def _names(what: str, samples: Sequence[Sample], mapping: Mapping[str, Word]) -> Callable[[str | None], str | None]:
    """Return the function that converts labels, or names of printers or filaments, whose case does not matter.

    Raises:
        InputError: Two labels differ only in case, or two different names would become the same name.
    """
    chosen = {word.casefold(): str(name) for word, name in mapping.items()}
    result: dict[str, str] = {}
    spelled: dict[str, tuple[str, str]] = {}
    for word, where in ((sample.fields[what], sample.where) for sample in samples if what in sample.fields):
        if word in result:
            continue
        name = key = chosen.get(word.casefold(), word)
        if what == "label":
            key = word.casefold()
        else:
            name = key = re.sub(r"[^\w.+-]+|_", "-", name.casefold()).strip("-.")
        if not name:
            raise InputError(what, word, "must have at least one letter or digit")
        other, place = spelled.setdefault(key, (word, where))
        same = other == word if what == "label" else other.casefold() == word.casefold()
        if not same and not {word.casefold(), other.casefold()} <= set(chosen):
            advice = "write both alike, or give their names with --names"
            raise InputError(f"{where}: {what}", word, f"and {other!r} in {place} would both become {name}; {advice}")
        result[word] = name
    return lambda word: None if word is None else result[word]
