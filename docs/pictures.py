"""Make every picture of the docs from the parts and the simulation themselves: ``python docs/pictures.py``.

Each picture is drawn from a part that is built here, so that the docs cannot show what the project does not make.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from housing.coupon import Coupon
from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.block import Block
from tacbench_cad.block_part import block_part
from tacbench_cad.cli import main
from tacbench_cad.files import replacing
from tacbench_cad.lab.simulate.figures import simulated_images
from tacbench_cad.pictures import catalogue_picture, preview_sheet, texture_picture
from tacbench_cad.textures import read_texture

HERE = Path(__file__).parent
IMAGES = HERE / "images"


def draw() -> None:
    """Write all pictures into ``docs/images``."""
    IMAGES.mkdir(exist_ok=True)
    blocks = [Block.of(number) for number in range(1, 7)]
    holder = Holder(block=blocks[3])
    fixtures = [holder.part(), Jig(holder=holder).part()]
    preview_sheet([(part.name, part.mesh[0]) for part in (*map(block_part, blocks), *fixtures)], IMAGES / "preview.png")
    catalogue_picture(blocks, IMAGES / "textures.png")
    for number in (2, 4):
        texture_picture(blocks[number - 1], IMAGES / f"texture-{number}.png")
    texture_picture(blocks[3], IMAGES / "press.png", press=True)
    keyed = Block.of(4, key_mm=3.0, copy=1)
    tray = Holder(block=keyed, slots=6)
    jig_all = Jig(holder=Holder(block=blocks[3]), marks="all")
    options = [block_part(keyed), tray.part(), jig_all.part(), Coupon().part()]
    preview_sheet([(part.name, part.mesh[0]) for part in options], IMAGES / "options.png")
    published = [Block.of(number, "released") for number in (4, 6)]
    released = [*map(block_part, published), Holder(block=published[0], preset="released").part()]
    preview_sheet([(part.name, part.mesh[0]) for part in released], IMAGES / "released.png")
    own = read_texture(HERE / "hex.toml")
    preview_sheet([("hex", block_part(Block.of(own.texture, table=own.block)).mesh[0])], IMAGES / "hex.png")
    with replacing(IMAGES / "simulated.png") as path:
        simulated_images().savefig(path, dpi=200, metadata={"Software": None})
    analysis()


def analysis() -> None:
    """Draw the figures of the analysis from a simulated study, by the commands that the page names."""
    with tempfile.TemporaryDirectory() as name:
        study, results = f"{name}/study", Path(name) / "results"
        for argv in (
            ["simulate", "--study", "quick", "--out", study],
            ["variance", study, "-o", str(results)],
            ["classify", study, "-o", str(results), "--trials", "1"],
        ):
            if code := main(argv):
                raise SystemExit(code)
        for figure in ("variance", "between_textures", "ladder"):
            shutil.copyfile(results / f"{figure}.png", IMAGES / f"{figure.removesuffix('_textures')}.png")


if __name__ == "__main__":
    draw()
