"""The 3D page in a real browser: it draws, loads nothing, and its colours are the deviation that they stand for."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("k3d", reason="the 3D page needs the extra view")
pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install playwright")

from PIL import Image

from tacbench_cad.making.request import Request
from tacbench_cad.making.showing import request_of, scene_of
from tacbench_cad.render.viewing.page import write_page
from tacbench_cad.render.viewing.scene import Scene, Thing
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.packages import why_missing
from tacbench_cad.util.types import Bytes, Floats

pytestmark = pytest.mark.real

#: A page that has not drawn by then never will, in ms.
PATIENCE_MS = 60_000
WIDTHS = {1200: 800, 390: 844}


@dataclass(frozen=True, eq=False)
class Opened:
    """A page in the browser and what it has said and asked for so far."""

    page: Any
    asked: list[str]
    said: list[str]

    def act(self, script: str) -> None:
        """Run a script of the page and wait until the picture has followed."""
        self.page.evaluate(f"() => {{ {script} }}")
        self.settle()

    def settle(self) -> None:
        """Wait until a picture begun after everything so far is finished."""
        self.page.evaluate(
            "() => new Promise((done) => { const K = tacbench.K3D; let id = K.on(K.events.RENDERED, () => {"
            " K.off(K.events.RENDERED, id); requestAnimationFrame(() => requestAnimationFrame(done)); });"
            " requestAnimationFrame(() => requestAnimationFrame(() => K.render())); })"
        )

    def picture(self) -> Bytes:
        """What is seen, (height, width, 3)."""
        return np.asarray(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB"))

    def stage(self) -> dict[str, float]:
        """The place of the 3D view on the page: x, y, width, height in pixels."""
        box: dict[str, float] = self.page.locator("#stage").bounding_box()
        return box

    def where(self, points: Floats) -> Floats:
        """Pixels (n, 2) of points (n, 3) of the world."""
        stage = self.stage()
        found = self.page.evaluate("(points) => points.map((p) => tacbench.project(p))", points.tolist())
        return np.asarray(found) + np.array([stage["x"], stage["y"]])


def opened(browser: Any, file: Path, width: int) -> Opened:
    page = browser.new_page(viewport={"width": width, "height": WIDTHS[width]})
    one = Opened(page=page, asked=[], said=[])
    page.on("request", lambda request: one.asked.append(request.url))
    page.on("console", lambda said: one.said.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: one.said.append(str(error)))
    page.goto(file.as_uri())
    page.wait_for_selector("body[data-ready]", state="attached", timeout=PATIENCE_MS)
    one.settle()
    return one


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    """The whole set as it is made without any option."""
    path = tmp_path_factory.mktemp("page") / "view.html"
    scene = scene_of(request_of((), Request()))
    write_page(scene, path)
    return scene, path


@pytest.fixture(scope="module", params=list(WIDTHS))
def shown(request: pytest.FixtureRequest, browser: Any, whole: tuple[Scene, Path]) -> Iterator[Opened]:
    one = opened(browser, whole[1], request.param)
    yield one
    one.page.close()


@pytest.fixture(scope="module")
def wide(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Scene, Opened]]:
    """Blocks with labels, coarse enough that triangles are many pixels wide."""
    path = tmp_path_factory.mktemp("coarse") / "view.html"
    scene = scene_of(request_of(("1", "2", "6"), Request(sampling=Tolerance(mm=0.04), label=True)))
    write_page(scene, path)
    one = opened(browser, path, 1200)
    yield scene, one
    one.page.close()


def test_nothing_is_loaded_and_nothing_complained_of(shown: Opened, whole: tuple[Scene, Path]) -> None:
    outside = [url for url in shown.asked if not url.startswith("blob:")]
    assert outside == [whole[1].as_uri()]
    assert shown.said == []


@pytest.mark.parametrize("width", list(WIDTHS))
def test_the_page_opens_on_the_texture(browser: Any, whole: tuple[Scene, Path], width: int) -> None:
    """The block is seen from above in the middle of the view; the jig that would hide it has a switch."""
    thing = whole[0].things[0]
    one = opened(browser, whole[1], width)
    one.act("tacbench.change({sizes: false})")
    x, y = np.meshgrid(np.linspace(4.0, 19.0, 8), np.linspace(4.0, 26.0, 8))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(64, 6.0), np.ones(64)]) @ thing.to_world.T
    stage = one.stage()

    def seen() -> tuple[Floats, float]:
        pixels = np.floor(one.where(points[:, :3])).astype(int)
        colours = one.picture()[pixels[:, 1], pixels[:, 0]].astype(float)
        return pixels, float(np.mean(colours[:, 0] > 1.2 * colours[:, 2]))

    pixels, block = seen()
    assert block > 0.9, "the block's colour"
    middle = np.array([stage["x"] + stage["width"] / 2, stage["y"] + stage["height"] / 2])
    assert np.all(np.abs(pixels.mean(axis=0) - middle) < 0.15 * np.array([stage["width"], stage["height"]]))
    if why_missing("build123d") is None:
        assert "jig_paper_x1" not in one.page.locator("#facts").inner_text()
        one.page.check("#jig")
        one.act("tacbench.change({apart: 0})")
        assert seen()[1] < 0.1, "the jig lies on the block"
        assert "jig_paper_x1" in one.page.locator("#facts").inner_text()
        one.page.uncheck("#jig")
        one.settle()
        assert seen()[1] > 0.9
    one.page.close()


def test_the_page_is_small(whole: tuple[Scene, Path]) -> None:
    assert whole[1].stat().st_size < 5_000_000


def test_every_view_is_drawn_and_no_wider_than_the_screen(shown: Opened) -> None:
    width = shown.page.viewport_size["width"]
    pictures = []
    for button in shown.page.locator("#views button").all():
        button.click()
        shown.settle()
        box, picture = shown.stage(), shown.picture()
        part = picture[int(box["y"]) : int(box["y"] + box["height"]), int(box["x"]) : int(box["x"] + box["width"])]
        covered = np.mean(np.abs(part.astype(int) - [0xF6, 0xF7, 0xF9]).max(axis=2) > 8)
        assert 0.1 < covered < 0.9, button.inner_text()
        assert shown.page.evaluate("document.scrollingElement.scrollWidth") == width
        pictures.append(part)
    names = shown.page.locator("#views button").all_inner_texts()
    assert names == (
        ["Texture", "Block"] if why_missing("build123d") else ["Texture", "Block", "Holder", "Jig", "Assembly"]
    )
    assert all(not np.array_equal(a, b) for i, a in enumerate(pictures) for b in pictures[:i])


def test_letters_are_large_enough_to_read(shown: Opened) -> None:
    least = shown.page.evaluate(
        "() => Math.min(...[...document.querySelectorAll('aside *, header *, #scale *')]"
        ".filter((one) => one.offsetParent && one.tagName !== 'PRE' && one.textContent.trim())"
        ".map((one) => parseFloat(getComputedStyle(one).fontSize)))"
    )
    assert least >= 13.0
    small = shown.page.evaluate(
        "() => [...document.querySelectorAll('button, select')].filter((one) => one.offsetParent"
        " && one.getBoundingClientRect().height < 32).map((one) => one.id || one.textContent)"
    )
    assert small == [], "too small for a finger"


def near_look(one: Opened, thing: Thing, at: tuple[float, float], above: float) -> None:
    """Look straight down on a place of a block from some height over its top."""
    x, y, z, _ = thing.to_world @ [*at, float(thing.mesh.vertices[:, 2].max()), 1.0]
    one.act(f"tacbench.K3D.setCamera([{x}, {y - 0.001}, {z + above}, {x}, {y}, {z}, 0, 0, 1])")


def legend(one: Opened) -> Floats:
    """The colours of the scale shown, evenly spaced from its low end to its high end; shape (n, 3)."""
    drawn = one.page.evaluate("getComputedStyle(document.querySelector('#scale .bar')).backgroundImage")
    return np.array([[float(c) for c in rgb] for rgb in re.findall(r"rgb\((\d+), (\d+), (\d+)\)", drawn)])


def scale_ends(one: Opened) -> tuple[float, float]:
    ticks = one.page.locator("#scale .ticks span").all_inner_texts()
    return float(ticks[0]), float(ticks[-1])


def tops(thing: Thing, at: tuple[float, float], reach: float) -> Floats:
    """Points (n, 3) of the mesh's top near a place, in the block frame; none on slopes over 70 degrees."""
    corners = thing.mesh.triangle_points
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lying = (up[:, 2] > 0.35 * np.linalg.norm(up, axis=1)) & (corners[:, :, 2].min(axis=1) > 1.0)
    a, b, c = np.moveaxis(corners[lying], 1, 0)
    points = []
    for x, y in np.random.default_rng(5).uniform(-reach, reach, (300, 2)) + np.array(at):
        sides = [(q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0]) for p, q in ((b, c), (c, a))]
        area = up[lying][:, 2]
        first, second = sides[0] / area, sides[1] / area
        # A little inside of a triangle: at its edge a pixel may show its neighbour.
        inside = np.flatnonzero((first > 0.02) & (second > 0.02) & (first + second < 0.98))
        if len(inside) == 1:
            (i,) = inside
            z = first[i] * a[i, 2] + second[i] * b[i, 2] + (1.0 - first[i] - second[i]) * c[i, 2]
            points.append((x, y, z))
    return np.array(points)


