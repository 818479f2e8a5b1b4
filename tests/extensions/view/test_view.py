"""The 3D page, tested without a browser: its contents, no links to load, and errors."""

from __future__ import annotations

import base64
import json
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

pytest.importorskip("k3d", reason="the 3D page needs the extra view")

from tacbench_cad.cli import main
from tacbench_cad.making import showing
from tacbench_cad.making.request import Request
from tacbench_cad.making.showing import request_of, scene_of
from tacbench_cad.render.viewing import page
from tacbench_cad.render.viewing.scene import Scene, Thing
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.texture_files import find_textures
from tacbench_cad.util.errors import MissingToolError

Capture = pytest.CaptureFixture[str]
COARSE = Request(sampling=Tolerance(mm=0.05))


def seen(*words: str, options: Request = COARSE) -> Scene:
    return scene_of(request_of(words, options))


def description(text: str) -> dict[str, object]:
    match = re.search(r'<script id="description" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert match is not None
    document: dict[str, object] = json.loads(match[1])
    return document


def world(thing: Thing) -> np.ndarray:
    """Return the vertices of an object in world coordinates, shape (n, 3)."""
    return thing.mesh.vertices @ thing.to_world[:3, :3].T + thing.to_world[:3, 3]


@pytest.mark.parametrize(
    ("words", "textures", "parts"),
    [
        ((), ("all",), None),
        (("4",), ("4",), ("blocks",)),
        (("1", "texture-2", "holder"), ("1", "texture-2"), ("holder", "blocks")),
        (("jig",), ("all",), ("jig",)),
        (("blocks",), ("all",), ("blocks",)),
    ],
)
def test_words_name_textures_and_parts(
    words: tuple[str, ...], textures: tuple[str, ...], parts: tuple[str, ...] | None
) -> None:
    request = request_of(words, Request())
    assert find_textures(request.textures) == find_textures(textures)
    assert request.parts == parts


def test_the_page_states_the_formula_of_the_block() -> None:
    (thing,) = seen("4").things
    assert thing.formula is not None
    block = Block.of(4, sampling=Tolerance(mm=0.05))
    x, y = np.random.default_rng(1).uniform(0.0, 23.0, (2, 500))
    a, f, g, phase = thing.formula.waves.T[:, :, None]
    heights = thing.formula.datum_mm + (a * np.sin(f * x + g * y + phase)).sum(axis=0)
    assert np.abs(heights - block.height_at(x, y)).max() < 1e-12
    slope = np.hypot(*(np.asarray(slopes) for slopes in block.surface.gradient(x, y)))
    assert thing.formula.bound_mm <= 0.05 and slope.max() > 1.0


def test_the_colour_scale_ends_at_the_largest_deviation() -> None:
    (fine,) = seen("6").things
    (joined,) = seen("6", options=Request(sampling="grid")).things
    assert fine.formula is not None and joined.formula is not None
    assert fine.formula.scale_mm == fine.formula.bound_mm
    block = Block.of(6, sampling="grid")
    x = np.linspace(0.0, 23.3, 200_001)
    lines, ends = block.samples_mm[0], block.height_at(block.samples_mm[0], 0.0)
    formula = np.stack([x, block.height_at(x, 0.0)], axis=1)
    straight = np.stack([x, np.interp(x, lines, ends)], axis=1)[::20]
    largest = KDTree(formula).query(straight)[0].max()
    # the scale is the length of a short way to the formula, which is not always the shortest
    assert 0.8 * largest < joined.formula.scale_mm < 1.25 * largest < joined.formula.bound_mm


def test_press_positions_lie_on_the_surface() -> None:
    (thing,) = seen("2").things
    assert thing.press is not None
    x, y, z = thing.press.positions_mm.T
    assert np.abs(z - Block.of(2, sampling=Tolerance(mm=0.05)).height_at(x, y)).max() < 1e-12
    assert [force for force, _ in thing.press.contacts] == [0.08045, 1.91295, 3.0137]


def test_a_block_smaller_than_the_press_grid_shows_no_positions(tmp_path: Path) -> None:
    file = tmp_path / "small.toml"
    file.write_text(
        '[texture]\nname = "small"\nfamily = "series"\nlaw = "square"\nN = 3\naxes = "x"\n[block]\nsize_mm = [8, 8]\n'
    )
    (thing,) = seen(str(file)).things
    assert thing.press is None and thing.formula is not None


def test_fixtures_fit_together_on_the_page() -> None:
    pytest.importorskip("build123d", reason="fixtures need the extra cad")
    shown = {thing.kind: thing for thing in seen("2", "holder", "jig").things}
    block, holder, jig = (world(shown[kind]) for kind in ("block", "holder", "jig"))
    # The plate of the holder has 45.6 x 52.3 x 7.47 mm. The block is in its middle and ends 1.18 mm above it. The roof
    # of the jig is 0.3 mm above the block.
    assert np.allclose((block.min(axis=0) + block.max(axis=0))[:2], holder.max(axis=0)[:2], atol=1e-5)
    assert block.max(axis=0)[2] - holder.max(axis=0)[2] == pytest.approx(1.18, abs=1e-5)
    inside = jig[(np.abs(jig[:, 0] - 22.8) < 11.0) & (np.abs(jig[:, 1] - 26.15) < 14.0)]
    assert inside[:, 2].min() - block.max(axis=0)[2] == pytest.approx(0.3, abs=1e-5)
    assert {thing.set_number for thing in shown.values()} == {0}
    assert shown["jig"].mesh.volume_mm3 > 0.0, "the seated jig must not be mirrored"
    assert ("pocket size", "23.6 x 30.3 x 5.82 mm") in shown["holder"].facts


def test_the_page_loads_nothing_and_is_reproducible() -> None:
    shown = seen("1", "2")
    text = page.page_of(shown)
    assert text == page.page_of(shown), "the same scene must give the same bytes"
    assert len(text) < 5_000_000
    assert "[[" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert "default-src 'none'" in text and "Three.js Authors" in text
    assert not re.search(r"<(link|img|iframe|script[^>]* src)\b", text)
    document = description(text)
    assert [thing["name"] for thing in document["things"]] == [thing.name for thing in shown.things]  # type: ignore[index]
    packed = re.search(r'<script id="library" type="text/plain">(.*?)</script>', text, re.DOTALL)
    assert packed is not None
    library = zlib.decompress(base64.b64decode(packed[1])).decode()
    assert "url(fonts/" not in library, "the browser would look for the files of these fonts"
    assert library.count("KaTeX_Main") > 0, "only the fonts are removed"


def test_a_mesh_is_restored_from_its_differences() -> None:
    mesh = seen("6").things[0].mesh
    packed = np.frombuffer(page._differences(mesh), dtype=np.uint8).reshape(4, -1)
    steps = np.ascontiguousarray(packed.T).view("<i4").ravel()
    n, m = len(mesh.vertices), len(mesh.faces)
    vertices = np.cumsum(steps[: 3 * n].reshape(3, n), axis=1, dtype=np.int32).view(np.float32).T
    triangles = np.cumsum(steps[3 * n :].reshape(3, m), axis=1, dtype=np.int32).T
    assert np.array_equal(vertices, mesh.vertices) and np.array_equal(triangles, mesh.faces)


def test_a_hostile_name_is_shown_as_text(tmp_path: Path) -> None:
    (thing,) = seen("1").things
    from dataclasses import replace

    bad = replace(thing, name="</script><img src=x onerror=alert(1)>", facts=(("x", "</script>"),))
    text = page.page_of(Scene(things=(bad,)))
    assert "<img" not in text and text.count("</script>") == page.page_of(Scene(things=(thing,))).count("</script>")


def test_without_cad_packages_only_blocks_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        showing, "why_not_importable", lambda modules: "OCP: libGL.so.1: cannot open shared object file"
    )
    shown = seen(options=Request(textures=("all",), sampling=Tolerance(mm=0.1)))
    assert {thing.kind for thing in shown.things} == {"block"} and len(shown.things) == 6
    assert any("libGL" in reason for _, reason in shown.left_out)
    with pytest.raises(MissingToolError, match="libGL"):
        seen("holder")


def test_the_command_writes_the_page(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "page.html"
    assert main(["view", "1", "--scale", "2", "--key", "-o", str(path)]) == 0
    assert "page.html" in capsys.readouterr().err
    (thing,) = description(path.read_text(encoding="utf-8"))["things"]  # type: ignore[misc]
    assert thing["name"] == "texture-1_paper_x2_key3"


@pytest.mark.parametrize(
    ("argv", "needle"),
    [
        (["holdr"], 'did you mean "holder"'),
        (["7"], "texture = '7'"),
        (["1", "-o", "view.stl"], "must end in .html"),
        (["1", "-o", "nowhere/view.html"], "nowhere"),
        (["missing.toml"], "missing.toml"),
        (["1", "--slots", "2"], "slots"),
    ],
)
def test_wrong_input_is_one_line(
    argv: list[str], needle: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["view", *argv]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ") and err.count("\n") == 1
    assert needle in err
    assert list(tmp_path.iterdir()) == []
