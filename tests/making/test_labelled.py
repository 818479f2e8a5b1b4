"""The blocks that a person names on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tacbench_cad.making.labelled import blocks_named
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.storage import block_values
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import MANIFEST_NAME


def _row(file: str, block: Block) -> dict[str, Any]:
    return {"file": file, "sha256": "", "part": block.name, "kind": "block", "block": block_values(block)}


def test_without_a_word_the_six_textures_are_possible() -> None:
    blocks = blocks_named(None, "paper", 0.5, 2.0)
    assert [block.texture.number for block in blocks] == [1, 2, 3, 4, 5, 6]
    assert {(block.scale, block.key_mm) for block in blocks} == {(0.5, 2.0)}


@pytest.mark.parametrize("word", ["4", "texture-4", "T4 PAPER X1", "texture-4_paper_x1"])
def test_a_texture_a_label_and_a_name_mean_the_same_block(word: str) -> None:
    (block,) = blocks_named(word)
    assert block.name.removesuffix("_label") == Block.of(4).name


def test_a_label_has_scale_and_copy_and_a_name_has_everything() -> None:
    (labelled,) = blocks_named("T2 RELEASED X0.5 03")
    assert (labelled.preset, labelled.scale, labelled.copy) == ("released", 0.5, 3)
    own = Block.of("dunes", scale=1.5, copy=2)
    (engraved,) = blocks_named(" ".join(own.label_words))
    assert engraved.label_words == own.label_words
    (named,) = blocks_named("texture-3_paper_x1_key3_copy07")
    assert (named.key_mm, named.copy) == (3.0, 7)


def test_the_name_of_a_block_gives_the_same_block() -> None:
    for block in (
        Block.of(4),
        Block.of(2, "released", scale=0.35),
        Block.of(1, size_mm=(41.5, 30.25), height_mm=9.0, scale=1.5, key_mm=2.0),
        Block.of(3, sampling="grid"),
        Block.of(6, mm_per_unit=(1.5, 2.0, 0.5), sampling=Tolerance(mm=0.005)),
        replace(Block.of(2, copy=3, key_mm=2.5), origin_uv=(-3.25, -0.5)),
    ):
        assert blocks_named(block.name) == [block]


def test_a_print_set_means_its_blocks_once(tmp_path: Path) -> None:
    blocks = [Block.of(1, copy=1), Block.of(1, copy=2), Block.of(5, key_mm=3.0)]
    rows = [_row(f"{i}.stl", block) for i, block in enumerate(blocks)]
    rows.append({"file": "holder.stl", "sha256": "", "part": "holder_x1", "kind": "holder"})
    (tmp_path / MANIFEST_NAME).write_text(json.dumps({"schema": 1, "files": rows}), encoding="utf-8")
    assert [block.name for block in blocks_named(str(tmp_path))] == ["texture-1_paper_x1", "texture-5_paper_x1_key3"]


@pytest.mark.parametrize("word", ["4", "texture-4", "dunes"])
def test_a_texture_comes_before_a_folder_with_its_name(
    word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / word).mkdir()
    assert blocks_named(word) == [Block.of(word)]
    row = _row("1.stl", Block.of(1))
    (tmp_path / word / MANIFEST_NAME).write_text(json.dumps({"schema": 1, "files": [row]}), encoding="utf-8")
    assert blocks_named(f"./{word}") == [Block.of(1)]


def test_a_folder_without_blocks_and_an_unknown_word_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no manifest"):
        blocks_named(str(tmp_path))
    with pytest.raises(InputError, match="texture"):
        blocks_named("textur-4")
    with pytest.raises(InputError, match="texture"):
        blocks_named("T4-CORR PAPER X1")