@pytest.mark.parametrize("number", [0, 1, 2], ids=["texture-1", "texture-2", "texture-6"])
def test_colours_are_the_deviation(wide: tuple[Scene, Opened], number: int) -> None:
    scene, one = wide
    thing = scene.things[number]
    formula = thing.formula
    assert formula is not None
    at = (11.0, 15.0)
    one.act(f"tacbench.goTo('block'); tacbench.change({{block: {number}, colour: 'deviation', sizes: false}})")
    near_look(one, thing, at, 9.0)
    points = tops(thing, at, 2.0)
    assert len(points) > 100
    a, f, g, phase = formula.waves.T[:, :, None]
    angle = f * points[:, 0] + g * points[:, 1] + phase
    slope = np.hypot((a * f * np.cos(angle)).sum(axis=0), (a * g * np.cos(angle)).sum(axis=0))
    distance = (points[:, 2] - formula.datum_mm - (a * np.sin(angle)).sum(axis=0)) / np.hypot(1.0, slope)
    assert np.abs(distance).max() <= formula.bound_mm, "the certificate itself would be wrong"
    low, high = scale_ends(one)
    assert high == -low == pytest.approx(1000.0 * formula.bound_mm, rel=5e-3)
    colours = legend(one)
    place = (distance / formula.bound_mm + 1.0) / 2.0 * (len(colours) - 1)
    expected = np.column_stack([np.interp(place, np.arange(len(colours)), colours[:, c]) for c in range(3)])
    pixels = np.floor(one.where(points)).astype(int)
    found = one.picture()[pixels[:, 1], pixels[:, 0]].astype(float)
    wrong = np.abs(found - expected).max(axis=1)
    assert np.ptp(distance) > 0.5 * formula.bound_mm, "too little to tell"
    assert np.mean(wrong < 16.0) > 0.95, f"{np.sort(wrong)[-10:]}"


