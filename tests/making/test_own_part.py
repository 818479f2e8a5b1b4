"""A part that a user defines, with its own kind, is exported, checked and built like the parts of this project."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

import pytest

pytest.importorskip("build123d")
pytest.importorskip("lib3mf")

import build123d as bd
import cadquery as cq

from housing import Holder
from tacbench_cad import Block, CheckFailedError, InputError, PrintPart, Request, as_part, check, export
from tacbench_cad.cq import textured

HOLDER = Holder(block=Block.of(1))
HEIGHT_MM = 4.0


@dataclass(frozen=True)
class Spacer:
    """A plate with screw holes below the holder, as a user may define it in a script."""

    holder: Holder

    def part(self) -> PrintPart:
        x, y, _ = self.holder.size_mm
        low, middle = (bd.Align.MIN,) * 3, (bd.Align.CENTER, bd.Align.CENTER, bd.Align.MIN)
        bores = self.holder.screws
        holes = [bd.Pos(*bore.at_mm) * bd.Cylinder(bore.diameter_mm / 2, HEIGHT_MM, align=middle) for bore in bores]
        solid = (bd.Box(x, y, HEIGHT_MM, align=low) - holes).solid()
        volume = HEIGHT_MM * (x * y - sum(pi * bore.diameter_mm**2 / 4 for bore in bores))
        return PrintPart.of_solid(
            solid, name="spacer", kind="spacer", genus=4, volume_mm3=volume, spec={"kind": "example"}
        )


@pytest.mark.parametrize("ending", ["stl", "3mf", "step"])
def test_it_is_exported_and_checked(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"spacer.{ending}"
    assert export(Spacer(HOLDER), path).ok
    assert check(path, Spacer(HOLDER)).ok and check(path, full=False).ok
    wrong = replace(as_part(Spacer(HOLDER)), genus=3)
    assert [fault.name for fault in check(path, wrong).faults] == ["genus"]
    with pytest.raises(CheckFailedError, match="volume"):
        export(PrintPart.of_solid(bd.Box(1, 2, 3), name="box", volume_mm3=6.01), tmp_path / f"box.{ending}")


def test_it_is_shown_on_the_page_and_in_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("k3d")
    from tacbench_cad import part_picture, write_view

    scene = write_view(Request(textures=(1,), parts=(Spacer(HOLDER),)), tmp_path / "view.html")
    assert [thing.kind for thing in scene.things] == ["spacer"]
    part_picture(Spacer(HOLDER), tmp_path / "spacer.png")
    assert (tmp_path / "spacer.png").stat().st_size > 1000


def test_a_round_solid_of_cadquery_is_moved_to_the_origin(tmp_path: Path) -> None:
    ring = cq.Workplane().circle(10.0).circle(6.0).extrude(3.0).translate((50.0, -20.0, 7.0))
    part = PrintPart.of_solid(ring, name="ring", genus=1)
    assert part.size_mm == pytest.approx((20.0, 20.0, 3.0), abs=1e-5)
    assert part.solid[1].volume_mm3 == pytest.approx(pi * 64.0 * 3.0)
    for ending in ("stl", "step"):
        assert export(part, tmp_path / f"ring.{ending}").ok


def test_a_textured_solid_can_be_made_into_a_part_again(tmp_path: Path) -> None:
    solid = textured(cq.Workplane().box(12, 10, 3), ">Z", 2, depth_mm=0.5)
    part = PrintPart.of_solid(solid, name="pad")
    assert part.size_mm == pytest.approx((12.0, 10.0, 3.7), abs=2e-3)
    for ending in ("stl", "step"):
        assert export(part, tmp_path / f"pad.{ending}").ok
    heavier = PrintPart.of_solid(solid, name="pad", volume_mm3=1.01 * part.solid[1].volume_mm3)
    with pytest.raises(CheckFailedError, match="volume"):
        export(heavier, tmp_path / "heavier.step")


def test_bad_parts_are_refused() -> None:
    with pytest.raises(InputError, match="must be a solid"):
        PrintPart.of_solid("box", name="box")
    with pytest.raises(InputError, match="only planes, cylinders, cones and splines"):
        PrintPart.of_solid(bd.Sphere(3), name="ball")
    with pytest.raises(InputError, match="part name"):
        PrintPart.of_solid(bd.Box(1, 1, 1), name="../box")
