"""Pictures: what they show is what is there; they are quick to make, equal on every run, whole or not there."""

from __future__ import annotations

import builtins
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import COLOURS
from tacbench_cad.render import pictures
from tacbench_cad.render.raster import BELOW, Camera, render
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import contact_radius_mm
from tacbench_cad.util.errors import InputError, MissingToolError
from tacbench_cad.util.types import Bools, Bytes

Image = pytest.importorskip("PIL.Image", reason="reading pictures needs pillow (extra dev)")
pytest.importorskip("matplotlib", reason="pictures need the extra plot")

PNG = b"\x89PNG\r\n\x1a\n"


def pixels(path: Path) -> Bytes:
    return np.asarray(Image.open(path).convert("RGB"))


def ink(image: Bytes) -> Bools:
    """Where the picture is not white."""
    return (image < 250).any(axis=2)


def box(x: float, y: float, z: float) -> Mesh:
    """A box with one corner at the origin."""
    vertices = np.array([(a * x, b * y, c * z) for a in (0, 1) for b in (0, 1) for c in (0, 1)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(vertices, np.array(triangles, dtype=np.int32))


def test_a_box_from_above_fills_its_rectangle() -> None:
    """Straight from above a box of 20 x 10 mm is a rectangle of twice its depth, in the picture's middle."""
    shown = ink(render(box(20.0, 10.0, 5.0), 220, 220, Camera(azimuth_deg=-90.0, elevation_deg=90.0)))
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    assert shown[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].all()
    assert len(columns) / len(rows) == pytest.approx(2.0, rel=0.02)
    assert len(columns) >= 216
    assert abs((rows[0] + rows[-1]) / 2 - 109.5) <= 1.0


@pytest.mark.parametrize("elevation", [0.0, 20.0, 38.0, 65.0])
@pytest.mark.parametrize("azimuth", [-62.0, 30.0, 200.0])
def test_a_box_covers_its_silhouette(azimuth: float, elevation: float) -> None:
    """The area covered is the silhouette's: the sum of the visible faces, each times the cosine of its tilt."""
    x, y, z = 20.0, 12.0, 7.0
    a, e = math.radians(azimuth), math.radians(elevation)
    across = abs(x * math.sin(a)) + abs(y * math.cos(a))
    silhouette = math.cos(e) * (y * z * abs(math.cos(a)) + x * z * abs(math.sin(a))) + x * y * math.sin(e)
    shown = ink(render(box(x, y, z), 600, 600, Camera(azimuth_deg=azimuth, elevation_deg=elevation)))
    width = np.ptp(np.flatnonzero(shown.any(axis=0))) + 1
    assert shown.sum() * (across / width) ** 2 == pytest.approx(silhouette, rel=0.015)


def test_nearer_parts_hide_farther_ones() -> None:
    """Whatever the order of the triangles: a small box before a large one is seen, behind it is not."""
    small, large = box(4.0, 1.0, 4.0), box(20.0, 1.0, 20.0)
    front = Camera(azimuth_deg=-90.0, elevation_deg=0.0)

    def scene(y: float, order: int) -> Bytes:
        moved = small.vertices + np.array([8.0, y, 8.0])
        vertices = np.concatenate([large.vertices, moved])
        triangles = np.concatenate([large.faces, small.faces + 8])[::order]
        return render(Mesh(vertices, np.ascontiguousarray(triangles)), 200, 200, front)

    alone = render(large, 200, 200, front)
    for order in (1, -1):
        assert np.array_equal(scene(5.0, order), alone), "behind"
        assert not np.array_equal(scene(-5.0, order), alone), "in front"


def test_steep_faces_and_hollows_are_darker() -> None:
    """The relief can be seen: a sine's walls differ from its crests, and the label from the underside around it."""
    top = render(mesh_block(Block.of(1))[0], 300, 240)
    grey = top[ink(top)].mean(axis=1)
    assert np.percentile(grey, 95) - np.percentile(grey, 5) > 60
    labelled = render(mesh_block(Block.of(1, label=True))[0], 300, 240, BELOW)
    plain = render(mesh_block(Block.of(1))[0], 300, 240, BELOW)
    changed = np.abs(labelled.astype(int) - plain.astype(int)).max(axis=2) > 25
    assert 0.01 < changed.mean() < 0.2


def test_render_is_reproducible() -> None:
    mesh, _ = mesh_block(Block.of(4))
    assert np.array_equal(render(mesh, 200, 150), render(mesh, 200, 150))


def test_long_thin_triangles() -> None:
    """Texture 6 is made of slivers as long as the block: no gap shows between them."""
    mesh, _ = mesh_block(Block.of(6))
    image = render(mesh, 420, 320)
    shown = ink(image)
    inside = shown[1:-1, 1:-1] | ~(shown[:-2, 1:-1] & shown[2:, 1:-1] & shown[1:-1, :-2] & shown[1:-1, 2:])
    assert inside.all(), "a white pixel among drawn ones"
    assert shown.mean() > 0.35


def test_sheet_has_a_tile_and_a_caption_for_each_part(tmp_path: Path) -> None:
    meshes = [mesh_block(Block.of(number))[0] for number in (1, 2, 5)]
    items = [(f"part-{i}\n23.3 x 30 x 7 mm", mesh) for i, mesh in enumerate(meshes)]
    pictures.preview_sheet(items, tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").read_bytes().startswith(PNG)
    shown = ink(pixels(tmp_path / "sheet.png"))
    columns = np.flatnonzero(np.diff(np.concatenate([[0], shown.any(axis=0).astype(int), [0]])))
    assert len(columns) == 6, "three tiles with white between them"
    for left, right in columns.reshape(3, 2):
        rows = np.flatnonzero(np.diff(np.concatenate([[0], shown[:, left:right].any(axis=1).astype(int), [0]])))
        assert len(rows) >= 6, "the part, and two lines of caption below it"
    pictures.preview_sheet(items, tmp_path / "again.png")
    assert (tmp_path / "sheet.png").read_bytes() == (tmp_path / "again.png").read_bytes()


@pytest.mark.parametrize("count", [1, 2, 4, 17, *(pytest.param(count, marks=pytest.mark.long) for count in (8, 40))])
def test_sheets_of_any_length(tmp_path: Path, count: int) -> None:
    """Every part is drawn, none over the other: the ink grows with the parts."""
    pictures.preview_sheet([("box", box(3.0, 4.0, 2.0))] * count, tmp_path / "sheet.png")
    shown = ink(pixels(tmp_path / "sheet.png"))
    pictures.preview_sheet([("", box(3.0, 4.0, 2.0))] * count, tmp_path / "bare.png")
    bare = ink(pixels(tmp_path / "bare.png"))
    tile = ink(render(box(3.0, 4.0, 2.0), *((420, 320) if count <= 16 else (300, 230)))).sum()
    assert bare.sum() == pytest.approx(count * tile, rel=0.001)
    assert shown.sum() > bare.sum()
    assert max(shown.shape) < 4000


def test_underside_is_shown_where_there_is_something_in_it(tmp_path: Path) -> None:
    """A label is drawn from below, in the tile's lower right corner, which is white without one."""
    corners = []
    for label in (False, True):
        pictures.preview_sheet([("", mesh_block(Block.of(1, label=label))[0])], tmp_path / "sheet.png")
        corners.append(ink(pixels(tmp_path / "sheet.png"))[200:340, 330:440].mean())
    assert corners[0] < 0.2 < 0.4 < corners[1]


def test_a_part_is_drawn_large_with_its_underside_where_that_is_engraved(tmp_path: Path) -> None:
    right = []
    for label in (False, True):
        pictures.part_picture(block_part(Block.of(1, label=label)), tmp_path / "part.png")
        image = ink(pixels(tmp_path / "part.png"))
        assert image.shape[1] > 1000 and image[:-80].mean() > 0.25
        assert image[-70:].any(), "the caption"
        right.append(image[400:600, 900:1080].mean())
    assert right[0] < 0.1 < 0.5 < right[1]


def test_an_assembly_has_its_parts_in_their_colours(tmp_path: Path) -> None:
    """Put together the jig covers the block; taken apart each of the three colours is seen."""
    pytest.importorskip("build123d", reason="fixtures need the extra cad")
    from helpers.fixtures import HOLDER, JIG

    from housing import Assembly

    assembly = Assembly(holder=HOLDER, blocks=(HOLDER.block,), jig=JIG)

    def shares(apart_mm: float) -> list[float]:
        pictures.assembly_picture(assembly, tmp_path / "set.png", apart_mm)
        image = pixels(tmp_path / "set.png")[:-80].astype(float)
        drawn = image[ink(image.astype(np.uint8))]
        hue = (drawn - drawn.mean(axis=1, keepdims=True)) / drawn.mean(axis=1, keepdims=True)
        own = np.array([[COLOURS[kind] >> shift & 0xFF for shift in (16, 8, 0)] for kind in ("holder", "block", "jig")])
        own = (own - own.mean(axis=1, keepdims=True)) / own.mean(axis=1, keepdims=True)
        nearest = np.linalg.norm(hue[:, None] - own, axis=2)
        return [float((nearest.argmin(axis=1) == i)[nearest.min(axis=1) < 0.15].mean()) for i in range(3)]

    holder_share, block_share, jig_share = shares(0.0)
    assert block_share < 0.01 and jig_share > holder_share > 0.03
    assert min(shares(30.0)) > 0.05


@pytest.mark.parametrize("press", [False, True])
@pytest.mark.parametrize(
    "block",
    [Block.of(4), Block.of(2, "released"), Block.of(3, scale=2.0, key_mm=6.0), Block.of(1, size_mm=(60.0, 26.0))],
    ids=["paper", "released", "keyed", "wide"],
)
def test_texture_picture(tmp_path: Path, block: Block, press: bool) -> None:
    path = tmp_path / "texture.png"
    pictures.texture_picture(block, path, press=press)
    image = pixels(path)
    assert min(image.shape[:2]) > 500
    edge = np.concatenate([image[:4].reshape(-1, 3), image[-4:].reshape(-1, 3), image[:, -4:].reshape(-1, 3)])
    assert (edge == 255).all(), "something runs off the picture"
    assert [one.name for one in tmp_path.iterdir()] == ["texture.png"]


def test_texture_pictures_are_equal_on_every_run(tmp_path: Path) -> None:
    paths = [tmp_path / f"{run}.png" for run in "ab"]
    for path in paths:
        pictures.texture_picture(Block.of(2, "released"), path, press=True)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_contact_radii_are_the_papers() -> None:
    assert [round(contact_radius_mm(force), 1) for force in (1.9, 3.0)] == [8.2, 9.2]
    assert contact_radius_mm(1.91295) == pytest.approx(8.25, abs=0.01)


def test_contact_circles_lie_where_the_grid_says(tmp_path: Path) -> None:
    """Measured in the picture: the circle of the highest force is as wide as it should be, in the axes' own scale."""
    pictures.texture_picture(Block.of(5), tmp_path / "press.png", press=True)
    image = pixels(tmp_path / "press.png").astype(int)
    across = image[:, : round(0.70 * image.shape[1])]
    blue = (np.abs(across - np.array([0x00, 0x72, 0xB2])).max(axis=2) < 12).nonzero()
    orange = (np.abs(across - np.array([0xD5, 0x5E, 0x00])).max(axis=2) < 12).nonzero()
    corners = 2 * contact_radius_mm(3.0137) + 5.0
    middle = 2 * contact_radius_mm(1.91295)
    assert np.ptp(blue[1]) / np.ptp(orange[1]) == pytest.approx(corners / middle, rel=0.02)
    assert np.ptp(blue[0]) / np.ptp(orange[0]) == pytest.approx(corners / middle, rel=0.02)


def test_a_grid_off_the_block_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the press grid reaches"):
        pictures.texture_picture(Block.of(1, size_mm=(8.0, 30.0)), tmp_path / "press.png", press=True)
    assert not list(tmp_path.iterdir())


def test_catalogue(tmp_path: Path) -> None:
    pictures.catalogue_picture([Block.of(number) for number in range(1, 7)], tmp_path / "six.png")
    shown = ink(pixels(tmp_path / "six.png"))
    assert shown.shape[1] > 1200
    thirds = np.array_split(shown, 3, axis=1)
    assert all(part[: len(part) // 2].mean() > 0.2 and part[len(part) // 2 :].mean() > 0.2 for part in thirds)


def test_without_matplotlib_the_command_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real = builtins.__import__

    def blocked(name: str, *rest: object) -> object:
        if name.partition(".")[0] == "matplotlib":
            raise ImportError(name)
        return real(name, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", blocked)
    for make in (
        lambda: pictures.preview_sheet([], tmp_path / "a.png"),
        lambda: pictures.texture_picture(Block.of(1), tmp_path / "a.png"),
    ):
        with pytest.raises(MissingToolError, match=r'pip install "tacbench-cad\[plot\]"'):
            make()
    assert not list(tmp_path.iterdir())


def test_an_output_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        pictures.preview_sheet([("box", box(1.0, 1.0, 1.0))], tmp_path / "none" / "sheet.png")


def test_importing_it_loads_no_plotting() -> None:
    code = (
        "import sys, tacbench_cad.render.pictures;"
        "print([m for m in ('matplotlib', 'scipy', 'OCP') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_users_settings_do_not_matter(tmp_path: Path) -> None:
    import matplotlib

    pictures.texture_picture(Block.of(1), tmp_path / "a.png")
    with matplotlib.rc_context({"font.size": 20.0, "axes.facecolor": "red", "savefig.bbox": "tight"}):
        pictures.texture_picture(Block.of(1), tmp_path / "b.png")
        assert matplotlib.rcParams["font.size"] == 20.0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
