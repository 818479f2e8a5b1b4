"""Virtual printers: the height map of a block as a printer makes it, different for each copy.

The parameters describe such printers by their manufacturers' figures, slicers' defaults and the paper's observations on
its prints. They were set before any image was simulated and are not fitted to the paper's results.

A print is made in these steps:

1. Walls are displaced along x and y (``xy_error_mm``).
2. Narrow peaks lose height (``peak_loss``).
3. Details narrower than a line disappear (``nozzle_mm``).
4. The surface is divided into layers (``layer_mm``, ``layer_error_mm``) with round edges.
5. Lines become uneven (``roughness_mm``).
6. The whole print gets errors of height and tilt (``z_error_mm``, ``tilt_mm``).
7. Strings are added (``stringing_per_cm2``).

Another simulated printer can replace the virtual printer of its printer and filament (:class:`SimulatedPrinter`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.simulate.heights import HeightMap, cell_of, centres, held, on_block
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Study
from tacbench_cad.util.convert import Checked, Unchecked
from tacbench_cad.util.entries import load_named
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats
from tacbench_cad.util.untrusted import read_document

#: Peaks narrower than this number of lines cool too slowly to keep their height.
SLUMPING_LINES = 4.0
#: The standard deviation of the peak loss from place to place, as a fraction of the peak loss. On the paper's prints,
#: "some of the peaks are more defined than other peaks on the same print".
PEAK_SPREAD = 0.5
#: The correlation length of the errors of walls and peaks, in mm.
DRIFT_MM = 5.0
#: The thickness of a string on the surface, and the length of the longest one, in mm. Strings connect high places.
STRING_MM, STRING_LENGTH_MM = 0.08, 15.0
#: The height and the radius (standard deviation) of the blob at the start of a string, in mm.
BLOB_MM, BLOB_RADIUS_MM = 0.12, 0.25


#: A standard deviation in mm, or a fraction.
UpToOne = Annotated[float, Interval(ge=0.0, le=1.0)]


@dataclass(frozen=True, kw_only=True)
class VirtualPrinter(Checked):
    """A printer with a filament. Every error is a standard deviation between or within copies, in mm.

    Args:
        name: The printer and filament that it represents.
        nozzle_mm: The width of a line, and of the narrowest detail (the laser's spot for resin).
        layer_mm: The layer height.
        xy_error_mm: The displacement of walls, which changes slowly along each axis.
        layer_error_mm: The error of the height of each layer.
        z_error_mm: The error of the total height of each copy.
        tilt_mm: The rise of the top from one side to the other, along each axis, for each copy.
        peak_loss: The fraction of its height that a peak loses above the place where it is narrower than four lines.
        roughness_mm: The unevenness of the lines.
        stringing_per_cm2: The number of strings per cm^2 of the block.
    """

    name: str
    nozzle_mm: Annotated[float, Interval(ge=0.01, le=5.0)]
    layer_mm: Annotated[float, Interval(ge=0.005, le=2.0)]
    xy_error_mm: UpToOne
    layer_error_mm: UpToOne
    z_error_mm: UpToOne
    tilt_mm: UpToOne
    peak_loss: UpToOne
    roughness_mm: UpToOne
    stringing_per_cm2: Annotated[float, Interval(ge=0.0, le=100.0)]

    def heights(self, printed: PrintedBlock, rng: np.random.Generator) -> Floats:
        """See :class:`SimulatedPrinter`."""
        from scipy.ndimage import gaussian_filter

        block = printed.block
        cell = cell_of(block)
        x, y = centres(block)
        shift_x, shift_y = (self.xy_error_mm * _drift(along, rng) for along in (x, y))
        z = _designed(printed, x + shift_x, y + shift_y)
        thin = z - _opened(z, SLUMPING_LINES * self.nozzle_mm / cell)
        spread = 1.0 + PEAK_SPREAD * smooth_noise(z.shape, DRIFT_MM / 2.0 / cell, rng)
        z -= np.clip(self.peak_loss * spread, 0.0, 1.0) * thin
        z = _opened(z, self.nozzle_mm / cell)
        z = _layered(z, self, block.height_mm, rng)
        z = gaussian_filter(z, self.layer_mm / 2.0 / cell, mode="nearest")
        z += self.roughness_mm * smooth_noise(z.shape, self.nozzle_mm / 2.0 / cell, rng)
        rise_x, rise_y = self.tilt_mm * rng.standard_normal(2)
        z += rise_x * (x / block.size_mm[0] - 0.5)[None, :] + rise_y * (y / block.size_mm[1] - 0.5)[:, None]
        z += self.z_error_mm * rng.standard_normal()
        area_cm2 = block.size_mm[0] * block.size_mm[1] / 100.0
        count = int(rng.poisson(self.stringing_per_cm2 * area_cm2))
        return np.asarray(z + _strings(z, count, cell, rng))


class SimulatedPrinter(Protocol):
    """What a simulation needs to know about a printer.

    A :class:`VirtualPrinter` is such a printer. Extensions and other packages make others, from the files of
    ``tacbench simulate --printers``.

    Attributes:
        name: The name, with the printer and the filament that it represents.
        nozzle_mm: The diameter of the nozzle.
        layer_mm: The layer height.
    """

    @property
    def name(self) -> str:
        """The name."""

    @property
    def nozzle_mm(self) -> float:
        """The diameter of the nozzle."""

    @property
    def layer_mm(self) -> float:
        """The layer height."""

    def heights(self, printed: PrintedBlock, rng: np.random.Generator) -> Floats:
        """Return the heights of a print, shape (ny, nx), with z = 0 at the highest point of the block.

        Args:
            printed: The block, and its file.
            rng: The random generator of the copy.

        Returns:
            The heights on the block's cells (:func:`tacbench_cad.lab.simulate.heights.centres`).
        """


#: The presets, in the order of the fields.
#:
#: Layers of 0.2 mm are the slicers' default for 0.4 mm nozzles (Cura, Creality Print, Bambu Studio). Walls: calibration
#: cubes of printers with a moving bed are usually right within 0.1 to 0.2 mm, those of CoreXY printers within 0.1 mm.
#: Beds are levelled by hand, by a probe, or by a probe before each print. The paper writes that the Ender-3 "suffered
#: the most from webbing, and inconsistent layer heights"; it saw strings on all filament printers and none on the resin
#: prints, which all "looked and felt the same". Form 3: laser spot of 0.085 mm and layers of 0.05 mm by its
#: manufacturer; resin shrinks and is cured evenly.
_VALUES: tuple[tuple[Any, ...], ...] = (
    ("ender-3", 0.4, 0.2, 0.10, 0.03, 0.05, 0.04, 0.30, 0.030, 4.0),
    ("ender-3-v3-se", 0.4, 0.2, 0.08, 0.02, 0.03, 0.02, 0.25, 0.025, 2.0),
    ("bambu-p1p", 0.4, 0.2, 0.05, 0.008, 0.02, 0.015, 0.20, 0.015, 1.0),
    ("form-3", 0.085, 0.05, 0.03, 0.0, 0.02, 0.015, 0.05, 0.004, 0.0),
)
#: The virtual printers with presets, by the names of :mod:`tacbench_cad.lab.study.names`.
VIRTUAL_PRINTERS: Mapping[str, VirtualPrinter] = {
    str(values[0]): VirtualPrinter(**dict(zip((field.name for field in fields(VirtualPrinter)), values, strict=False)))
    for values in _VALUES
}
#: The factors of a filament for stringing, peak loss and roughness. The paper saw more strings on the cheaper PLA and
#: calls PETG "trickier to print with": it oozes more and stays soft longer than PLA.
FILAMENTS: Mapping[str, tuple[float, float, float]] = {
    "pla-plus": (1.0, 1.0, 1.0),
    "pla-minus": (1.5, 1.1, 1.2),
    "petg": (3.0, 1.3, 1.3),
    "grey-v4": (1.0, 1.0, 1.0),
}
#: The preset for other printers and filaments: a well maintained filament printer.
GENERIC_PRINTER, GENERIC_FILAMENT = "ender-3-v3-se", "pla-plus"


#: Simulated printers by printer and filament, which replace the virtual printers.
Printers = Mapping[tuple[str, str], Annotated[SimulatedPrinter, Unchecked()]]


def printer_of(printed: PrintedBlock, others: Printers | None = None) -> SimulatedPrinter:
    """Return the simulated printer of a printed block; the generic one for a printer or filament without a preset.

    Args:
        printed: The block.
        others: The simulated printers that replace virtual printers.
    """
    if others and (printed.printer, printed.filament) in others:
        return others[printed.printer, printed.filament]
    base = VIRTUAL_PRINTERS.get(printed.printer, VIRTUAL_PRINTERS[GENERIC_PRINTER])
    stringing, loss, roughness = FILAMENTS.get(printed.filament, FILAMENTS[GENERIC_FILAMENT])
    stands_in = "" if printed.printer in VIRTUAL_PRINTERS and printed.filament in FILAMENTS else f", as {base.name}"
    return replace(
        base,
        name=f"{printed.printer} with {printed.filament}{stands_in}",
        stringing_per_cm2=base.stringing_per_cm2 * stringing,
        peak_loss=min(base.peak_loss * loss, 1.0),
        roughness_mm=base.roughness_mm * roughness,
    )


def read_printers(paths: Sequence[Path]) -> Printers:
    """Read simulated printers from TOML files.

    The entry point of the group ``tacbench.simulated_printers`` whose name is the key ``format`` of a file reads it. It
    names a function that takes the path, and returns the printer, the filament and the :class:`SimulatedPrinter`.

    Raises:
        InputError: A file cannot be read, its format is unknown, or two files are of the same printer and filament.
        MissingToolError: The extension that reads a file is not installed.
    """
    printers: dict[tuple[str, str], SimulatedPrinter] = {}
    for path in paths:
        document = read_document(path, "printer", "toml")
        reader = load_named("tacbench.simulated_printers", f"{path}: format", str(document.get("format")))
        printer, filament, simulated = reader(path)
        if (printer, filament) in printers:
            raise InputError("printers", str(path), "is the second file of this printer and filament; give one")
        printers[printer, filament] = simulated
    return printers


def require_used(printers: Printers, study: Study) -> None:
    """Check that the study has prints by each printer.

    Raises:
        InputError: A printer is not used.
    """
    combinations = {(planned.printed.printer, planned.printed.filament) for planned in study.blocks}
    for own in printers:
        if own not in combinations:
            known = ", ".join(sorted(" with ".join(each) for each in combinations))
            raise InputError("printers", " with ".join(own), f"is not in the study, which has: {known}")


def seeded(*words: object) -> np.random.Generator:
    """Return a random generator that depends only on these words, on every machine."""
    digest = hashlib.sha256(" ".join(str(word) for word in words).encode()).digest()
    return np.random.Generator(np.random.SFC64(int.from_bytes(digest[:16], "big")))


def stimulus(
    printed: PrintedBlock, holder: HolderRim, printer: SimulatedPrinter | None = None, *, seed: int = 0
) -> HeightMap:
    """Return the surface under the sensor: the block as printed, the gap around it, and the holder's rim.

    Args:
        printed: The block. Its name, including the copy, determines its random errors.
        holder: The rim of the holder.
        printer: The simulated printer; None for the preset of its printer and filament.
        seed: The seed. Another seed gives other copies.

    Returns:
        The heights in the work frame. Its z = 0 is the highest point of the design.
    """
    heights = (printer or printer_of(printed)).heights(printed, seeded("print", seed, printed.name))
    return held(printed.block, on_block(printed.block, heights), holder)


def _designed(printed: PrintedBlock, x: Floats, y: Floats) -> Floats:
    """Return the heights of the printed file, (ny, nx), with z = 0 at the highest point of the block."""
    block, file = printed.block, printed.in_file
    shift_x, shift_y = ((own - side) / 2.0 for own, side in zip(file.size_mm, block.size_mm, strict=True))
    z = np.ascontiguousarray(file.surface.grid(x + shift_x, y + shift_y).T)
    return np.asarray(z + (file.formula_datum_mm - block.height_mm))


def _drift(along_mm: Floats, rng: np.random.Generator) -> Floats:
    """Return a smooth random function of the position along an axis, with standard deviation 1."""
    knots = np.arange(along_mm[0] - DRIFT_MM, along_mm[-1] + 2.0 * DRIFT_MM, DRIFT_MM)
    values = rng.standard_normal(knots.size)
    at = (along_mm - knots[0]) / DRIFT_MM
    left = at.astype(int)
    # Between two knots, the squares of the weights add up to 1, so the standard deviation is the same everywhere.
    turn = (at - left) * (math.pi / 2.0)
    return np.asarray(np.cos(turn) * values[left] + np.sin(turn) * values[left + 1], dtype=np.float64)


def smooth_noise(shape: tuple[int, ...], cells: float, rng: np.random.Generator) -> Floats:
    """Return noise with standard deviation 1 and a correlation length of ``cells`` cells."""
    from scipy.ndimage import gaussian_filter

    white = rng.standard_normal(shape)
    # White noise after a Gaussian kernel g has the variance sum(g^2), for wide kernels 1 / (4 pi cells^2).
    impulse = np.zeros(2 * math.ceil(4.0 * cells) + 3)
    impulse[impulse.size // 2] = 1.0
    gain = float(np.sum(gaussian_filter(impulse, cells) ** 2))
    return np.asarray(gaussian_filter(white, cells, mode="wrap") / gain, dtype=np.float64)


def _opened(z: Floats, width_cells: float) -> Floats:
    """Return the surface without details narrower than a disc of this diameter in cells (a morphological opening)."""
    from scipy.ndimage import grey_opening

    reach = int(width_cells / 2.0)
    if reach < 1:
        return z
    at = np.arange(-reach, reach + 1)
    disc = at[:, None] ** 2 + at[None, :] ** 2 <= (width_cells / 2.0) ** 2
    return np.asarray(grey_opening(z, footprint=disc, mode="nearest"), dtype=np.float64)


def _layered(z: Floats, printer: VirtualPrinter, height_mm: float, rng: np.random.Generator) -> Floats:
    """Divide the surface into layers. As in slicers, a layer is drawn where the design reaches its middle height."""
    layer = np.floor((z + height_mm) / printer.layer_mm + 0.5).astype(int)
    np.maximum(layer, 0, out=layer)
    errors = printer.layer_error_mm * rng.standard_normal(round(height_mm / printer.layer_mm) + 2)
    top = printer.layer_mm * layer + errors[np.minimum(layer, errors.size - 1)]
    return np.asarray(top - height_mm, dtype=np.float64)


def _strings(z: Floats, count: int, cell_mm: float, rng: np.random.Generator) -> Floats:
    """Return the height that strings add to the surface: from one high place to another, with a blob at the start."""
    added = np.zeros_like(z)
    high = np.argwhere(z >= np.quantile(z, 0.8))
    ny, nx = z.shape
    radius = 3.0 * BLOB_RADIUS_MM / cell_mm
    for _ in range(count):
        start = high[rng.integers(len(high))]
        ends = high[np.hypot(*(high - start).T) * cell_mm <= STRING_LENGTH_MM]
        end = ends[rng.integers(len(ends))]
        rows, columns = np.linspace(start, end, 2 * int(np.max(np.abs(end - start))) + 1).round().astype(int).T
        added[rows, columns] = np.maximum(added[rows, columns], STRING_MM)
        low = np.maximum(start - math.ceil(radius), 0)
        stop = np.minimum(start + math.ceil(radius) + 1, (ny, nx))
        at_y, at_x = (np.arange(a, b) - c for a, b, c in zip(low, stop, start, strict=True))
        square = (at_y[:, None] ** 2 + at_x[None, :] ** 2) * (cell_mm / BLOB_RADIUS_MM) ** 2
        added[low[0] : stop[0], low[1] : stop[1]] += BLOB_MM * np.exp(-square / 2.0)
    return added
