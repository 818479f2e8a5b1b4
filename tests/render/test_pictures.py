"""Pictures show the parts correctly. They are equal on every run, and are written completely or not at all."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.cases import mostly_long
from scipy.ndimage import binary_erosion

from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import COLOURS
from tacbench_cad.render import pictures
from tacbench_cad.render.bodies import body_of, fine_body, relief_of
from tacbench_cad.render.raster import BELOW, Body, Camera, extent_mm, render
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.protocol import contact_radius_mm
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Bytes

Image = pytest.importorskip("PIL.Image", reason="reading pictures needs pillow (extra dev)")
pytest.importorskip("matplotlib", reason="pictures need the extra plot")

PNG = b"\x89PNG\r\n\x1a\n"
#: The height of the strip with the scale bar at the bottom of a sheet, with its margin, in pixels.
BAR_PX = 50


def pixels(path: Path) -> Bytes:
    return np.asarray(Image.open(path).convert("RGB"))


def ink(image: Bytes) -> Bools:
    """Return a mask of the pixels that are not white."""
    return (image < 250).any(axis=2)


def box(x: float, y: float, z: float) -> Mesh:
    """Return a box with one corner at the origin."""
    vertices = np.array([(a * x, b * y, c * z) for a in (0, 1) for b in (0, 1) for c in (0, 1)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(vertices, np.array(triangles, dtype=np.int32))


def test_a_box_from_above_fills_its_rectangle() -> None:
    """Seen from above, a box of 20 x 10 mm is a rectangle in the middle of the picture, twice as wide as high."""
    shown = ink(render([body_of(box(20.0, 10.0, 5.0))], 220, 220, Camera(azimuth_deg=-90.0, elevation_deg=90.0)))
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    assert shown[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].all()
    assert len(columns) / len(rows) == pytest.approx(2.0, rel=0.02)
    assert len(columns) >= 216
    assert abs((rows[0] + rows[-1]) / 2 - 109.5) <= 1.0


@pytest.mark.parametrize("elevation", mostly_long([0.0, 20.0, 38.0, 65.0], 0.0, 38.0))
@pytest.mark.parametrize("azimuth", mostly_long([-62.0, 30.0, 200.0], -62.0, 200.0))
def test_a_box_covers_its_silhouette(azimuth: float, elevation: float) -> None:
    """The covered area is the sum of the visible faces, each multiplied by the cosine of its tilt."""
    x, y, z = 20.0, 12.0, 7.0
    a, e = math.radians(azimuth), math.radians(elevation)
    across = abs(x * math.sin(a)) + abs(y * math.cos(a))
    silhouette = math.cos(e) * (y * z * abs(math.cos(a)) + x * z * abs(math.sin(a))) + x * y * math.sin(e)
    shown = ink(render([body_of(box(x, y, z))], 600, 600, Camera(azimuth_deg=azimuth, elevation_deg=elevation)))
    width = np.ptp(np.flatnonzero(shown.any(axis=0))) + 1
    assert shown.sum() * (across / width) ** 2 == pytest.approx(silhouette, rel=0.015)


def test_near_parts_hide_distant_parts() -> None:
    """A small box is visible in front of a large box and hidden behind it, whatever the order of the triangles."""
    small, large = box(4.0, 1.0, 4.0), box(20.0, 1.0, 20.0)
    front = Camera(azimuth_deg=-90.0, elevation_deg=0.0)

    def scene(y: float, order: int) -> Bytes:
        moved = small.vertices + np.array([8.0, y, 8.0])
        vertices = np.concatenate([large.vertices, moved])
        triangles = np.concatenate([large.faces, small.faces + 8])[::order]
        return render([body_of(Mesh(vertices, np.ascontiguousarray(triangles)))], 200, 200, front)

    alone = render([body_of(large)], 200, 200, front)
    for order in (1, -1):
        assert np.array_equal(scene(5.0, order), alone), "behind"
        assert not np.array_equal(scene(-5.0, order), alone), "in front"


def test_steep_faces_and_hollows_are_darker() -> None:
    """The relief is visible: walls of a sine differ from its crests, and the label differs from the underside."""
    top = render([body_of(Block.of(1))], 300, 240)
    grey = top[ink(top)].mean(axis=1)
    assert np.percentile(grey, 95) - np.percentile(grey, 5) > 60
    labelled = render([body_of(Block.of(1, label=True))], 300, 240, BELOW)
    plain = render([body_of(Block.of(1))], 300, 240, BELOW)
    changed = np.abs(labelled.astype(int) - plain.astype(int)).max(axis=2) > 25
    assert 0.01 < changed.mean() < 0.2


def test_bodies_have_their_places_and_colours_and_hide_each_other() -> None:
    front = Camera(azimuth_deg=-90.0, elevation_deg=0.0)
    before, behind = np.eye(4), np.eye(4)
    before[1, 3], behind[1, 3] = -5.0, 5.0
    red, green = ((0.6, 0.05, 0.05), (0.05, 0.6, 0.05))
    bodies = [
        Body(mesh=box(4.0, 1.0, 4.0), colour=red, matrix=behind),
        Body(mesh=box(8.0, 1.0, 8.0), colour=green),
        Body(mesh=box(2.0, 1.0, 2.0), colour=red, matrix=before),
    ]
    image = render(bodies, 164, 164, front).astype(int)
    is_red = (image[:, :, 0] > image[:, :, 1] + 40).nonzero()
    assert np.ptp(is_red[0]) == pytest.approx(40, abs=2) and np.ptp(is_red[1]) == pytest.approx(40, abs=2)
    assert is_red[0].max() > 160 and is_red[1].min() < 4, "the small box is in front, at the lower left"


OWN = Texture(name="hexagonal", surface=plane_waves((0.5, 1.0, 0.0), (0.5, 0.5, 0.866), (0.5, -0.5, 0.866)))


@pytest.mark.parametrize(
    "block",
    mostly_long(
        [*(Block.of(number) for number in range(1, 7)), Block.of(2, key_mm=3.0), Block.of(1, scale=0.5), Block.of(OWN)],
        *(Block.of(4), Block.of(2, key_mm=3.0), Block.of(1, scale=0.5), Block.of(OWN)),
    ),
    ids=lambda block: block.name,
)
def test_a_texture_with_a_tolerance_is_shaded_like_its_formula(block: Block) -> None:
    """The edges of the triangles are not visible: a much finer mesh gives the same picture."""
    coarse, fine = (render([body], 300, 240).astype(int) for body in (body_of(block), fine_body(block_part(block))))
    inside = binary_erosion(ink(coarse.astype(np.uint8)) & ink(fine.astype(np.uint8)), iterations=2)
    difference = np.abs(coarse - fine).max(axis=2)[inside]
    assert np.mean(difference > 8) < 0.03, "only single pixels along the edges of ripples and walls may differ"
    assert np.percentile(difference, 90) <= 3


def test_a_relief_has_the_heights_and_slopes_of_the_formula() -> None:
    x, y = np.random.default_rng(1).uniform(0.0, 20.0, (2, 500))
    for block in (Block.of(2), Block.of(4), Block.of(OWN)):
        relief = relief_of(block)
        assert relief is not None
        expected = block.height_at(x, y), *block.surface.gradient(x, y)
        scale = max(1.0, block.surface.bound(1, 0), block.surface.bound(0, 1))
        for values, reference in zip(relief(x, y), expected, strict=True):
            assert np.allclose(values, reference, atol=2e-3 * scale)


def test_sheet_has_a_tile_and_a_caption_for_each_part(tmp_path: Path) -> None:
    items = [(f"part-{number}\n23.3 x 30 x 7 mm", Block.of(number)) for number in (1, 2, 5)]
    pictures.preview_sheet(items, tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").read_bytes().startswith(PNG)
    shown = ink(pixels(tmp_path / "sheet.png"))[:-BAR_PX]
    columns = np.flatnonzero(np.diff(np.concatenate([[0], shown.any(axis=0).astype(int), [0]])))
    assert len(columns) == 6, "three tiles with white between them"
    for left, right in columns.reshape(3, 2):
        rows = np.flatnonzero(np.diff(np.concatenate([[0], shown[:, left:right].any(axis=1).astype(int), [0]])))
        assert len(rows) >= 6, "the part, and a caption of two lines below it"
    pictures.preview_sheet(items, tmp_path / "again.png")
    assert (tmp_path / "sheet.png").read_bytes() == (tmp_path / "again.png").read_bytes()


@pytest.mark.parametrize(("suffix", "head"), mostly_long([(".svg", b"<?xml"), (".pdf", b"%PDF")], (".pdf", b"%PDF")))
def test_a_sheet_can_be_a_vector_file_that_contains_the_picture(suffix: str, head: bytes, tmp_path: Path) -> None:
    paths = [tmp_path / f"{run}{suffix}" for run in "ab"]
    for path in paths:
        pictures.preview_sheet([("box", box(3.0, 4.0, 2.0))], path)
    assert paths[0].read_bytes().startswith(head)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with pytest.raises(InputError, match=r"must end in \.png, \.pdf or \.svg"):
        pictures.preview_sheet([("box", box(3.0, 4.0, 2.0))], tmp_path / "sheet.jpg")


def test_all_parts_of_a_sheet_have_the_scale_of_the_bar(tmp_path: Path) -> None:
    """A box of twice the size is drawn twice as wide, and the bar has the stated length."""
    small, large = box(10.0, 10.0, 4.0), box(20.0, 20.0, 8.0)
    pictures.preview_sheet([("", small), ("", large)], tmp_path / "sheet.png")
    shown = ink(pixels(tmp_path / "sheet.png"))
    columns = shown[:-BAR_PX].any(axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], columns.astype(int), [0]]))).reshape(2, 2)
    widths = np.diff(edges, axis=1).ravel()
    assert widths[1] == pytest.approx(2.0 * widths[0], rel=0.01)
    bar = shown[-BAR_PX:]
    bar_px = int(np.argmin(bar[np.argmax(bar.sum(axis=1)), 22:]))
    pixels_per_mm = widths[1] / extent_mm([body_of(large)])[0]
    assert bar_px == pytest.approx(5.0 * pixels_per_mm, abs=3.0), "the bar says 5 mm"


def test_the_picture_of_a_part_shows_an_engraved_underside(tmp_path: Path) -> None:
    widths = []
    for label in (False, True):
        pictures.part_picture(block_part(Block.of(1, label=label)), tmp_path / "part.png")
        image = ink(pixels(tmp_path / "part.png"))
        assert image.mean() > 0.25
        assert image[-110:-60].any(), "the caption"
        widths.append(image.shape[1])
    assert widths[0] > 600 and widths[1] > 1.5 * widths[0]


def test_the_parts_of_an_assembly_have_their_colours(tmp_path: Path) -> None:
    """In the assembly the jig covers the block. In the exploded view all three colours are visible."""
    pytest.importorskip("build123d", reason="fixtures need the extra cad")
    from helpers.fixtures import HOLDER, JIG

    from housing import Assembly

    assembly = Assembly(holder=HOLDER, blocks=(HOLDER.block,), jig=JIG)

    def fractions(apart_mm: float) -> list[float]:
        pictures.assembly_picture(assembly, tmp_path / "set.png", apart_mm)
        image = pixels(tmp_path / "set.png")[:-80].astype(float)
        drawn = image[ink(image.astype(np.uint8))]
        hue = (drawn - drawn.mean(axis=1, keepdims=True)) / drawn.mean(axis=1, keepdims=True)
        chroma = np.array(
            [[COLOURS[kind] >> shift & 0xFF for shift in (16, 8, 0)] for kind in ("holder", "block", "jig")]
        )
        chroma = (chroma - chroma.mean(axis=1, keepdims=True)) / chroma.mean(axis=1, keepdims=True)
        nearest = np.linalg.norm(hue[:, None] - chroma, axis=2)
        return [float((nearest.argmin(axis=1) == i)[nearest.min(axis=1) < 0.15].mean()) for i in range(3)]

    holder, block, jig = fractions(0.0)
    assert block < 0.01 and jig > holder > 0.03
    assert min(fractions(30.0)) > 0.05


@pytest.mark.parametrize("press", [False, True])
@pytest.mark.parametrize(
    "block",
    [
        pytest.param(Block.of(4), id="paper", marks=pytest.mark.long),
        pytest.param(Block.of(2, "released"), id="released", marks=pytest.mark.long),
        pytest.param(Block.of(5, key_mm=3.0), id="keyed"),
        pytest.param(Block.of(1, size_mm=(60.0, 26.0)), id="wide", marks=pytest.mark.long),
    ],
)
def test_texture_picture(tmp_path: Path, block: Block, press: bool) -> None:
    path = tmp_path / "texture.png"
    pictures.texture_picture(block, path, press=press)
    image = pixels(path)
    assert min(image.shape[:2]) > 500
    edge = np.concatenate([image[:4].reshape(-1, 3), image[-4:].reshape(-1, 3), image[:, -4:].reshape(-1, 3)])
    assert (edge == 255).all(), "something is cut off at the border of the picture"
    assert [file.name for file in tmp_path.iterdir()] == ["texture.png"]


def test_contact_circles_are_at_the_positions_of_the_grid(tmp_path: Path) -> None:
    """The circle of the highest force, measured in the picture, has the correct width at the scale of the axes."""
    pictures.texture_picture(Block.of(5), tmp_path / "press.png", press=True)
    image = pixels(tmp_path / "press.png").astype(int)
    across = image[:, : round(0.70 * image.shape[1])]
    blue = (np.abs(across - np.array([0x00, 0x72, 0xB2])).max(axis=2) < 12).nonzero()
    orange = (np.abs(across - np.array([0xD5, 0x5E, 0x00])).max(axis=2) < 12).nonzero()
    corners = 2 * contact_radius_mm(3.0137) + 5.0
    middle = 2 * contact_radius_mm(1.91295)
    assert np.ptp(blue[1]) / np.ptp(orange[1]) == pytest.approx(corners / middle, rel=0.02)
    assert np.ptp(blue[0]) / np.ptp(orange[0]) == pytest.approx(corners / middle, rel=0.02)


def test_the_users_matplotlib_settings_have_no_effect(tmp_path: Path) -> None:
    import matplotlib

    pictures.texture_picture(Block.of(1), tmp_path / "a.png")
    with matplotlib.rc_context({"font.size": 20.0, "axes.facecolor": "red", "savefig.bbox": "tight"}):
        pictures.texture_picture(Block.of(1), tmp_path / "b.png")
        assert matplotlib.rcParams["font.size"] == 20.0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
