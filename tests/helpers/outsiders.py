"""Programs of other projects, and the parts that they open. A test whose program is missing is skipped."""

from __future__ import annotations

import shutil
import socket
import subprocess
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from helpers.cases import mostly_long
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.interpolation import height_map
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.textures import Texture

#: No single run of another program may take longer than this, in seconds.
PATIENCE_S = 300.0

#: The outlines of blocks that are not rectangles.
OUTLINES = {"disc": "disc:30", "hexagon": "hexagon:30", "ring": "ring:30,12"}

#: The names of the parts that other programs open (:func:`part_named`), and those that they open in the quick run: a
#: plain and a steep block, an aliased block of the released files, key and label, a height map, a ring, and a fixture.
PARTS = [
    *(f"{preset}-{number}" for preset in ("paper", "released") for number in range(1, 7)),
    *("grid-4", "grid-6", "keyed-4", "keyed-2", "net-weave", "net-map", "disc-2", "hexagon-4", "ring-2"),
    *("holder", "tray", "holder-released", "jig", "jig-all", "coupon"),
]
QUICK = ("paper-2", "paper-4", "released-6", "keyed-2", "net-map", "ring-2", "jig")
each_part = pytest.mark.parametrize("name", mostly_long(PARTS, *QUICK))

Run = Callable[[Sequence[str | Path]], str]
Written = Callable[[str, str], Path]


def program(name: str, package: str) -> Run:
    """Return a function that runs a program, requires exit code 0 and returns the program's output."""
    executable = shutil.which(name)
    if executable is None:
        pytest.skip(f"{name} is not installed: apt-get install {package}")

    def run(arguments: Sequence[str | Path]) -> str:
        result = subprocess.run(
            [executable, *map(str, arguments)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )
        output = result.stdout + result.stderr
        assert result.returncode == 0, f"{name} ended with {result.returncode}: {output[-2000:]}"
        return output

    return run


def free_port() -> int:
    """The number of a port of this machine that nobody uses."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def _net_block(name: str) -> Block:
    if name == "weave":
        surface: Surface = plane_waves((0.7, 1.0, 0.5), (0.7, 1.0, -0.5))
        return Block.of(Texture(name=name, equation="", surface=surface))
    x, y = np.meshgrid(np.linspace(0.0, 30.0, 120), np.linspace(0.0, 30.0, 120))
    heights = np.sin(x) * np.sin(1.3 * y) + np.exp(-((x - 9.0) ** 2 + (y - 20.0) ** 2) / 4.0)
    surface = height_map(heights, mm_per_pixel=30.0 / 119, height_mm=(0.0, 1.5))
    return Block.of(
        Texture(name=name, equation="", surface=surface), mm_per_unit=(1.0, 1.0, 1.0), key_mm=3.0, label=True
    )


def _block(name: str) -> PrintPart:
    """Return the block of a kind and texture: ``paper-4``, ``released-2``, ``grid-6`` or ``keyed-4``.

    ``net-weave`` has oblique waves, and ``net-map`` is a height map with a key and a label. ``disc-2``, ``hexagon-2``
    and ``ring-2`` have other outlines.
    """
    kind, number = name.split("-")
    if kind == "net":
        return block_part(_net_block(number))
    if kind in OUTLINES:
        return block_part(Block.of(number, outline=OUTLINES[kind], label=kind == "disc"))
    if kind in ("paper", "released"):
        return block_part(Block.of(number, kind))
    if kind == "grid":
        return block_part(Block.of(number, sampling="grid"))
    assert kind == "keyed", name
    return block_part(Block.of(number, key_mm=3.0, label=True, copy=12))


@cache
def part_named(name: str) -> PrintPart:
    """Return a part of the print set; fixtures need the CAD kernel.

    Args:
        name: ``holder``, ``holder-released``, ``tray`` (six slots), ``jig``, ``jig-all``, ``coupon``, or a block.
    """
    if name.split("-")[0] not in ("holder", "tray", "jig", "coupon"):
        return _block(name)
    pytest.importorskip("build123d", reason="fixtures need the extra cad")
    from housing.coupon import Coupon
    from housing.holder import Holder
    from housing.jig import Jig

    block = Block.of(2)
    fixtures: dict[str, Callable[[], PrintPart]] = {
        "holder": lambda: Holder(block=block).part(),
        "holder-released": lambda: Holder(block=Block.of(2, "released"), preset="released").part(),
        "tray": lambda: Holder(block=block, slots=6).part(),
        "jig": lambda: Jig(holder=Holder(block=block)).part(),
        "jig-all": lambda: Jig(holder=Holder(block=block), marks="all").part(),
        "coupon": Coupon().part,
    }
    return fixtures[name]()
