"""A figure of simulated images, marked as simulated: the six textures at the paper's three forces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.lab.simulate.contact import DomeContact, contact_for
from tacbench_cad.lab.simulate.prints import seeded
from tacbench_cad.lab.simulate.tactip import SIMULATED, TacTip
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol
from tacbench_cad.spec.block import Block
from tacbench_cad.util.packages import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

#: The textures in the figure: one print of each, at the centre of the press grid.
TEXTURES = (1, 2, 3, 4, 5, 6)
#: The printer and the filament of these prints.
PRINTER, FILAMENT = "bambu-p1p", "pla-minus"
#: Half the side of the height map's section in mm, and of an image in pixels.
_GROUND_MM = 12.0
_IMAGE_PX = 118.0
_COLOUR = "#ff5a36"


def simulated_images() -> Figure:
    """Create a matplotlib figure with the heights under the sensor, then an image for each force, for each texture.

    The images are cropped to the pins that move. Lines lead from the position of a pin at rest to its present one. The
    outline on the heights is the contact at the largest force.

    Returns:
        The figure, 7.2 by 4.85 inches, for the caller to save.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    require("the figure", "matplotlib")
    from matplotlib.figure import Figure

    protocol = Protocol()
    positions = protocol.grid.positions_mm
    x, y = (float(value) for value in positions[len(positions) // 2])
    figure = Figure(figsize=(7.2, 4.85), dpi=200)
    figure.set_layout_engine("constrained", w_pad=0.01, h_pad=0.02, wspace=0.01, hspace=0.01)
    panels = figure.subplots(1 + protocol.levels, len(TEXTURES))
    grounds = []
    for column, texture in enumerate(TEXTURES):
        printed = PrintedBlock(block=Block.of(texture), printer=PRINTER, filament=FILAMENT)
        contact = contact_for(printed, HolderRim())
        grounds.append(_show_ground(panels[0, column], contact, x, y, protocol.forces_n[-1]))
        panels[0, column].set_title(f"texture {texture}", fontsize=8)
        for row, force in enumerate(protocol.forces_n, start=1):
            _show_image(panels[row, column], contact, x, y, force, f"figure {texture} {row}")
    panels[0, 0].set_ylabel(f"heights, {2 * _GROUND_MM:g} mm wide", fontsize=7)
    for row, force in enumerate(protocol.forces_n, start=1):
        panels[row, 0].set_ylabel(f"{force:.2f} N", fontsize=7)
    bar = figure.colorbar(grounds[-1], ax=panels[0, :].tolist(), pad=0.01, fraction=0.02)
    bar.ax.tick_params(labelsize=6)
    bar.set_label("height (mm)", fontsize=6)
    figure.suptitle(
        f"{SIMULATED} on virtual prints ({PRINTER}, {FILAMENT}) at x = {x:g}, y = {y:g} mm: no real images", fontsize=8
    )
    return figure


def _show_ground(panel: Axes, contact: DomeContact, x_mm: float, y_mm: float, force_n: float) -> AxesImage:
    """Show the heights around the summit, and the outline of the contact."""
    _bare(panel)
    rows, columns = contact.ground.near(x_mm, y_mm, _GROUND_MM)
    heights = contact.ground.z_mm[rows, columns]
    extent = (-_GROUND_MM, _GROUND_MM, -_GROUND_MM, _GROUND_MM)
    shown = panel.imshow(
        np.where(np.isfinite(heights), heights, np.nan), origin="lower", extent=extent, cmap="cividis", vmin=-5, vmax=0
    )
    panel.set_facecolor("black")
    overlap = contact.overlap(x_mm, y_mm, contact.z_for_force(x_mm, y_mm, force_n))
    touching = (overlap.depth_mm > 0.0).astype(float)
    panel.contour(overlap.x_mm, overlap.y_mm, touching, levels=[0.5], colors=_COLOUR, linewidths=0.5)
    panel.set_xlim(extent[:2])
    panel.set_ylim(extent[2:])
    return shown


def _show_image(panel: Axes, contact: DomeContact, x_mm: float, y_mm: float, force_n: float, seed: str) -> None:
    """Show an image with a line for each pin."""
    _bare(panel)
    sensor = TacTip(colour=False)
    pins = sensor.pins(contact, (x_mm, y_mm, contact.z_for_force(x_mm, y_mm, force_n)))
    panel.imshow(sensor.frame(pins, seeded(seed)), cmap="gray", vmin=0, vmax=255)
    at_rest, now = sensor.camera.pixels(sensor.rest.tips_mm), sensor.camera.pixels(pins.tips_mm)
    panel.plot(*np.stack([at_rest, now], axis=1).T, color=_COLOUR, linewidth=0.8, solid_capstyle="round")
    middle = sensor.camera.middle_px
    panel.set_xlim(middle[0] - _IMAGE_PX, middle[0] + _IMAGE_PX)
    panel.set_ylim(middle[1] + _IMAGE_PX, middle[1] - _IMAGE_PX)


def _bare(panel: Axes) -> None:
    panel.set_xticks([])
    panel.set_yticks([])
