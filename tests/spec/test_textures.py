"""The catalogue, the equations of the paper, and texture files with errors of all kinds."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.geometry.texturing import texturing
from tacbench_cad.lab.study.plate import block_of_word
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import catalogue, equation1, plane_waves
from tacbench_cad.spec.texture_files import find_texture, find_textures, read_texture
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError

U = np.linspace(0, 19, 301)
V = np.linspace(0, 20, 301)


def triangle(t: np.ndarray, highest: int) -> np.ndarray:
    return sum(8 / math.pi**2 * (-1) ** ((i - 1) / 2) / i**2 * np.sin(i * t) for i in range(1, highest + 1, 2))


def square(t: np.ndarray, highest: int) -> np.ndarray:
    return sum(4 / (math.pi * i) * np.sin(i * t) for i in range(1, highest + 1, 2))


@pytest.mark.parametrize(("preset", "highest"), [("paper", 25), ("released", 101)])
def test_the_six_textures_are_the_equations_of_the_paper(preset: str, highest: int) -> None:
    expected = [
        np.sin(U),
        np.sin(U) + np.sin(V + math.pi / 2),
        triangle(U, 25) + triangle(V, 25),
        square(U, highest) + square(V, highest),
        triangle(U, 25),
        square(U, highest),
    ]
    for pattern, values in zip(catalogue(preset), expected, strict=True):
        np.testing.assert_allclose(pattern.surface(U, V), values, atol=1e-12, err_msg=pattern.name)


@pytest.mark.parametrize("name", [4, "4", "texture-4", " Texture-4 "])
def test_a_texture_is_found_by_number_and_name(name: str | int) -> None:
    assert find_texture(name).number == 4


@pytest.mark.parametrize("name", [0, 7, "seven", "texture-", ""])
def test_an_unknown_texture_is_refused(name: str | int) -> None:
    with pytest.raises(InputError, match="1 to 6"):
        find_texture(name)


def read(folder: Path, text: str) -> Texture:
    return read_texture(write(folder, text))


def write(folder: Path, text: str) -> Path:
    path = folder / "texture.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_three_families_are_read(tmp_path: Path) -> None:
    definition = read_texture(
        write(tmp_path, '[texture]\nname="a"\nfamily="equation1"\nA1=1\nA2=0.5\nf1=1\nf2=2\nphase=0.3\n')
    )
    np.testing.assert_allclose(definition.surface(U, V), np.sin(U) + 0.5 * np.sin(2 * V + 0.3), atol=1e-12)
    two = read_texture(write(tmp_path, '[texture]\nname="b"\nfamily="series"\nlaw="square"\nN=5\naxes="y"\n'))
    np.testing.assert_allclose(two.surface(U, V), square(V, 5), atol=1e-12)
    text = '[texture]\nname="c"\nfamily="plane-waves"\n[[wave]]\namplitude=1\nf=1\ng=0.5\n'
    text += "[block]\nsize_mm=[20,25]\nheight_mm=6\nmm_per_unit=[1,1.5,0.5]\n"
    three = read_texture(write(tmp_path, text))
    np.testing.assert_allclose(three.surface(U, V), np.sin(U + 0.5 * V), atol=1e-12)
    assert three.block.size_mm == (20.0, 25.0)
    assert three.block.mm_per_unit == (1.0, 1.5, 0.5)
    assert three.block.height_mm == 6.0


def test_plane_waves_are_triples_or_quadruples() -> None:
    waves = plane_waves((0.6, 2.0, 1.0), (0.5, 0.0, 3.0, 0.2))
    np.testing.assert_allclose(waves(U, V), 0.6 * np.sin(2 * U + V) + 0.5 * np.sin(3 * V + 0.2), atol=1e-12)
    with pytest.raises(InputError, match="amplitude, f, g"):
        plane_waves((1.0, 2.0))  # type: ignore[arg-type]


GOOD = '[texture]\nname="hex"\nfamily="series"\nlaw="square"\nN=5\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace("law", "laws"), r'laws: unknown key; did you mean "law"'),
        (GOOD.replace("family", "famly"), r"family: is missing"),
        (GOOD.replace('"square"', '"sqare"'), r"law = 'sqare': must be 'triangle', 'square' or"),
        (GOOD.replace("N=5", "N=4"), r"N = 4.*odd.*3 and 5"),
        (GOOD.replace("N=5", "N=2.5"), r"N = 2.5.*whole number"),
        (GOOD.replace("N=5", ""), r"N: is missing"),
        (GOOD.replace("N=5", "N=999999"), r"at most"),
        (GOOD + "A1=1\n", r"A1: is a key of another table"),
        (GOOD.replace('"hex"', '"Hex!"'), r"a-z, 0-9"),
        (GOOD.replace('"hex"', '"holder"'), r"is the name of a part of the print set"),
        (GOOD.replace('"hex"', '"texture-4"'), r"is the name of a part of the print set"),
        (GOOD.replace('"series"', '"fourier"'), r"'equation1', 'series', 'plane-waves', 'image', 'sum'"),
        (GOOD + "[[wave]]\namplitude=1\nf=1\ng=1\n", r'only allowed with family = "plane-waves"'),
        (GOOD + "[block]\nsize=[1,2]\n", r'did you mean "size_mm"'),
        ('[texture]\nname="a"\nfamily="plane-waves"\n', r"at least one such table"),
        ('[texture]\nname="a"\nfamily="plane-waves"\n[[wave]]\namplitude=1\nf=1\n', r"wave 1. g: is missing"),
        ('[texture]\nname="a"\nfamily="plane-waves"\n[[wave]]\namplitude=inf\nf=1\ng=1\n', r"finite"),
        ('[texture]\nname="a"\nfamily="plane-waves"\n[[wave]]\namplitude=0\nf=1\ng=1\n', r"flat"),
        ("texture = 4\n", r"\[texture\].*must be a table"),
        ("[[[", r"not valid TOML"),
        ("", r"texture: is missing"),
    ],
)
def test_the_message_about_a_wrong_file_names_the_error(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        read_texture(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_folders_missing_files_and_binary_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="folder"):
        read_texture(tmp_path)
    with pytest.raises(InputError, match="No such file"):
        read_texture(tmp_path / "none.toml")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        read_texture(binary)


def test_a_flat_texture_is_refused() -> None:
    with pytest.raises(InputError, match="flat"):
        Texture(name="flat", equation="0", surface=WaveSum(()))


@pytest.mark.parametrize(
    ("wave", "field", "value"),
    [((1e7, 1.0, 0.0), "amplitude", 1e7), ((1.0, 1e308, 0.0), "f", 1e308), ((1.0, 0.0, -2e4), "g", -2e4)],
)
def test_numbers_out_of_range_are_refused(wave: tuple[float, float, float], field: str, value: float) -> None:
    with pytest.raises(InputError, match=f"texture far wave {field} = .*must be from -1") as refusal:
        Texture(name="far", surface=plane_waves(wave))
    assert refusal.value.value == value


def test_a_function_instead_of_a_sum_of_waves_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"texture bumps surface = 'function': must be a WaveSum, a SplineSurface or another Surface"
    ):
        Texture(name="bumps", surface=lambda u, v: u * v)  # type: ignore[arg-type]


def test_a_series_with_weights_and_a_sawtooth(tmp_path: Path) -> None:
    weights = read(tmp_path, '[texture]\nname="w"\nfamily="series"\nweights=[1, 0, 0.25]\naxes="x"\n')
    np.testing.assert_allclose(weights.surface(U, V), np.sin(U) + 0.25 * np.sin(3 * U), atol=1e-12)
    saw = read(tmp_path, '[texture]\nname="s"\nfamily="series"\nlaw="sawtooth"\nN=400\naxes="x"\n')
    assert float(saw.surface(1.0, 0.0)) == pytest.approx(1.0 / math.pi, abs=3e-3)


def test_a_wave_with_an_angle(tmp_path: Path) -> None:
    head = '[texture]\nname="a"\nfamily="plane-waves"\n[[wave]]\namplitude=1\nangle_deg=60\n'
    units = read(tmp_path, head + "wavelength=2\n[block]\nmm_per_unit=[1.2, 1.5, 1]\n")
    along = U * 0.5 + V * math.sqrt(0.75)
    np.testing.assert_allclose(units.surface(U, V), np.sin(math.pi * along), atol=1e-12)
    assert units.surface.unit == "units"
    for block in ("", "[block]\nmm_per_unit=[1.2, 1.5, 1]\n"):
        printed = read(tmp_path, head + "wavelength_mm=2\n" + block)
        assert (printed.surface.unit, printed.block.mm_per_unit) == ("mm", None)
        assert printed.equation == "1 mm sine of 2 mm at 60 degrees"
        np.testing.assert_allclose(printed.surface(U, V), np.sin(math.pi * along), atol=1e-12)


def test_a_sum_of_textures(tmp_path: Path) -> None:
    total = read(tmp_path, '[texture]\nname="t"\nfamily="sum"\nof=["1", "ripple"]\nweights=[1, 0.5]\n')
    expected = np.sin(U) + 0.5 * (np.sin(U + V) + 0.5 * np.cos(2 * U - 2 * V))
    np.testing.assert_allclose(total.surface(U, V), expected, atol=1e-12)
    assert total.equation == "1 texture-1 + 0.5 ripple"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('family="series"\nweights=[1]\nN=3\n', r"weights: replaces law and N"),
        ('family="series"\nN=3\n', r"law: is missing; a series needs law and N, or weights"),
        ('family="plane-waves"\n[[wave]]\namplitude=1\nf=1\ng=1\nangle_deg=3\n', r"give f and g, or angle_deg with"),
        ('family="sum"\nof=["1", "2"]\nweights=[1]\n', r"needs one number for each of the 2 textures"),
        ('family="image"\nfile="a.png"\nwaves=3\n', r"the number of waves belongs to fit"),
    ],
)
def test_keys_that_do_not_fit_together_are_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, f'[texture]\nname="a"\n{text}')


def test_a_sum_that_fades_out_towards_the_edges(tmp_path: Path) -> None:
    path = tmp_path / "faded.toml"
    text = '[texture]\nname = "faded"\nfamily = "sum"\nof = ["2"]\nfade = 2.0\n'
    path.write_text(text)
    with pytest.raises(InputError, match=r"\[block\] domain: is missing; fade needs"):
        read_texture(path)
    path.write_text(text + "[block]\ndomain = [[0, 8], [0, 9]]\n")
    texture = read_texture(path)
    assert texture.equation.endswith(", fading out over 2")
    edge = np.linspace(0.0, 8.0, 50)
    assert np.abs(texture.surface(edge, 0.0)).max() < 1e-9
    assert texture.surface(4.0, 5.0) == pytest.approx(math.sin(4.0) + math.cos(5.0), abs=2e-3)


OWN = '[texture]\nname="own"\nfamily="plane-waves"\n[[wave]]\namplitude=0.2\nangle_deg=60\nwavelength_mm=2\n'


def test_a_path_is_accepted_wherever_a_texture_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, OWN + "[block]\nsize_mm=[20, 21]\nheight_mm=6\n")
    monkeypatch.chdir(tmp_path)
    own = read_texture(str(path))
    assert own == read_texture(path) and own.block.size_mm == (20.0, 21.0)
    for word in (str(path), path, "texture.toml", Path("texture.toml"), own):
        assert find_texture(word) == own
        assert texturing(word).texture == own
        assert find_textures((word,), "paper") == [own]
        block = Block.of(word)
        assert (block.size_mm, block.height_mm) == ((20.0, 21.0), 6.0)
    assert block_of_word("texture.toml", "paper", 1.0, None, tmp_path) == Block.of(own)


@pytest.mark.parametrize("word", ["all", "later", "ALL"])
def test_a_word_for_several_textures_is_refused_where_one_is_needed(word: str) -> None:
    for ask in (find_texture, Block.of, texturing, lambda each: block_of_word(each, "paper", 1.0, None, Path())):
        with pytest.raises(InputError, match=rf"texture = '{word}': means several textures; name one: 1 to 6"):
            ask(word)
    assert len(find_textures((word,), "paper")) == (14 if word == "later" else 6)


def test_a_file_that_has_the_name_of_a_texture_does_not_hide_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "4").write_text(OWN, encoding="utf-8")
    (tmp_path / "own").write_text(OWN, encoding="utf-8")
    assert find_texture("4").number == 4
    assert find_texture("./4").name == find_texture("own").name == "own"
    total = '[texture]\nname="t"\nfamily="sum"\nof=["4"]\n'
    assert read(tmp_path, total).surface == find_texture(4).surface


@pytest.mark.parametrize(
    ("names", "where"),
    [
        (("texture",), "texture.toml"),
        (("texture", "second"), "second.toml"),
        (("texture", "second", "third"), "third.toml"),
    ],
)
def test_files_that_name_each_other_are_refused(names: tuple[str, ...], where: str, tmp_path: Path) -> None:
    for name, following in zip(names, [*names[1:], names[0]], strict=True):
        text = f'[texture]\nname="{name}"\nfamily="sum"\nof=["2", "./{following}.toml"]\n'
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    with pytest.raises(
        InputError, match=rf"{where}: \[texture\] of = './texture.toml': is this file itself, or"
    ) as caught:
        read_texture(tmp_path / "texture.toml")
    assert "\n" not in str(caught.value)


def test_a_sum_of_mm_and_units_needs_the_mm_per_unit(tmp_path: Path) -> None:
    """The units are resolved when the file is read, and an explicit table also counts for files with their own."""
    (tmp_path / "own.toml").write_text(OWN, encoding="utf-8")
    total = '[texture]\nname="t"\nfamily="sum"\nof=["own.toml", "1"]\n'
    with pytest.raises(InputError, match=r"\[block\] mm_per_unit: is missing; texture-1 has units"):
        read(tmp_path, total)
    mixed = read(tmp_path, total + "[block]\nmm_per_unit=[1.2, 1.5, 0.5]\ndomain=[[1, 11], [2, 12]]\n")
    expected = 0.2 * np.sin(math.pi * (0.5 * U + math.sqrt(0.75) * V)) + 0.5 * np.sin(U / 1.2)
    np.testing.assert_allclose(mixed.surface(U, V), expected, atol=1e-12)
    assert (mixed.surface.unit, mixed.block.domain) == ("mm", ((1.2, 13.2), (3.0, 18.0)))
    assert Block.of(mixed).size_mm == pytest.approx((12.0, 15.0))
    only_mm = total.replace(', "1"', "")
    with pytest.raises(InputError, match=r"\[block\] mm_per_unit = \(1\.2, 1\.5, 0\.5\): the texture is in mm"):
        read(tmp_path, only_mm + "[block]\nmm_per_unit=[1.2, 1.5, 0.5]\n")
    for name, unit in (("a", 1.0), ("b", 2.0)):
        text = f'[texture]\nname="{name}"\nfamily="equation1"\nf1=1\nf2=1\n[block]\nmm_per_unit=[{unit}, 1, 1]\n'
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    both = '[texture]\nname="t"\nfamily="sum"\nof=["a.toml", "b.toml"]\n'
    with pytest.raises(
        InputError, match=r"\[block\] mm_per_unit: is missing; the files in \[texture\] of have different"
    ):
        read(tmp_path, both)
    assert read(tmp_path, both + "[block]\nmm_per_unit=[3, 1, 1]\n").block.mm_per_unit == (3.0, 1.0, 1.0)


def test_a_hexagonal_bump_has_six_neighbours_at_the_pitch() -> None:
    surface = Texture.hex_bumps(pitch_mm=1.5, height_mm=0.4).surface
    around = np.radians(np.arange(0.0, 360.0, 60.0))
    top = surface(0.0, 0.0)
    np.testing.assert_allclose(surface(1.5 * np.cos(around), 1.5 * np.sin(around)), top, atol=1e-12)
    assert (surface(0.75 * np.cos(around), 0.75 * np.sin(around)) < top - 0.2).all()


@pytest.mark.parametrize(
    ("shape", "period"),
    [("ridges", (1.5, 0.7)), ("dots", (1.5, 1.5)), ("checks", (1.5, 1.5)), ("hex_bumps", (1.5, 0.0))],
)
def test_shapes_in_mm_have_the_height_and_the_period(shape: str, period: tuple[float, float]) -> None:
    texture = getattr(Texture, shape)(pitch_mm=1.5, height_mm=0.4)
    surface = texture.surface
    assert surface.unit == "mm" and texture.name == shape.replace("_", "-")
    assert Block.of(texture).relief_mm == pytest.approx(0.4, abs=1e-6)
    np.testing.assert_allclose(surface(U + period[0], V + period[1]), surface(U, V), atol=1e-12)


def test_textures_come_from_arrays_functions_and_formulas(tmp_path: Path) -> None:
    table = np.add.outer(np.sin(np.arange(9.0)), np.arange(9.0))
    relief = Texture.from_heights(table, mm_per_pixel=0.1, name="mine")
    assert relief.surface(0.0, 0.8) == pytest.approx(table[0, 0]) and relief.surface.unit == "mm"
    assert Texture.from_heights(table, waves=5).surface.unit == "mm"
    np.save(tmp_path / "mine.npy", table)
    assert Texture.from_image("mine", tmp_path / "mine.npy", mm_per_pixel=0.1).surface == relief.surface
    crater = Texture.from_function(lambda u, v: u * u + v, u=(0.0, 2.0), v=(0.0, 2.0), error=1e-3)
    assert crater.surface(1.5, 1.0) == pytest.approx(3.25, abs=1e-3)
    assert Texture.series("square", 25).surface == Texture.of(4).surface == Texture.catalogue()[3].surface
    assert Texture.equation1(1.0, 0.5, 2.0, 3.0).surface == equation1(1.0, 0.5, 2.0, 3.0)
    assert Texture.harmonics([1.0, 0.5]).equation == "sin u + 0.5 sin(2u) + sin v + 1 more waves"
    assert Texture.read(write(tmp_path, OWN)) == Texture.of(tmp_path / "texture.toml")
