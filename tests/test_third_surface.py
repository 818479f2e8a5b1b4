"""A surface of a kind that this package does not have becomes a block, a file with a certificate, and presses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike

from tacbench_cad import Block, InputError, Surface, Texture, Tolerance, as_part, export
from tacbench_cad.lab.runs.info import printed_block_from
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock
from tacbench_cad.spec import Circle, Domain, Extremes, Outline, spectrum
from tacbench_cad.util.types import Floats


@dataclass(frozen=True)
class Saddle(Surface):
    """The surface ``z = a (u - c)^2 - b (v - d)^2`` in mm over a rectangle from the origin."""

    a: float = 0.02
    b: float = 0.01
    c: float = 10.0
    d: float = 15.0
    size: tuple[float, float] = (20.0, 30.0)
    unit: Literal["units", "mm"] = "mm"
    error: float = 0.0
    evidence: Literal["proved", "measured"] = "proved"
    is_flat: bool = False
    is_separable: bool = False
    highest_frequency: tuple[float, float] = (0.1, 0.1)

    @property
    def creases(self) -> tuple[Floats, Floats]:
        return np.zeros(0), np.zeros(0)

    breaks = creases

    @property
    def ends(self) -> Domain:
        return (0.0, self.size[0]), (0.0, self.size[1])

    @property
    def amplitude_sum(self) -> float:
        return self.bound(0, 0)

    def __call__(self, u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
        x, y = np.broadcast_arrays(np.asarray(u, dtype=float) - self.c, np.asarray(v, dtype=float) - self.d)
        along = {0: self.a * x**2, 1: 2.0 * self.a * x, 2: 2.0 * self.a + 0.0 * x}
        across = {0: -self.b * y**2, 1: -2.0 * self.b * y, 2: -2.0 * self.b + 0.0 * y}
        if order == (0, 0):
            return along[0] + across[0]
        zero = np.zeros(x.shape)
        return along.get(order[0], zero) if order[1] == 0 else across.get(order[1], zero) if order[0] == 0 else zero

    def grid(self, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        return self(u[:, None], v[None, :], order)

    def gradient(self, u: ArrayLike, v: ArrayLike) -> tuple[Floats, Floats]:
        return self(u, v, (1, 0)), self(u, v, (0, 1))

    def bound(self, order_u: int, order_v: int) -> float:
        u, v = (np.array(each) for each in self.ends)
        corners = np.abs(self.grid(u, v, (order_u, order_v))).max()
        return float(corners if (order_u, order_v) != (0, 0) else self.grid(u, np.array([self.d])).max() + corners)

    def cell_bounds(self, u: Floats, v: Floats, order: tuple[int, int]) -> Floats:
        return np.full((len(u) - 1, len(v) - 1), self.bound(*order))

    def integral(self, u: tuple[float, float], v: tuple[float, float]) -> float:
        x, y = np.array(u) - self.c, np.array(v) - self.d
        along, across = self.a * np.diff(x**3)[0] / 3.0, self.b * np.diff(y**3)[0] / 3.0
        return float(along * np.diff(y)[0] - across * np.diff(x)[0])

    def integral_triangle(self, corners: Sequence[tuple[float, float]]) -> float:
        p = np.array(corners)
        middle = (p + np.roll(p, 1, axis=0)) / 2.0
        area = abs((p[1] - p[0])[0] * (p[2] - p[0])[1] - (p[2] - p[0])[0] * (p[1] - p[0])[1]) / 2.0
        return float(area * self(*middle.T).mean())

    def extremes(self, u: tuple[float, float], v: tuple[float, float], region: Outline | None = None) -> Extremes:
        assert region is None
        x, y = np.array([*u, min(max(self.c, u[0]), u[1])]), np.array([*v, min(max(self.d, v[0]), v[1])])
        z = self.grid(x, y)
        low, high = np.unravel_index(z.argmin(), z.shape), np.unravel_index(z.argmax(), z.shape)
        places = [(float(x[i]), float(y[j])) for i, j in (low, high)]
        return Extremes(float(z.min()), float(z.max()), places[0], places[1], 0.0)

    def mapped(
        self,
        per_unit: tuple[float, float],
        height_per_unit: float,
        origin: tuple[float, float] = (0.0, 0.0),
        unit: Literal["units", "mm"] | None = None,
    ) -> Saddle:
        x, y = per_unit
        return replace(
            self,
            a=self.a * height_per_unit / x**2,
            b=self.b * height_per_unit / y**2,
            c=(self.c - origin[0]) * x,
            d=(self.d - origin[1]) * y,
            size=((self.size[0] - origin[0]) * x, (self.size[1] - origin[1]) * y),
            unit=unit or self.unit,
        )

    def over(self, u: tuple[float, float], v: tuple[float, float]) -> Saddle:
        return self


SADDLE = Texture(name="saddle", surface=Saddle(), equation="a saddle")
BLOCK = Block.of(SADDLE, sampling=Tolerance(mm=0.02))

POINTS = np.random.default_rng(0).uniform(2.0, 18.0, (2, 100))


def test_the_block_has_the_size_and_the_relief_of_the_surface() -> None:
    assert BLOCK.size_mm == (20.0, 30.0)
    assert BLOCK.relief_mm == pytest.approx(0.02 * 100.0 + 0.01 * 225.0)


@pytest.mark.parametrize("ending", ["stl", "step"])
def test_a_file_is_made_and_certified(ending: str, tmp_path: Path) -> None:
    if ending == "step":
        pytest.importorskip("OCP")
    report = export(BLOCK, tmp_path / f"saddle.{ending}")
    assert report.ok and (report.deviation_mm or 0.0) <= 0.021
    assert as_part(BLOCK).mesh[1].certificate.evidence == "proved"


def test_it_is_pressed_and_stored_within_its_error() -> None:
    printed = PrintedBlock(block=BLOCK, printer="ender-3", filament="pla")
    contact = contact_for(printed, HolderRim())
    assert contact.force_n(10.0, 15.0, contact.z_for_force(10.0, 15.0, 1.0)) == pytest.approx(1.0, rel=1e-3)
    again = printed_block_from(printed.as_dict())
    difference = np.abs(again.block.surface(*POINTS) - BLOCK.surface(*POINTS))
    assert difference.max() <= again.block.surface.error < 1e-3


def test_its_wavelengths_and_its_volume_below_a_disc_are_known() -> None:
    assert spectrum(BLOCK).printable(0.4) > 0.99
    radius = 8.0
    disc = Circle((10.0, 15.0), radius)
    assert disc.integral(BLOCK.surface) == pytest.approx(0.01 * math.pi * radius**4 / 4.0, rel=1e-4)


def test_it_can_be_turned_added_and_faded() -> None:
    surface = SADDLE.surface
    u, v = POINTS
    total = surface + 0.5 * Texture.hex_bumps(pitch_mm=4.0, height_mm=0.4).surface
    expected = surface(u, v) + 0.5 * Texture.hex_bumps(pitch_mm=4.0, height_mm=0.4).surface(u, v)
    assert np.abs(total(u, v) - expected).max() <= total.error
    assert np.abs(surface.windowed(1.0)(u, v) - surface(u, v)).max() <= surface.windowed(1.0).error + 1e-9


def test_something_else_is_refused_with_what_it_lacks() -> None:
    with pytest.raises(InputError, match="another Surface; it has no along_u"):
        Texture(name="sine", surface=math.sin)  # type: ignore[arg-type]
