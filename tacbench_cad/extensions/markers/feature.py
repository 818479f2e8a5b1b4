"""The feature ``markers``: the displacements of the sensor's markers in the image of a press."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import pandas as pd

from tacbench_cad.extensions.markers.displacements import MarkerFeatures
from tacbench_cad.extensions.markers.markers import MarkerSettings
from tacbench_cad.lab.analysis import Exhibit, Feature, Words, region_in
from tacbench_cad.lab.runs import Region, runs_of
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class MarkerDisplacements(Feature):
    """The displacements of the markers in pixels of the frame, along its columns and rows.

    Args:
        sigma_px: The scale at which markers are searched, see :class:`.MarkerSettings`; None to estimate it.
        threshold: The smallest contrast of a marker, in counts; None to estimate it.
        dark: Whether the markers are darker than their surroundings; None to estimate it.
        roi: The region in which markers are searched: a region, or a value of ``--roi``. None uses the region that is
            stored with the runs, if there is one.

    Attributes:
        markers_: The markers of the runs, known after :meth:`fit`.
    """

    name: ClassVar[str] = "markers"
    unit: ClassVar[str | None] = "px"
    summary: ClassVar[str] = "the displacements of the markers"
    markers_: MarkerFeatures

    def __init__(
        self,
        sigma_px: float | None = None,
        threshold: float | None = None,
        dark: bool | None = None,
        roi: Region | str | None = None,
    ) -> None:
        self.sigma_px = sigma_px
        self.threshold = threshold
        self.dark = dark
        self.roi = roi

    @property
    def words(self) -> Words:
        """The words with which the displacements are described."""
        count = self.markers_.count
        return Words(
            numbers=f"displacements of {count} markers (px)",
            one="marker",
            each="marker's position along both axes of the image",
            over="markers, axes",
            title="displacement of markers",
            note=f"The figures are variances of displacements: of each of {count} markers from its "
            f"{self.markers_.origin}, mean over the markers and both axes of the image. The position of a hidden "
            "marker is predicted from its neighbours. Lighting does not change these figures. They cannot be compared "
            "with the paper's figures in counts^2.",
        )

    @property
    def exhibit(self) -> Exhibit:
        """The mean displacements."""
        return Exhibit(
            name="displacements",
            caption="Displacements of the markers at the largest force, each from its "
            f"{self.markers_.origin}; mean over positions, prints, repeats.",
            table=self._table,
            draw=self._draw,
        )

    def fit(self, presses: pd.DataFrame, y: object = None) -> Self:
        """Learn the markers of the runs of some presses.

        Raises:
            InputError: A setting is not allowed, the presses are not in run folders, a run has no images, or no
                markers can be found in them.
            CheckFailedError: Fewer than half of the markers can be found in a run's frames without contact.
        """
        runs = runs_of(presses.reindex(columns=["folder"]))
        if not runs or bool(presses["folder"].isna().any()):
            raise InputError("features", self.name, 'need run folders; first use "tacbench import-frames"')
        self.region_ = region_in(presses, self.roi)
        settings = MarkerSettings(sigma_px=self.sigma_px, threshold=self.threshold, dark=self.dark)
        self.markers_ = MarkerFeatures.learn(runs, settings, self.region_)
        self.shape_ = (self.markers_.count, 2)
        return self

    def of_press(self, row: Any) -> Floats:
        """Return the displacements of the markers in the frame of a press, (markers, 2).

        Raises:
            CheckFailedError: The frame cannot be read, or fewer than half of the markers are found in it.
        """
        return self.markers_.displacement_px(row.folder, row.frame)

    def picture(self, values: Floats) -> Floats:
        """Draw the value of each marker at its place, mean over both axes; NaN where no marker is near."""
        return self.markers_.picture(values.reshape(self.shape_).mean(axis=1))

    @property
    def _places(self) -> Floats:
        return self.markers_.first.reference_px

    def _table(self, mean: Floats) -> pd.DataFrame:
        """Return the mean displacement of each marker, and its position in the first run."""
        frame = pd.DataFrame(np.hstack([self._places, mean.reshape(-1, 2)]), columns=["x_px", "y_px", "dx_px", "dy_px"])
        frame.insert(0, "marker", np.arange(1, len(frame) + 1))
        return frame

    def _draw(self, panels: Sequence[tuple[Axes, Floats]]) -> str:
        """Draw the displacements as arrows, longer than they are so that they can be seen well."""
        places, shifts = self._places, [mean.reshape(-1, 2) for _, mean in panels]
        longest = max(float(np.max(np.hypot(*shift.T))) for shift in shifts)
        spacing = self.markers_.first.spacing_px
        longer = float(max(1, round(1.5 * spacing / longest))) if longest else 1.0
        low, high = places.min(axis=0) - spacing, places.max(axis=0) + spacing
        for (axes, _), shift in zip(panels, shifts, strict=True):
            arrows = {"angles": "xy", "scale_units": "xy", "scale": 1.0 / longer, "width": 0.006}
            axes.quiver(*places.T, *shift.T, np.hypot(*shift.T), clim=(0.0, longest), **arrows)
            axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(high[1], low[1]))
        scale = "" if longer == 1.0 else f", arrows {longer:g} times as long"
        return f"displacement from the {self.markers_.origin} (px){scale}"
