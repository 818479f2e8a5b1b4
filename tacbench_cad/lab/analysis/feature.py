"""Features: the numbers that the analysis computes of each press, from its frames or from the table of its series.

A feature is found by its name in the entry points of the group ``tacbench.features``, so an extension or another
package adds one in one file. It is fitted to a study, and then transforms the files of each press into numbers.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.variance.moments import small_map
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.region import Region
from tacbench_cad.lab.runs.region_search import region_of
from tacbench_cad.util.entries import load_named
from tacbench_cad.util.errors import CheckFailedError, InputError, one_of
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

#: The group of entry points that name the features.
GROUP = "tacbench.features"


@dataclass(frozen=True, kw_only=True)
class Words:
    """The words with which tables, figures and reports describe the numbers of a feature.

    Args:
        numbers: The numbers of a press: ``forces (N)``; empty for its frames as they were recorded.
        one: What a single number belongs to.
        each: The same in a sentence about the variance of each number.
        over: What the variance is averaged over.
        title: An addition to the titles of tables.
        note: A sentence or more that explain the variance; empty if it needs no explanation.
    """

    numbers: str = ""
    one: str = "pixel"
    each: str = "pixel"
    over: str = "pixels"
    title: str = ""
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Exhibit:
    """The mean numbers of the presses of each texture, as a table and as a figure with a panel for each texture.

    Args:
        name: The name of the files, without suffix.
        caption: The caption of the figure.
        table: Returns the table for the mean numbers of one cell.
        draw: Draws the mean numbers of each cell into its panel, and returns the label of the colour scale.
    """

    name: str
    caption: str
    table: Callable[[Floats], pd.DataFrame]
    draw: Callable[[Sequence[tuple[Axes, Floats]]], str]


class Feature:
    """A kind of numbers that are computed of each press.

    Subclasses are frozen dataclasses. Their fields are the settings that may follow the name in a text such as
    ``markers:sigma_px=3.5``; a field with the metadata ``{"key": None}`` is set by :meth:`fit` instead.
    """

    #: The name, as in ``--features``.
    name: ClassVar[str]
    #: The unit of the numbers; None for the unit of the sensor's frames.
    unit: ClassVar[str | None] = None
    #: Whether the numbers are computed from frames. Otherwise there is one number for each row of a series' table.
    from_frames: ClassVar[bool] = True
    #: Whether a press has so few numbers that a classifier receives them all, scaled, instead of principal components.
    few_numbers: ClassVar[bool] = False
    #: What a classifier receives, for texts.
    summary: ClassVar[str] = "frames"
    #: The region whose pixels are used; None for all pixels.
    region: Region | None = None

    @property
    def words(self) -> Words:
        """The words with which the numbers are described."""
        return Words()

    @property
    def exhibit(self) -> Exhibit | None:
        """The table and the figure of the mean numbers; None if they show nothing."""
        return None

    def fit(self, collection: Collection, region: Region | None = None) -> Self:
        """Return the feature with everything that it learns from a study. By default, it learns nothing.

        Args:
            collection: The study.
            region: The region of interest; None for the whole frames.

        Raises:
            InputError: The feature cannot be computed for this study.
            CheckFailedError: Files of the study do not show what the feature needs.
        """
        return self

    def paths(self, collection: Collection, index: int) -> tuple[str, ...]:
        """Return the paths of the files of a press that are transformed, relative to its run folder."""
        return collection.paths(index)

    def transform(self, run: Run, path: str) -> NDArray[Any]:
        """Return the numbers of a file of a run, in any shape.

        Raises:
            CheckFailedError: The file is missing or damaged, or does not show what the feature needs.
        """
        raise NotImplementedError

    def picture(self, values: Floats, shape: tuple[int, ...]) -> Floats:
        """Arrange one value for each number as a small picture, with NaN at pixels without one.

        Args:
            values: The values, in the order of the numbers.
            shape: The shape of a transformed file.
        """
        return small_map(values, shape)


def feature_of(text: str, **defaults: object) -> Feature:
    """Return a feature that is not fitted yet.

    Args:
        text: Its name, and its settings if there are any: ``markers:sigma_px=3.5,dark=true``.
        defaults: Values of other settings. Those that the feature does not have are left out.

    Raises:
        InputError: There is no such feature, or a setting is not allowed.
        MissingToolError: The extension of the feature was deleted.
    """
    name, _, words = text.partition(":")
    kind: type[Any] = load_named(GROUP, "features", name)
    keys = [field.name for field in fields(kind) if not field.metadata.get("exclude")]
    settings = {key: value for key, value in defaults.items() if key in keys}
    for word in words.split(",") if words else ():
        key, _, value = word.partition("=")
        try:
            settings[one_of("features", key, keys)] = json.loads(value)
        except json.JSONDecodeError:
            raise InputError("features", text, f"{key} must be a number, true or false") from None
    feature: Feature = kind(**settings)
    return feature


def fitted(
    collection: Collection, text: str = "pixels", roi: Region | str | None = None, **defaults: object
) -> Feature:
    """Return a feature that is fitted to a study.

    Args:
        collection: The study.
        text: See :func:`feature_of`.
        roi: The region of interest, or its text, as for ``--roi``.
        defaults: See :func:`feature_of`.

    Raises:
        InputError: The feature or the region is not allowed, or cannot be found in these frames.
        CheckFailedError: Files of the study do not show what the feature needs.
    """
    feature = feature_of(text, **defaults)
    if isinstance(roi, Region):
        return feature.fit(collection, roi)
    return feature.fit(collection, region_of(collection.runs, roi) if feature.from_frames else None)


def read_usable(run: Run, path: str, feature: Feature) -> NDArray[Any]:
    """Transform a file of a run, and check that its numbers are finite.

    Raises:
        CheckFailedError: The file is missing or damaged, or contains NaN or infinity; the message names it.
    """
    values = feature.transform(run, path)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise CheckFailedError(f"{run.folder / path}: contains NaN or infinity")
    return values