def test_the_browser_has_the_meshes_bit_by_bit(wide: tuple[Scene, Opened]) -> None:
    scene, one = wide
    tables = (
        "(id) => { const json = tacbench.K3D.getWorld().ObjectsListJson[id]; return [Array.from(%s.data), %s.shape]; }"
    )
    for thing, number in zip(scene.things, one.page.evaluate("tacbench.things.map((one) => one.id)"), strict=True):
        for name, table in (("vertices", thing.mesh.vertices), ("indices", thing.mesh.faces)):
            numbers, shape = one.page.evaluate(tables.replace("%s", f"json.{name}"), number)
            assert np.array_equal(np.reshape(numbers, shape), table), name


def test_without_webgl_the_page_says_so_and_keeps_the_sizes(browser: Any, whole: tuple[Scene, Path]) -> None:
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(whole[1].as_uri())
    page.wait_for_selector("body[data-failed]", state="attached", timeout=PATIENCE_MS)
    assert "WebGL 2" in page.locator("#wait").inner_text()
    assert "23.3 x 30 x 7 mm" in page.locator("#facts").inner_text()
    page.close()


def test_heights_are_coloured_by_their_scale(wide: tuple[Scene, Opened]) -> None:
    _, one = wide
    one.act("tacbench.goTo('texture'); tacbench.change({block: 1})")
    assert scale_ends(one) == pytest.approx((3.0, 7.0), abs=0.01)


def inside_of_the_middle() -> Floats:
    """Points of texture 2's block on the plane y = 15 mm, below its valleys and above a label; shape (120, 4)."""
    return np.array([[x, 15.0, z, 1.0] for x in np.linspace(3.0, 20.0, 40) for z in (1.2, 2.0, 2.6)])


