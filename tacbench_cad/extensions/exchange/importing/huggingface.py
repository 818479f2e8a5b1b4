"""Import of data sets that ``datasets`` (Hugging Face) saved on the disk."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.runs import (
    ImportFormat,
    ImportOptions,
    Loaded,
    Paths,
    Rows,
    Sample,
    Source,
    columns_of_fields,
)
from tacbench_cad.util.errors import CheckFailedError, InputError, one_line
from tacbench_cad.util.packages import require
from tacbench_cad.util.untrusted import open_input, read_bytes

#: The files that identify such a folder: with a single split, and with several splits.
FILES = ("dataset_info.json", "dataset_dict.json")
#: The types of numbers of a data set.
NUMBER_TYPES = ("bool", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)), "float32", "float64")
#: The largest number of values of a list that is kept with a frame.
MAX_NUMBERS = 64


def _read(folder: Path, paths: Paths, options: ImportOptions) -> Source:
    """Read the samples of all splits.

    Raises:
        InputError: The folder cannot be read, or has no column of images or arrays.
        MissingToolError: ``datasets`` is not installed.
    """
    require("the import of a Hugging Face data set", "datasets")
    import datasets

    columns, channels = options.columns, options.channels
    try:
        loaded = datasets.load_from_disk(str(folder))
        splits = dict(loaded) if isinstance(loaded, datasets.DatasetDict) else {"": loaded}
        for split in splits.values():
            split.data.validate(full=True)  # Arrow trusts the offsets in a file, and crashes if they lie outside it
    except Exception as error:  # datasets and Arrow can raise almost any exception for damaged files
        raise InputError("data set", str(folder), f"cannot be read: {one_line(error, 200)}") from None
    for file in (file for split in splits.values() for file in split.cache_files):
        open_input(Path(file["filename"]), "data set", "array", within=folder).close()
    samples: list[Sample] = []
    notes: list[str] = []
    facts: dict[str, Any] = {}
    for word, split in splits.items():
        image = _image_column(folder, split, columns)
        rest = [name for name in split.column_names if name != image]
        if isinstance(split.features[image], datasets.Image):
            split = split.cast_column(image, datasets.Image(decode=False))
        names = {name: split.features[name].names for name in rest if hasattr(split.features[name], "names")}
        words = {name: [_text(value, names.get(name)) for value in split[name]] for name in rest if _kept(split, name)}
        words |= _file_names(split, image)
        texts = list(zip(*words.values(), strict=True)) if words else [()] * len(split)
        chosen = {field: column for field, column in columns.items() if column != image}
        rows = Rows.of(f"{folder.name} {word}".strip(), list(words), texts, chosen, line=0)
        for index, (where, fields, texts_of_row) in enumerate(rows.rows):
            fields.pop("image", None)
            load: Callable[[], Loaded] = partial(_frame, split, image, index, folder)
            samples.append(
                Sample(
                    name=where.replace(" line ", " row "),
                    fields=fields,
                    load=load,
                    file=folder / word,
                    index=index,
                    columns=texts_of_row,
                    channels=channels,
                )
            )
        notes.append(rows.note)
        facts = {"columns": {"image": image, **rows.columns}, "channels": channels}
    return Source(kind="a Hugging Face data set", path=folder, samples=samples, facts=facts, notes=tuple(notes))


def _image_column(folder: Path, split: Any, columns: Mapping[str, str]) -> str:
    import datasets

    chosen = columns_of_fields(folder.name, list(split.column_names), columns).get("image")
    images = [name for name in split.column_names if isinstance(split.features[name], datasets.Image)]
    name = chosen if chosen in images or "image" in columns else next(iter(images), chosen)
    if name is None:
        what = f"has no column of images; choose one with --columns image=COLUMN ({', '.join(split.column_names)})"
        raise InputError("data set", str(folder), what)
    return name


def _kept(split: Any, name: str) -> bool:
    """Return whether the values of a column are kept as texts: plain values, and short lists of numbers."""
    import datasets

    if _plain(split, name) or not len(split) or isinstance(split.features[name], datasets.Image):
        return _plain(split, name)
    first = split[0][name]
    return (
        isinstance(first, list) and len(first) <= MAX_NUMBERS and all(isinstance(value, int | float) for value in first)
    )


def _dtype(feature: Any) -> str | None:
    """Return the type of the numbers in a column of arrays, which are loaded as lists; None if it is unknown."""
    while hasattr(feature, "feature"):
        feature = feature.feature
    dtype = getattr(feature, "dtype", None)
    return dtype if dtype in NUMBER_TYPES else None


def _file_names(split: Any, image: str) -> dict[str, list[str]]:
    """Return the column with the names of the image files, if the data set has them."""
    try:
        paths = [path for chunk in split.data[image].chunks for path in chunk.field("path").to_pylist()]
    except (AttributeError, KeyError, TypeError, ValueError):  # a column of arrays
        return {}
    return {image: [path or "" for path in paths]} if len(paths) == len(split) and any(paths) else {}


def _plain(split: Any, name: str) -> bool:
    kind = getattr(split.features[name], "dtype", "")
    return kind in ("string", "large_string", "bool") or kind.startswith(("int", "uint", "float"))


def _text(value: Any, names: list[str] | None) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return json.dumps(value)
    return names[value] if names and isinstance(value, int) and 0 <= value < len(names) else str(value)


def _frame(split: Any, column: str, index: int, folder: Path) -> Loaded:
    try:
        value = split[index][column]
        array = None if isinstance(value, dict) else np.asarray(value, dtype=_dtype(split.features[column]))
    except Exception as error:
        raise CheckFailedError(f"cannot be read: {one_line(error, 200)}") from None
    if array is not None:
        if array.dtype.kind not in "biuf":
            raise CheckFailedError(f"contains {array.dtype}; it must be an image or an array of numbers")
        return array
    if value.get("bytes"):
        return bytes(value["bytes"])
    if not value.get("path"):
        raise CheckFailedError("has no image")
    return read_bytes(folder / value["path"], "image", "image", within=folder)


FORMAT = ImportFormat(
    recognises=lambda path, *_: path.is_dir() and any((path / name).is_file() for name in FILES), read=_read
)
