"""The 3D page in a real browser: it draws the parts, loads nothing, and its colours show the correct deviation."""

from __future__ import annotations

import io
import math
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

#: The time limit for drawing a page, in ms.
MAX_PAGE_MS = 60_000
WIDTHS = {1200: 800, 390: 844}


@dataclass(frozen=True, eq=False)
class BrowserPage:
    """An open page in the browser, with its requests and error messages so far."""

    page: Any
    requests: list[str]
    messages: list[str]

    def act(self, script: str) -> None:
        """Run a script of the page and wait until the picture is updated."""
        self.page.evaluate(f"() => {{ {script} }}")
        self.settle()

    def settle(self) -> None:
        """Wait until a picture is finished that was started after all earlier actions."""
        self.page.evaluate(
            "() => new Promise((done) => { const K = tacbench.K3D; let id = K.on(K.events.RENDERED, () => {"
            " K.off(K.events.RENDERED, id); requestAnimationFrame(() => requestAnimationFrame(done)); });"
            " requestAnimationFrame(() => requestAnimationFrame(() => K.render())); })"
        )

    def picture(self) -> Bytes:
        """Return a screenshot, shape (height, width, 3)."""
        return np.asarray(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB"))

    def stage(self) -> dict[str, float]:
        """Return the place of the 3D view on the page: x, y, width and height in pixels."""
        box: dict[str, float] = self.page.locator("#stage").bounding_box()
        return box

    def pixels_of(self, points: Floats) -> Floats:
        """Convert points (n, 3) in world coordinates to pixels (n, 2)."""
        stage = self.stage()
        pixels = self.page.evaluate("(points) => points.map((p) => tacbench.project(p))", points.tolist())
        return np.asarray(pixels) + np.array([stage["x"], stage["y"]])


def open_page(browser: Any, file: Path, width: int) -> BrowserPage:
    page = browser.new_page(viewport={"width": width, "height": WIDTHS[width]})
    view = BrowserPage(page=page, requests=[], messages=[])
    page.on("request", lambda request: view.requests.append(request.url))
    page.on(
        "console", lambda message: view.messages.append(message.text) if message.type in ("error", "warning") else None
    )
    page.on("pageerror", lambda error: view.messages.append(str(error)))
    page.goto(file.as_uri())
    page.wait_for_selector("body[data-ready]", state="attached", timeout=MAX_PAGE_MS)
    view.settle()
    return view


@pytest.fixture(scope="module")
def print_set(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    """Write the page of the default print set."""
    path = tmp_path_factory.mktemp("page") / "view.html"
    scene = scene_of(request_of((), Request()))
    write_page(scene, path)
    return scene, path


@pytest.fixture(scope="module", params=list(WIDTHS))
def view(request: pytest.FixtureRequest, browser: Any, print_set: tuple[Scene, Path]) -> Iterator[BrowserPage]:
    view = open_page(browser, print_set[1], request.param)
    yield view
    view.page.close()


@pytest.fixture(scope="module")
def coarse_blocks(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Scene, BrowserPage]]:
    """Write and open the page of labelled blocks whose meshes are so coarse that triangles are many pixels wide."""
    path = tmp_path_factory.mktemp("coarse") / "view.html"
    scene = scene_of(request_of(("1", "2", "6"), Request(sampling=Tolerance(mm=0.04), label=True)))
    write_page(scene, path)
    view = open_page(browser, path, 1200)
    yield scene, view
    view.page.close()


def test_the_page_loads_nothing_and_reports_no_error(view: BrowserPage, print_set: tuple[Scene, Path]) -> None:
    outside = [url for url in view.requests if not url.startswith("blob:")]
    assert outside == [print_set[1].as_uri()]
    assert view.messages == []


@pytest.mark.parametrize("width", list(WIDTHS))
def test_the_page_opens_on_the_texture(browser: Any, print_set: tuple[Scene, Path], width: int) -> None:
    """The view shows the block from above, in the middle. A switch shows the jig, which would hide the block."""
    thing = print_set[0].things[0]
    view = open_page(browser, print_set[1], width)
    view.act("tacbench.change({sizes: false})")
    x, y = np.meshgrid(np.linspace(4.0, 19.0, 8), np.linspace(4.0, 26.0, 8))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(64, 6.0), np.ones(64)]) @ thing.to_world.T
    stage = view.stage()

    def seen() -> tuple[Floats, float]:
        pixels = np.floor(view.pixels_of(points[:, :3])).astype(int)
        colours = view.picture()[pixels[:, 1], pixels[:, 0]].astype(float)
        return pixels, float(np.mean(colours[:, 0] > 1.2 * colours[:, 2]))

    pixels, block = seen()
    assert block > 0.9, "the texture must have the colour of the block"
    middle = np.array([stage["x"] + stage["width"] / 2, stage["y"] + stage["height"] / 2])
    assert np.all(np.abs(pixels.mean(axis=0) - middle) < 0.15 * np.array([stage["width"], stage["height"]]))
    if why_missing("build123d") is None:
        assert "jig_paper_x1" not in view.page.locator("#facts").inner_text()
        view.page.check("#jig")
        view.act("tacbench.change({apart: 0})")
        assert seen()[1] < 0.1, "the jig must hide the block"
        assert "jig_paper_x1" in view.page.locator("#facts").inner_text()
        view.page.uncheck("#jig")
        view.settle()
        assert seen()[1] > 0.9
    view.page.close()


