"""Several views of the top of one block on one grid: the formula, as sliced, as scanned."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.extensions.scan.deviations import Summary
from tacbench_cad.spec import Block, Extrema, crest_errors, without_edge
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.types import Bools, Floats

#: The width over which the slope beside a cut is averaged, in mm.
_SMOOTH_MM = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparisonView:
    """The heights of one view.

    Args:
        name: The name: ``as sliced``.
        heights_mm: The heights above the underside, shape (n, m); NaN where they are unknown.
    """

    name: str
    heights_mm: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """Views of one block.

    Args:
        block: The block.
        x_mm: The x coordinates of the grid, shape (n,).
        y_mm: The y coordinates, shape (m,).
        formula_mm: The heights of the formula, shape (n, m).
        views: The other views.
        layer_mm: The error from which a crest counts as lost.
        simulated: Whether the scan was simulated.
    """

    block: Block
    x_mm: Floats
    y_mm: Floats
    formula_mm: Floats
    views: Sequence[ComparisonView]
    layer_mm: float
    simulated: bool = False

    @property
    def inside(self) -> Bools:
        """Whether a point is compared, shape (n, m)."""
        return without_edge(self.block, self.x_mm, self.y_mm)

    def error_mm(self, view: ComparisonView) -> Floats:
        """Return the heights of a view minus those of the formula; NaN at the edge, shape (n, m)."""
        return np.where(self.inside, view.heights_mm - self.formula_mm, np.nan)

    def peaks(self, view: ComparisonView) -> Extrema:
        """Return the errors of a view at the crests of the formula."""
        return crest_errors.peaks(self.formula_mm, view.heights_mm, self.inside, self.x_mm, self.y_mm, self.layer_mm)

    def valleys(self, view: ComparisonView) -> Extrema:
        """Return the errors of a view at the valleys of the formula."""
        return crest_errors.valleys(self.formula_mm, view.heights_mm, self.inside, self.x_mm, self.y_mm, self.layer_mm)

    def cut(self) -> tuple[int, int]:
        """Return the index of the cut along y among the x, and that of the cut along x among the y.

        A cut shows much if the formula changes along it and little across it, where a small shift would matter. Of all
        such cuts in the middle half of the block, the nearest to the middle is taken.
        """
        from scipy.ndimage import uniform_filter1d

        along_x, along_y = (np.where(self.inside, np.abs(slope), 0.0) for slope in np.gradient(self.formula_mm))
        across = [max(1, round(_SMOOTH_MM / (axis[1] - axis[0]))) for axis in (self.x_mm, self.y_mm)]
        scores = (along_y - along_x).sum(axis=1), (along_x - along_y).sum(axis=0)
        i, j = (_nearest_best(uniform_filter1d(score, size)) for score, size in zip(scores, across, strict=True))
        return i, j

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield the rows of the table: the name of a number, and its value for each view. Lengths in µm."""
        errors = [Summary.of(self.error_mm(view)) for view in self.views]
        for head, name in (
            ("height error, rms (µm)", "rms_mm"),
            ("height error, mean (µm)", "mean_mm"),
            ("95 % are within (µm)", "within_95_mm"),
            ("largest (µm)", "largest_mm"),
        ):
            sign = "+" if name == "mean_mm" else ""
            yield head, *("-" if each is None else f"{1000.0 * getattr(each, name):{sign}.0f}" for each in errors)
        for head, extrema in (("crests lost", self.peaks), ("valleys filled", self.valleys)):
            found = [extrema(view) for view in self.views]
            yield head, *("none seen" if each.count == 0 else f"{each.missed} of {each.count}" for each in found)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON: lengths in mm."""
        return {view.name.replace(" ", "_"): self._values(view) for view in self.views}

    def _values(self, view: ComparisonView) -> dict[str, object]:
        summary = Summary.of(self.error_mm(view))
        parts = {"height_error": summary, "peaks": self.peaks(view), "valleys": self.valleys(view)}
        return {name: to_plain(part) for name, part in parts.items()}


def _nearest_best(score: Floats) -> int:
    """Return the index of a nearly highest score in the middle half, the nearest to the middle."""
    count = len(score)
    middle = np.arange(count // 4, max(count // 4 + 1, count - count // 4))
    good = middle[score[middle] >= score[middle].max() - 0.02 * np.ptp(score[middle]) - 1e-9]
    return int(good[np.argmin(np.abs(good - (count - 1) / 2.0))])
