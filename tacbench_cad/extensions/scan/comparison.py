"""Several views of the top of one block on one grid: the formula, as sliced, as scanned."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from tacbench_cad.extensions.scan.deviations import Summary, TopMap
from tacbench_cad.spec import Extrema, crest_errors
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.types import Floats

#: The width over which the slope beside a cut is averaged, in mm.
_SMOOTH_MM = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """Views of one block.

    Args:
        top: The scan and the formula.
        printed_mm: The heights of the views on the same grid, shape (n, m) each, by their names; NaN where they are
            unknown.
        simulated: Whether the scan was simulated.
    """

    top: TopMap
    printed_mm: Mapping[str, Floats]
    simulated: bool = False

    def error_mm(self, name: str) -> Floats:
        """Return the heights of a view minus those of the formula; NaN at the edge, shape (n, m)."""
        return np.where(self.top.inside, self.printed_mm[name] - self.top.formula_mm, np.nan)

    def extrema(self, name: str) -> dict[str, Extrema]:
        """Return the errors of a view at the peaks and the valleys of the formula."""
        top = self.top
        surfaces = (top.formula_mm, self.printed_mm[name], top.inside, top.x_mm, top.y_mm, top.layer_mm)
        return {"peaks": crest_errors.peaks(*surfaces), "valleys": crest_errors.valleys(*surfaces)}

    def cut(self) -> tuple[int, int]:
        """Return the index of the cut along y among the x, and that of the cut along x among the y.

        A cut shows much if the formula changes along it and little across it, where a small shift would matter. Of all
        such cuts in the middle half of the block, the nearest to the middle is taken.
        """
        from scipy.ndimage import uniform_filter1d

        top = self.top
        along_x, along_y = (np.where(top.inside, np.abs(slope), 0.0) for slope in np.gradient(top.formula_mm))
        across = [max(1, round(_SMOOTH_MM / (axis[1] - axis[0]))) for axis in (top.x_mm, top.y_mm)]
        scores = (along_y - along_x).sum(axis=1), (along_x - along_y).sum(axis=0)
        i, j = (_nearest_best(uniform_filter1d(score, size)) for score, size in zip(scores, across, strict=True))
        return i, j

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield the rows of the table: the name of a number, and its value for each view. Lengths in µm."""
        errors = [Summary.of(self.error_mm(name)) for name in self.printed_mm]
        for head, name in (
            ("height error, rms (µm)", "rms_mm"),
            ("height error, mean (µm)", "mean_mm"),
            ("95 % are within (µm)", "within_95_mm"),
            ("largest (µm)", "largest_mm"),
        ):
            sign = "+" if name == "mean_mm" else ""
            yield head, *("-" if each is None else f"{1000.0 * getattr(each, name):{sign}.0f}" for each in errors)
        for head, kind in (("crests lost", "peaks"), ("valleys filled", "valleys")):
            found = [self.extrema(name)[kind] for name in self.printed_mm]
            yield head, *("none seen" if each.count == 0 else f"{each.missed} of {each.count}" for each in found)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON: lengths in mm."""
        return {
            name.replace(" ", "_"): to_plain({"height_error": Summary.of(self.error_mm(name)), **self.extrema(name)})
            for name in self.printed_mm
        }


def _nearest_best(score: Floats) -> int:
    """Return the index of a nearly highest score in the middle half, the nearest to the middle."""
    count = len(score)
    middle = np.arange(count // 4, max(count // 4 + 1, count - count // 4))
    good = middle[score[middle] >= score[middle].max() - 0.02 * np.ptp(score[middle]) - 1e-9]
    return int(good[np.argmin(np.abs(good - (count - 1) / 2.0))])
