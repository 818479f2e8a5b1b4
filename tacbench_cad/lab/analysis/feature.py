"""Features: transformers of scikit-learn that compute numbers of each press from a table of presses.

A feature is found by its name in the entry points of the group ``tacbench.features``, so an extension or another
package adds one by one class.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.press_table import read_frame
from tacbench_cad.lab.runs.region import Region
from tacbench_cad.util.entries import load_named
from tacbench_cad.util.errors import CheckFailedError, InputError, one_of
from tacbench_cad.util.types import Floats, Strings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The group of entry points that name the features.
GROUP = "tacbench.features"
#: The longest side of a map for figures, in pixels.
MAP_SIDE = 320


class Words(NamedTuple):
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


class Feature(TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """A kind of numbers that are computed of each press.

    A subclass defines :meth:`numbers`. The arguments of its ``__init__`` are its settings, which may follow the name in
    a text such as ``markers:sigma_px=3.5``.

    Attributes:
        shape_: The shape of the numbers of a press, known after :meth:`fit`.
        region_: The region whose pixels are used; None for all pixels.
    """

    #: The name, as in ``--features``.
    name: ClassVar[str]
    #: The unit of the numbers; None for the unit of the sensor's frames.
    unit: ClassVar[str | None] = None
    #: Whether the numbers are computed from frames, so that stationary frames can be transformed as well.
    from_frames: ClassVar[bool] = True
    #: Whether a press has so few numbers that a classifier receives them all, scaled, instead of principal components.
    few_numbers: ClassVar[bool] = False
    #: What a classifier receives, for texts.
    summary: ClassVar[str] = "frames"
    shape_: tuple[int, ...]
    region_: Region | None = None

    @property
    def words(self) -> Words:
        """The words with which the numbers are described."""
        return Words()

    @property
    def exhibit(self) -> Exhibit | None:
        """The table and the figure of the mean numbers; None if they show nothing."""
        return None

    def fit(self, presses: pd.DataFrame, y: object = None) -> Self:
        """Learn the shape of the numbers from the first press that can be read.

        Args:
            presses: The table, see :func:`tacbench_cad.lab.read`.
            y: Not used.

        Raises:
            InputError: The feature cannot be computed for these presses.
            CheckFailedError: No press can be transformed.
        """
        fault: CheckFailedError | None = None
        for row in _rows(presses):
            try:
                self.shape_ = np.shape(self.of_press(row))
                return self
            except CheckFailedError as error:
                fault = fault or error
        raise fault or InputError("presses", 0, "must be at least one press")

    def numbers(self, frame: Frame) -> NDArray[Any]:
        """Return the numbers of a frame, in any shape that is the same for all frames.

        Raises:
            CheckFailedError: The frame does not show what the feature needs.
        """
        raise NotImplementedError

    def of_press(self, row: Any) -> NDArray[Any]:
        """Return the numbers of a press.

        Args:
            row: The row of the press, with its columns as attributes: ``row.frame`` is the path of the frame.

        Raises:
            CheckFailedError: The frame is missing or damaged, or does not show what the feature needs.
        """
        return self.numbers(read_frame(row.frame, getattr(row, "folder", None)))

    def transform(self, presses: pd.DataFrame) -> NDArray[Any]:
        """Return the numbers of each press, (n, numbers): uint8 for images, otherwise float64.

        Raises:
            CheckFailedError: A frame is missing or damaged, has another shape than the first, or contains NaN.
        """
        check_is_fitted(self, "shape_")
        rows = []
        for row in _rows(presses):
            numbers = np.asarray(self.of_press(row))
            if numbers.shape != self.shape_:
                raise CheckFailedError(f"{row.frame}: gives {numbers.shape}, but the first frame gave {self.shape_}")
            if numbers.dtype.kind == "f" and not np.isfinite(numbers).all():
                raise CheckFailedError(f"{row.frame}: contains NaN or infinity")
            rows.append(numbers.ravel())
        return np.stack(rows) if rows else np.empty((0, int(np.prod(self.shape_))))

    def get_feature_names_out(self, input_features: object = None) -> Strings:
        """Return a name for each number: ``pixels_0``, ``pixels_1`` and so on."""
        check_is_fitted(self, "shape_")
        return np.array([f"{self.name}_{number}" for number in range(int(np.prod(self.shape_)))])

    def picture(self, values: Floats) -> Floats:
        """Arrange one value for each number as a small picture, with NaN at pixels without one."""
        return small_map(values, self.shape_)


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
    kind: type[Feature] = load_named(GROUP, "features", name)
    keys = list(kind().get_params())
    settings = {key: value for key, value in defaults.items() if key in keys}
    for word in words.split(",") if words else ():
        key, _, value = word.partition("=")
        try:
            settings[one_of("features", key, keys)] = json.loads(value)
        except json.JSONDecodeError:
            raise InputError("features", text, f"{key} must be a number, true or false") from None
    return kind(**settings)


def _rows(presses: pd.DataFrame) -> Iterator[SimpleNamespace]:
    """Yield the rows with their columns as attributes; for a few rows this is much faster than ``itertuples``."""
    return (SimpleNamespace(**dict(zip(map(str, presses), values, strict=True))) for values in presses.to_numpy(object))


def small_map(values: Floats, shape: Sequence[int]) -> Floats:
    """Arrange one value for each pixel as a map of at most :data:`MAP_SIDE` pixels a side.

    Channels and further axes are averaged.

    Args:
        values: One value for each number of the frame, in the frame's order.
        shape: The shape of the frame; a frame with one axis gives a single row.
    """
    picture = values.reshape(shape if len(shape) > 1 else (1, -1))
    if picture.ndim > 2:
        picture = picture.mean(axis=tuple(range(2, picture.ndim)))
    return _averaged(_averaged(picture).T).T


def _averaged(picture: Floats) -> Floats:
    """Average neighbouring rows so that at most :data:`MAP_SIDE` rows remain; the last mean may have fewer rows."""
    rows = len(picture)
    step = -(-rows // MAP_SIDE)
    means = picture[::step].copy()
    for i in range(1, step):
        part = picture[i::step]
        means[: len(part)] += part
    means /= np.diff(np.append(np.arange(0, rows, step), rows))[:, None]
    return means