def require_cut_face(colours: Bytes) -> None:
    """All have the colour of a block's cut face, or of a stripe on it."""
    share = (colours / (0.78 * np.array([0xE3, 0xB7, 0x78]))).mean(axis=1)
    assert np.all((share > 0.58) & (share < 1.03))
    assert np.ptp(colours / share[:, None], axis=0).max() < 6.0, "one hue"
    assert np.mean(share > 0.97) > 0.6


def test_a_cut_shows_the_inside_filled(wide: tuple[Scene, Opened]) -> None:
    scene, one = wide
    thing = scene.things[1]
    one.act("tacbench.goTo('block'); tacbench.change({block: 1, colour: 'part', sizes: false, cut: '', flip: false})")
    one.act("tacbench.look('front')")
    points = inside_of_the_middle()
    pixels = np.floor(one.where((points @ thing.to_world.T)[:, :3])).astype(int)
    whole = one.picture()[pixels[:, 1], pixels[:, 0]]
    one.act("tacbench.change({cut: 'y', at: 0.5})")
    assert one.page.locator("#cut-value").inner_text() == "y = 15.00 mm"
    cut = one.picture()[pixels[:, 1], pixels[:, 0]]
    assert len(np.unique(whole, axis=0)) < len(np.unique(cut, axis=0)), "the cut's face is hatched"
    require_cut_face(cut)
    one.act("tacbench.change({flip: true})")
    assert not np.array_equal(one.picture()[pixels[:, 1], pixels[:, 0]], cut)
    one.act("tacbench.change({cut: '', flip: false})")
    assert np.array_equal(one.picture()[pixels[:, 1], pixels[:, 0]], whole)


def test_a_block_in_its_pocket_is_cut_with_it(shown: Opened, whole: tuple[Scene, Path]) -> None:
    thing = whole[0].things[1]
    if thing.set_number is None:
        pytest.skip("no holder without the extra cad")
    shown.act(
        "tacbench.goTo('assembly'); tacbench.change({block: 1, colour: 'part', apart: 0, sizes: false, cut: 'y'})"
    )
    assert shown.page.locator("#cut-value").inner_text() == "y = 15.00 mm"
    pixels = np.floor(shown.where((inside_of_the_middle() @ thing.to_world.T)[:, :3])).astype(int)
    # Block and pocket share a plane, the floor; seen through the cut, neither may show through the other.
    require_cut_face(shown.picture()[pixels[:, 1], pixels[:, 0]])
    shown.act("tacbench.change({cut: '', sizes: true})")


def test_press_positions_are_where_the_protocol_has_them(wide: tuple[Scene, Opened]) -> None:
    scene, one = wide
    thing = scene.things[0]
    assert thing.press is not None
    one.act("tacbench.goTo('block'); tacbench.change({block: 0, colour: 'part', sizes: false, press: false})")
    near_look(one, thing, (6.5, 20.5), 22.0)
    ends = np.column_stack([thing.press.positions_mm, np.ones(25)])
    # The corners' numbers stand beside them, the contact circles go round them.
    pixels = np.floor(one.where((ends @ thing.to_world.T)[:, :3])).astype(int)
    before = one.picture()[pixels[:, 1], pixels[:, 0]].max(axis=1)
    one.act("tacbench.change({press: true})")
    after = one.picture()[pixels[:, 1], pixels[:, 0]].max(axis=1)
    assert before.min() > 100 and after.max() < 90
    assert "25 positions" in one.page.locator("#legend").inner_text()


def test_it_turns_by_the_mouse_and_by_itself(wide: tuple[Scene, Opened]) -> None:
    _, one = wide
    one.act("tacbench.goTo('block'); tacbench.change({block: 1, colour: 'part', press: false})")
    eye = "tacbench.K3D.getWorld().camera.position.toArray()"
    first, box = one.page.evaluate(eye), one.stage()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    one.page.mouse.move(x, y)
    one.page.mouse.down()
    one.page.mouse.move(x + 120, y, steps=4)
    one.page.mouse.up()
    one.settle()
    second = one.page.evaluate(eye)
    assert np.linalg.norm(np.subtract(second, first)) > 5.0
    one.page.check("#spin")
    one.page.wait_for_function(f"() => Math.hypot(...{eye}.map((c, i) => c - {second}[i])) > 1")
    one.page.uncheck("#spin")
    third = one.page.evaluate(eye)
    assert third[2] == pytest.approx(second[2], abs=0.01), "turning keeps the height"