def test_every_view_is_drawn_and_fits_the_screen(view: BrowserPage) -> None:
    width = view.page.viewport_size["width"]
    pictures = []
    for button in view.page.locator("#views button").all():
        button.click()
        view.settle()
        box, picture = view.stage(), view.picture()
        part = picture[int(box["y"]) : int(box["y"] + box["height"]), int(box["x"]) : int(box["x"] + box["width"])]
        covered = np.mean(np.abs(part.astype(int) - [0xF6, 0xF7, 0xF9]).max(axis=2) > 8)
        assert 0.1 < covered < 0.9, button.inner_text()
        assert view.page.evaluate("document.scrollingElement.scrollWidth") == width
        pictures.append(part)
    names = view.page.locator("#views button").all_inner_texts()
    assert names == (
        ["Texture", "Block"] if why_missing("build123d") else ["Texture", "Block", "Holder", "Jig", "Assembly"]
    )
    assert all(not np.array_equal(a, b) for i, a in enumerate(pictures) for b in pictures[:i])


def near_look(view: BrowserPage, thing: Thing, at: tuple[float, float], above: float) -> None:
    """Look straight down on a position of a block from the given height above its top."""
    x, y, z, _ = thing.to_world @ [*at, float(thing.mesh.vertices[:, 2].max()), 1.0]
    view.act(f"tacbench.K3D.setCamera([{x}, {y - 0.001}, {z + above}, {x}, {y}, {z}, 0, 0, 1])")


def legend(view: BrowserPage) -> Floats:
    """Return the colours of the visible scale, evenly spaced from its low end to its high end; shape (n, 3)."""
    drawn = view.page.evaluate("getComputedStyle(document.querySelector('#scale .bar')).backgroundImage")
    return np.array([[float(c) for c in rgb] for rgb in re.findall(r"rgb\((\d+), (\d+), (\d+)\)", drawn)])


def scale_ends(view: BrowserPage) -> tuple[float, float]:
    ticks = view.page.locator("#scale .ticks span").all_inner_texts()
    return float(ticks[0]), float(ticks[-1])


def tops(thing: Thing, at: tuple[float, float], reach: float) -> Floats:
    """Return points (n, 3) on top of the mesh near a position, in the block frame, on slopes below 70 degrees."""
    triangles = thing.mesh.triangle_points
    up = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    gentle = (up[:, 2] > 0.35 * np.linalg.norm(up, axis=1)) & (triangles[:, :, 2].min(axis=1) > 1.0)
    a, b, c = np.moveaxis(triangles[gentle], 1, 0)
    points = []
    for x, y in np.random.default_rng(5).uniform(-reach, reach, (300, 2)) + np.array(at):
        sides = [(q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0]) for p, q in ((b, c), (c, a))]
        area = up[gentle][:, 2]
        first, second = sides[0] / area, sides[1] / area
        # The points are well inside a triangle, because a pixel at its edge may show the next triangle.
        inside = np.flatnonzero((first > 0.02) & (second > 0.02) & (first + second < 0.98))
        if len(inside) == 1:
            (i,) = inside
            z = first[i] * a[i, 2] + second[i] * b[i, 2] + (1.0 - first[i] - second[i]) * c[i, 2]
            points.append((x, y, z))
    return np.array(points)


