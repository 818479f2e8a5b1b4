"""Test FILE.toml, the plan of presses and their values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.printers import write_corrected

from tacbench_cad.lab.acquire.study_file import StudyFile, read_study, virtual_study
from tacbench_cad.lab.study.motion import motion_of
from tacbench_cad.lab.study.presses import block_order, plan_presses
from tacbench_cad.lab.study.spec import HolderRim, PlannedBlock, Protocol, Study, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N, PressGrid
from tacbench_cad.util.errors import InputError

BLOCK = '[block]\ntexture = 4\nprinter = "bambu"\nfilament = "PLA-"\n'
STAGE = (
    '[stage]\ndriver = "grbl"\nport = "/dev/ttyUSB0"\norigin_mm = [1, 2, 3]\nlimits_mm = [[0, 9], [0, 9], [-9, 0]]\n'
)
RIG = STAGE + '[gauge]\ndriver = "serial"\n[sensor]\ndriver = "opencv"\ndevice = "cam"\nexposure = 3\n'


def _read(tmp_path: Path, text: str) -> StudyFile:
    path = tmp_path / "study.toml"
    path.write_text(text)
    return read_study(path)


def test_a_single_block_gets_the_papers_protocol(tmp_path: Path) -> None:
    file = _read(tmp_path, BLOCK + RIG)
    (block,) = file.study.blocks
    assert block.printed.name == "texture-4_paper_x1_bambu-p1p_pla-minus_copy01"
    assert block.printed.object_label == 4 and block.levels == (1, 2, 3)
    assert file.study.protocol == Protocol() and file.study.presses == 150
    assert file.required_rig.stage.limits_mm == ((0.0, 9.0), (0.0, 9.0), (-9.0, 0.0))
    assert file.required_rig.sensor.options == {"exposure": 3} and file.out is None


def test_a_study_lists_every_print_and_scales_its_grid(tmp_path: Path) -> None:
    file = _read(
        tmp_path,
        'out = "runs"\n[study]\ntextures = [1, "texture-6"]\nscale = 2\n'
        'prints = [{printer = "ender", filament = "PLA+", copies = 2}, {printer = "own-1", filament = "abs", '
        "copies = [4], force_levels = [2]}]\n",
    )
    assert [(p.printed.texture, p.printed.combination, p.printed.copy, p.levels) for p in file.study.blocks] == [
        ("texture-1", "ender-3_pla-plus", 1, (1, 2, 3)),
        ("texture-6", "ender-3_pla-plus", 1, (1, 2, 3)),
        ("texture-1", "ender-3_pla-plus", 2, (1, 2, 3)),
        ("texture-6", "ender-3_pla-plus", 2, (1, 2, 3)),
        ("texture-1", "own-1_abs", 4, (2,)),
        ("texture-6", "own-1_abs", 4, (2,)),
    ]
    assert file.study.protocol.positions.grid == PressGrid.paper(2.0) and file.out == tmp_path / "runs"
    assert file.study.presses == 4 * 150 + 2 * 50 and file.rig is None


def test_a_users_texture_is_found_next_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "wave.toml").write_text(
        '[texture]\nname = "wave"\nfamily = "plane-waves"\n[[wave]]\namplitude = 1\nf = 1\ng = 1\n'
    )
    file = _read(tmp_path, BLOCK.replace("4", '"wave.toml"'))
    assert file.study.blocks[0].printed.object_label == "wave"


@pytest.mark.parametrize(
    ("text", "needles"),
    [
        (BLOCK + "[protocl]\n", ["protocl", "protocol"]),
        (BLOCK + "[protocol]\nrepeat = 2\n", ["[protocol] repeat", "repeats"]),
        (BLOCK + "[protocol]\nforces_n = [1.0]\n", ["[protocol] forces_n", "is a key of another table"]),
        (BLOCK.replace("printer", "priter"), ["[block] priter", "printer"]),
        (BLOCK + "[study]\n", ["exactly one"]),
        (BLOCK.replace("4", "7"), ["texture", "7", "1 to 6"]),
        (BLOCK.replace("4", "true"), ["[block] texture", "text"]),
        (BLOCK + "copy = 0\n", ["[block] copy", "0", "at least 1"]),
        (
            BLOCK + "[protocol]\ntargets.forces_n = [1.0, 6.0]\ntargets.bands_n = [0.1, 0.1]\n",
            ["forces_n", "6.0", "below 5 N"],
        ),
        (BLOCK + "[protocol]\ntargets.forces_n = [1.0]\n", ["bands_n", "missing"]),
        (
            BLOCK + "[protocol]\ntargets.forces_n = [2.0, 1.0]\ntargets.bands_n = [0.1, 0.1]\n",
            ["forces_n", "in increasing order"],
        ),
        (BLOCK + "[protocol]\ntargets.bands_n = [0.1]\n", ["bands_n", "3 numbers"]),
        (BLOCK + '[protocol]\npositions.grid = "2mm"\n', ["[protocol.positions] grid", "2mm"]),
        (
            BLOCK + "[protocol]\npositions.grid = {x_mm = [1, 30], y_mm = [1, 2]}\n",
            ["30 x 2 mm", "too small for the press grid"],
        ),
        (BLOCK + "[protocol]\npositions.grid = {x_mm = [2, 1], y_mm = [1, 2]}\n", ["grid x_mm", "in increasing order"]),
        (BLOCK + "[protocol.steps]\nsettle_s = nan\n", ["settle_s", "finite"]),
        (BLOCK + "[protocol]\nrepeats = 1000\ntargets.depths_mm = 5\n", ["[protocol.targets] depths_mm", "list"]),
        (
            BLOCK + f"[protocol]\nrepeats = 1000\ntargets.forces_n = {[i / 300 for i in range(1, 901)]}\n"
            f"targets.bands_n = {[1e-4] * 900}\n",
            ["[protocol] repeats", "22,500,000 presses", "at most 1,000,000"],
        ),
        (BLOCK + RIG.replace("grbl", "gbrl"), ["[stage] driver", "gbrl", "grbl"]),
        (BLOCK + RIG.replace("origin_mm = [1, 2, 3]\n", ""), ["[stage] origin_mm", "missing"]),
        (BLOCK + RIG.replace("[-9, 0]", "[0, -9]"), ["limits_mm z", "lower"]),
        (BLOCK + STAGE + '[sensor]\ndriver = "opencv"\n', ["[gauge] driver", 'contact = "depth"']),
        (
            BLOCK + STAGE + '[sensor]\ndriver = "opencv"\n[protocol]\ntargets.contact = "depth"\n',
            ["[protocol.targets] touch", "needs a gauge"],
        ),
        ("out = 3\n" + BLOCK, ["out", "3", "string"]),
        ('[study]\ntextures = [1, 1]\nprints = [{printer = "a", filament = "b"}]\n', ["study", "twice"]),
        ('[study]\nprints = [{printer = "a b", filament = "b"}]\n', ["printer", "a b", "hyphens"]),
        ('[study]\nprints = [{printer = "a", filament = "b", force_levels = [4]}]\n', ["force_levels", "4", "1 to 3"]),
        ("[study]\n", ["[study] prints", "missing"]),
        ('[study]\nlayouts = ["a.csv"]\npreset = "paper"\n', ["[study] preset", "unknown key"]),
        ('[study]\nprints = [{printer = "a", filament = "b", copys = 2}]\n', ["[prints 1] copys", '"copies"']),
    ],
)
def test_mistakes_are_reported(tmp_path: Path, text: str, needles: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        _read(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message and "study.toml" in message
    for needle in needles:
        assert needle in message, message


def test_a_texture_without_the_ending_of_its_file_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "cross60.toml").write_text("")
    with pytest.raises(InputError, match=r"texture = 'cross60': did you mean the file \"cross60\.toml\"\?"):
        _read(tmp_path, BLOCK.replace("texture = 4", 'texture = "cross60"'))


def test_the_plan_presses_every_position_at_every_force_twice() -> None:
    presses = plan_presses(Protocol(), (1, 2, 3), "any")
    assert [p.number for p in presses] == list(range(1, 151))
    assert len({(p.force_level, p.repeat, p.position) for p in presses}) == 150
    assert [p.position for p in presses[:25]] == list(range(1, 26))
    assert (presses[0].x_mm, presses[0].y_mm, presses[0].target_n) == (4.0, 18.0, FORCES_N[0])
    assert (presses[-1].x_mm, presses[-1].y_mm, presses[-1].force_level, presses[-1].repeat) == (9.0, 23.0, 3, 2)


def test_a_shuffled_plan_is_seeded_and_depends_on_block_and_repeat() -> None:
    protocol = Protocol().changed(order="random", seed=7)
    first, again, other = (plan_presses(protocol, (2,), name) for name in ("a", "a", "b"))
    assert first == again and [p.position for p in first] != [p.position for p in other]
    assert sorted(p.position for p in first[:25]) == list(range(1, 26))
    assert [p.position for p in first[:25]] != [p.position for p in first[25:]]
    assert [p.position for p in plan_presses(protocol, (2,), "a")] != [
        p.position for p in plan_presses(Protocol().changed(order="random", seed=8), (2,), "a")
    ]


def test_depth_mode_has_depths_and_no_forces() -> None:
    presses = plan_presses(Protocol().changed(contact="depth", depths_mm=(0.5, 1.0)), (1, 2), "any")
    assert len(presses) == 100 and presses[-1].depth_mm == 1.0
    assert all(p.target_n is None and p.band_n is None for p in presses)


def test_the_blocks_of_a_study_may_be_shuffled() -> None:
    blocks = tuple(block for texture in "123456" for block in virtual_study(texture=texture).study.blocks)
    study = Study(blocks=blocks, protocol=Protocol().changed(block_order="random", seed=1))
    assert block_order(study) != blocks and set(block_order(study)) == set(blocks)
    assert block_order(Study(blocks=blocks, protocol=Protocol())) == blocks


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_the_work_frame_converts_in_both_directions(turns: int) -> None:
    frame = WorkFrame(origin_mm=(10.0, 20.0, -30.0), quarter_turns=turns)
    point = (1.0, 2.0, 3.0)
    assert frame.to_work(frame.to_stage(point)) == point
    assert frame.to_stage((0.0, 0.0, 0.0)) == frame.origin_mm
    x, y, _ = frame.to_stage((1.0, 0.0, 0.0))
    assert (x - 10.0, y - 20.0) == [(1, 0), (0, 1), (-1, 0), (0, -1)][turns]
    assert frame.shifted((1.0, 1.0, 1.0)).origin_mm == (11.0, 21.0, -29.0)


def test_an_unknown_virtual_study_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="simulated, virtual-grbl, virtual-marlin"):
        virtual_study(driver="grbl")


def test_values_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="gap_mm"):
        HolderRim(gap_mm=float("nan"))
    with pytest.raises(InputError, match="quarter_turns"):
        WorkFrame(origin_mm=(0.0, 0.0, 0.0), quarter_turns=4)
    block = virtual_study().study.blocks[0]
    with pytest.raises(InputError, match="force_levels"):
        Study(blocks=(PlannedBlock(printed=block.printed, levels=(0,)),), protocol=Protocol())


SLIDE = BLOCK + '[protocol.motion]\nname = "slide"\n'


def test_a_slide_has_a_direction_in_the_frame_of_the_block(tmp_path: Path) -> None:
    protocol = _read(tmp_path, SLIDE + "length_mm = 4\ndirection_deg = 150\n").study.protocol
    assert protocol.series_frames == 10
    assert protocol.path_mm(2)[1] == pytest.approx(protocol.positions.grid.positions_mm + np.array([-(3.0**0.5), 1.0]))
    slide = motion_of(protocol.motion)
    assert slide is not None and slide.seconds == pytest.approx(0.8)
    assert slide.shift_mm(1.0) == pytest.approx((-(12.0**0.5), 2.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("length_mm = 30\n", r"the slide from x 4, y 23 mm leaves the top of the block .* by 23"),
        ("length_mm = 4.5\ndirection_deg = 180\n", r"\[protocol.motion\].* from x 4, .* by 0\.5 mm"),
        ("frames = 1\n", r"frames = 1: must be at least 2"),
        ("speed_mm_s = 0\n", "speed_mm_s"),
        ("slide_mm = 3\n", "slide_mm"),
    ],
)
def test_slides_that_are_not_possible_are_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        _read(tmp_path, SLIDE + text)


def test_the_example_of_slides_is_a_valid_study() -> None:
    file = read_study(Path(__file__).parents[3] / "examples" / "slide.toml")
    assert file.study.protocol.series_frames == 8 and file.study.presses == 16
    assert file.required_rig.stage.driver == "virtual-grbl"


def test_a_slide_must_not_cross_the_key(tmp_path: Path) -> None:
    keyed = SLIDE.replace("texture = 4", "texture = 4\nkey_mm = 3")
    keyed = keyed.replace(
        "[protocol.motion]", "[protocol]\npositions.grid = { x_mm = [19], y_mm = [5] }\n[protocol.motion]"
    )
    assert _read(tmp_path, keyed + "direction_deg = 0\nlength_mm = 4\n").study.presses
    with pytest.raises(InputError, match="from x 19, y 5 mm leaves the top"):
        _read(tmp_path, keyed + "direction_deg = -45\n")


def test_prints_of_files_that_differ_from_the_block(tmp_path: Path) -> None:
    corrected = write_corrected(tmp_path / "corrected", Block.of(1))
    text = '[study]\ntextures = [1]\nprints = [{printer = "ender-3", filament = "pla-plus", files = "corrected"}'
    file = _read(tmp_path, f'{text}, {{printer = "bambu-p1p", filament = "petg"}}]\n')
    other, plain = (planned.printed for planned in file.study.blocks)
    assert other.block == plain.block == plain.in_file == Block.of(1) and plain.file is None
    assert other.in_file.size_mm == corrected.file.size_mm and other.in_file.texture.name == "t1-corr"
    assert other.name == "texture-1_paper_x1_from-t1-corr_ender-3_pla-plus_copy01"
    with pytest.raises(InputError, match=r"texture-2\.toml"):
        _read(tmp_path, text.replace("[1]", "[1, 2]") + "]\n")
    write_corrected(tmp_path / "corrected", Block.of(4))
    block = _read(tmp_path, BLOCK + 'files = "corrected"\n').study.blocks[0].printed
    assert block.in_file.texture.name == "t4-corr" and block.block == Block.of(4)
