"""The figures of the paper with which the analyses compare their results, each with its source in the paper.

The figures are not corrected. If the paper's text leaves a point open, the comment of the constant says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

#: The printer and the filament of a row, with names as in :mod:`tacbench_cad.lab.study.names`.
Combination = tuple[str, str]

#: The variance of textures 1 to 6 in counts^2, mean over pixels and positions. Source: the variance table of the paper.
#: According to the authors' notebooks it is the repeatability of single prints, not the variance between prints. It is
#: the variance over the two repeats of each print (ddof 0), then the mean over prints, positions and pixels, at one
#: force. The images were converted to grey as floating-point numbers and reduced to 40 %.
#: This is known for Bambu PLA- only. Its saved output from copies 1 to 4 is 2.80017674, 2.64039746, 3.61887302,
#: 3.6796849, 3.63699284, 3.51960279; the printed row is cut to two decimals. The notebook stored row numbers in 8 bits,
#: so from texture 2 on its frames do not show the named texture. ``tacbench variance --protocol as-published`` computes
#: the same quantity without this error.
PAPER_VARIANCE: Mapping[Combination, tuple[float, ...]] = {
    ("ender-3-v3-se", "pla-plus"): (2.60, 10.36, 12.12, 10.75, 7.026, 8.28),  # "| Ender-3 V3 SE, PLA+ | ..."
    ("bambu-p1p", "pla-minus"): (2.80, 2.64, 3.61, 3.67, 3.63, 3.51),  # "| Bambu, PLA- | ..."
    ("form-3", "grey-v4"): (2.31, 2.11, 2.8, 3.06, 3.32, 3.14),  # "| Resin | ..."
}


def texture_number(texture: str) -> int | None:
    """Return the number of one of the paper's textures; None for other textures."""
    match = re.fullmatch(r"texture-([1-6])", texture)
    return int(match[1]) if match else None


def variance_of(printer: str, filament: str, texture: str) -> float | None:
    """Return the paper's variance of a texture on one of its printers; None if the paper has no figure."""
    number, figures = texture_number(texture), PAPER_VARIANCE.get((printer, filament))
    return figures[number - 1] if number and figures else None


#: The names of the paper's rows in tables and sentences.
PAPER_ROW_NAMES: Mapping[Combination, str] = {
    ("ender-3-v3-se", "pla-plus"): "Ender-3 V3 SE PLA+",
    ("bambu-p1p", "pla-minus"): "Bambu P1P PLA-",
    ("form-3", "grey-v4"): "Form 3 resin",
}
#: The number of prints of each texture in the text, for the three selected printers and filaments. The notebook used
#: the first four prints.
PRINTS = 6
#: The number of repeats at each position.
REPEATS = 2
#: The number of positions of the 5 x 5 grid.
POSITIONS = 25

#: The "average pixel variation" of the stationary sensor. Source: the text of the paper, which gives no unit.
FLOOR = 2.6
#: :data:`FLOOR` in counts^2, if it is a variance and if it is a standard deviation.
PAPER_FLOORS: Mapping[str, float] = {"variance": FLOOR, "standard deviation": FLOOR**2}


@dataclass(frozen=True, kw_only=True)
class PublishedAccuracy:
    """One row of the paper's classification table, with accuracies in %.

    Args:
        model: The estimator, ``forest`` or ``network``.
        train_on: The printer, and the filament that the text names for it (see :data:`CLASSIFICATION`).
        train: The accuracy on the training images.
        test: The accuracy on the 20 % split.
        unseen: The accuracy on all other printers and filaments.
    """

    model: str
    train_on: Combination
    train: float
    test: float
    unseen: float


#: Source: the classification table of the paper. The caption of a confusion matrix says 53 % for the Bambu forest, the
#: table 63.98 %. For the Ender-3 V3 SE classifiers the text names PLA-, the variance table PLA+.
CLASSIFICATION: tuple[PublishedAccuracy, ...] = (
    PublishedAccuracy(model="forest", train_on=("ender-3-v3-se", "pla-plus"), train=100.0, test=99.53, unseen=31.4),
    PublishedAccuracy(model="network", train_on=("ender-3-v3-se", "pla-plus"), train=99.7, test=99.3, unseen=33.21),
    PublishedAccuracy(model="forest", train_on=("bambu-p1p", "pla-minus"), train=100.0, test=99.7, unseen=63.98),
    PublishedAccuracy(model="network", train_on=("bambu-p1p", "pla-minus"), train=100.0, test=99.8, unseen=53.73),
    PublishedAccuracy(model="forest", train_on=("form-3", "grey-v4"), train=100.0, test=99.3, unseen=70.66),
    PublishedAccuracy(model="network", train_on=("form-3", "grey-v4"), train=100.0, test=99.9, unseen=61.41),
)
#: The number of trials over which each accuracy was averaged.
TRIALS = 20