@pytest.mark.parametrize("number", [0, 1, 2], ids=["texture-1", "texture-2", "texture-6"])
def test_colours_are_the_deviation(coarse_blocks: tuple[Scene, BrowserPage], number: int) -> None:
    scene, view = coarse_blocks
    thing = scene.things[number]
    formula = thing.formula
    assert formula is not None
    at = (11.0, 15.0)
    view.act(f"tacbench.goTo('block'); tacbench.change({{block: {number}, colour: 'deviation', sizes: false}})")
    near_look(view, thing, at, 9.0)
    points = tops(thing, at, 2.0)
    assert len(points) > 100
    a, f, g, phase = formula.waves.T[:, :, None]
    angle = f * points[:, 0] + g * points[:, 1] + phase
    slope = np.hypot((a * f * np.cos(angle)).sum(axis=0), (a * g * np.cos(angle)).sum(axis=0))
    distance = (points[:, 2] - formula.datum_mm - (a * np.sin(angle)).sum(axis=0)) / np.hypot(1.0, slope)
    assert np.abs(distance).max() <= formula.bound_mm, "the certificate would be wrong"
    low, high = scale_ends(view)
    assert high == -low == pytest.approx(1000.0 * formula.bound_mm, rel=5e-3)
    colours = legend(view)
    place = (distance / formula.bound_mm + 1.0) / 2.0 * (len(colours) - 1)
    expected = np.column_stack([np.interp(place, np.arange(len(colours)), colours[:, c]) for c in range(3)])
    pixels = np.floor(view.pixels_of(points)).astype(int)
    colours_seen = view.picture()[pixels[:, 1], pixels[:, 0]].astype(float)
    wrong = np.abs(colours_seen - expected).max(axis=1)
    assert np.ptp(distance) > 0.5 * formula.bound_mm, "the deviations must cover a large part of the scale"
    assert np.mean(wrong < 16.0) > 0.95, f"{np.sort(wrong)[-10:]}"


def test_without_webgl_the_page_shows_a_message_and_the_sizes(browser: Any, print_set: tuple[Scene, Path]) -> None:
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(print_set[1].as_uri())
    page.wait_for_selector("body[data-failed]", state="attached", timeout=MAX_PAGE_MS)
    assert "WebGL 2" in page.locator("#wait").inner_text()
    assert "23.3 x 30 x 7 mm" in page.locator("#facts").inner_text()
    page.close()


def inside_of_the_middle() -> Floats:
    """Return points in the block of texture 2 on the plane y = 15 mm, between label and valleys; shape (120, 4)."""
    return np.array([[x, 15.0, z, 1.0] for x in np.linspace(3.0, 20.0, 40) for z in (1.2, 2.0, 2.6)])


def require_cut_face(colours: Bytes) -> None:
    """Check that all colours are those of the cut face of a block or of a stripe on it."""
    brightness = (colours / (0.78 * np.array([0xE3, 0xB7, 0x78]))).mean(axis=1)
    assert np.all((brightness > 0.58) & (brightness < 1.03))
    assert np.ptp(colours / brightness[:, None], axis=0).max() < 6.0, "the colours must have the same hue"
    assert np.mean(brightness > 0.97) > 0.6


def test_a_block_in_its_pocket_is_cut_with_it(view: BrowserPage, print_set: tuple[Scene, Path]) -> None:
    thing = print_set[0].things[1]
    if thing.set_number is None:
        pytest.skip("no holder without the extra cad")
    view.act("tacbench.goTo('assembly'); tacbench.change({block: 1, colour: 'part', apart: 0, sizes: false, cut: 'y'})")
    assert view.page.locator("#cut-value").inner_text() == "y = 15.00 mm"
    pixels = np.floor(view.pixels_of((inside_of_the_middle() @ thing.to_world.T)[:, :3])).astype(int)
    # Block and pocket share the plane of the floor. In the cut, neither may be visible through the other.
    require_cut_face(view.picture()[pixels[:, 1], pixels[:, 0]])
    view.act("tacbench.change({cut: '', sizes: true})")


def test_the_view_turns_with_the_mouse_and_the_keyboard(coarse_blocks: tuple[Scene, BrowserPage]) -> None:
    _, view = coarse_blocks
    view.act("tacbench.goTo('block'); tacbench.change({block: 1, colour: 'part', press: false})")
    eye = "tacbench.K3D.getWorld().camera.position.toArray()"
    first, box = view.page.evaluate(eye), view.stage()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    view.page.mouse.move(x, y)
    view.page.mouse.down()
    view.page.mouse.move(x + 120, y, steps=4)
    view.page.mouse.up()
    view.settle()
    second = view.page.evaluate(eye)
    assert np.linalg.norm(np.subtract(second, first)) > 5.0
    view.page.keyboard.press("ArrowRight")
    view.settle()
    third = view.page.evaluate(eye)
    assert np.linalg.norm(np.subtract(third, second)) > 1.0
    assert third[2] == pytest.approx(second[2], abs=0.01), "turning must keep the height"
    view.page.keyboard.press("+")
    view.settle()
    fourth, middle = view.page.evaluate(eye), view.page.evaluate("tacbench.K3D.getWorld().controls.target.toArray()")
    assert math.dist(fourth, middle) == pytest.approx(math.dist(third, middle) / 1.15)
