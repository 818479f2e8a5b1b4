"""The feature ``markers``: the displacements of the sensor's markers in the image of a press."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
import pandas as pd

from tacbench_cad.extensions.markers.displacements import MarkerFeatures
from tacbench_cad.extensions.markers.markers import MarkerSettings
from tacbench_cad.lab.analysis import Collection, Exhibit, Feature, Words
from tacbench_cad.lab.runs import Region, Run
from tacbench_cad.util.convert import NOT_STORED
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerDisplacements(MarkerSettings, Feature):
    """The displacements of the markers in pixels of the frame, along its columns and rows.

    Args:
        region: The region in which markers are searched; None for the whole frame.
        learned: The markers of the study.
    """

    name: ClassVar[str] = "markers"
    unit: ClassVar[str | None] = "px"
    summary: ClassVar[str] = "the displacements of the markers"
    region: Region | None = field(default=None, metadata=NOT_STORED)
    learned: MarkerFeatures | None = field(default=None, metadata=NOT_STORED)

    @property
    def markers(self) -> MarkerFeatures:
        """The markers of the study to which the feature is fitted."""
        assert self.learned is not None
        return self.learned

    @property
    def words(self) -> Words:
        """The words with which the displacements are described."""
        count = self.markers.count
        return Words(
            numbers=f"displacements of {count} markers (px)",
            one="marker",
            each="marker's position along both axes of the image",
            over="markers, axes",
            title="displacement of markers",
            note=f"The figures are variances of displacements: of each of {count} markers from its "
            f"{self.markers.origin}, mean over the markers and both axes of the image. The position of a hidden marker "
            "is predicted from its neighbours. Lighting does not change these figures. They cannot be compared with "
            "the paper's figures in counts^2.",
        )

    @property
    def exhibit(self) -> Exhibit:
        """The mean displacements."""
        return Exhibit(
            name="displacements",
            caption="Displacements of the markers at the largest force, each from its "
            f"{self.markers.origin}; mean over positions, prints, repeats.",
            table=self._table,
            draw=self._draw,
        )

    def fit(self, collection: Collection, region: Region | None = None) -> Self:
        """Return the feature with the markers of a study.

        Raises:
            InputError: A run has no images, or no markers can be found in them.
            CheckFailedError: Fewer than half of the markers can be found in a run's frames without contact.
        """
        return replace(self, region=region, learned=MarkerFeatures.learn(collection.runs, self, region))

    def transform(self, run: Run, path: str) -> Floats:
        """Return the displacements of the markers in a frame, (markers, 2).

        Raises:
            CheckFailedError: The frame cannot be read, or fewer than half of the markers are found in it.
        """
        return self.markers.displacement_px(run, path)

    def picture(self, values: Floats, shape: tuple[int, ...]) -> Floats:
        """Draw the value of each marker at its place, mean over both axes; NaN where no marker is near."""
        return self.markers.picture(values.reshape(shape).mean(axis=1))

    @property
    def _places(self) -> Floats:
        return self.markers.first.reference_px

    def _table(self, mean: Floats) -> pd.DataFrame:
        """Return the mean displacement of each marker, and its position in the first run."""
        frame = pd.DataFrame(np.hstack([self._places, mean.reshape(-1, 2)]), columns=["x_px", "y_px", "dx_px", "dy_px"])
        frame.insert(0, "marker", np.arange(1, len(frame) + 1))
        return frame

    def _draw(self, panels: Sequence[tuple[Axes, Floats]]) -> str:
        """Draw the displacements as arrows, longer than they are so that they can be seen well."""
        places, shifts = self._places, [mean.reshape(-1, 2) for _, mean in panels]
        longest = max(float(np.max(np.hypot(*shift.T))) for shift in shifts)
        spacing = self.markers.first.spacing_px
        longer = float(max(1, round(1.5 * spacing / longest))) if longest else 1.0
        low, high = places.min(axis=0) - spacing, places.max(axis=0) + spacing
        for (axes, _), shift in zip(panels, shifts, strict=True):
            arrows = {"angles": "xy", "scale_units": "xy", "scale": 1.0 / longer, "width": 0.006}
            axes.quiver(*places.T, *shift.T, np.hypot(*shift.T), clim=(0.0, longest), **arrows)
            axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(high[1], low[1]))
        scale = "" if longer == 1.0 else f", arrows {longer:g} times as long"
        return f"displacement from the {self.markers.origin} (px){scale}"
