"""The folder of a texture: written completely or not at all, extended by other targets, with only one texture."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import pytest

from tacbench_cad.extensions.simulators import SIMULATOR_TARGETS, folder
from tacbench_cad.extensions.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.extensions.simulators.folder import README, RECORD, export_to_simulators
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

LIGHT = ["obj", "npy"]


def hashes_below(root: Path) -> dict[str, str]:
    """Return the hash of every file below a folder."""
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in root.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize("target", SIMULATOR_TARGETS)
def test_every_target_lists_and_describes_its_files(target: str, tmp_path: Path) -> None:
    (export,) = export_to_simulators([Block.of("5", scale=0.5)], [target], tmp_path)
    assert export.folder == tmp_path / "texture-5"
    hashes = hashes_below(export.folder)
    assert set(hashes) == {*export.files, RECORD, README}
    assert all(export.files.values())
    record = json.loads((export.folder / RECORD).read_text(encoding="utf-8"))
    assert record["targets"][target]["files"] == {name: hashes[name] for name in export.files}
    note = (export.folder / README).read_text(encoding="utf-8")
    assert SIMULATOR_TARGETS[target].title in note and "Tested" in note and "Units" in note
    for name in export.files:
        assert name in note or "tiles/" in name
    for words in ("scale 0.5", "Block frame", "lower corner of the underside", "Formula"):
        assert words in note
    export_to_simulators([Block.of("5", scale=0.5)], [target], tmp_path / "again")
    assert hashes_below(tmp_path / "again" / "texture-5") == hashes


def test_another_target_is_added_and_the_users_files_are_kept(tmp_path: Path) -> None:
    block = Block.of("5")
    export_to_simulators([block], ["mjcf", "urdf"], tmp_path)
    users_file = tmp_path / "texture-5" / "mine" / "scene.xml"
    users_file.parent.mkdir()
    users_file.write_text("mine")
    before = hashes_below(tmp_path)
    (export,) = export_to_simulators([block], ["sdf"], tmp_path)
    after = hashes_below(tmp_path)
    assert set(export.files) == {"texture-5.sdf", "texture-5.obj"}
    changed = {"texture-5/README.md", "texture-5/texture.json"}
    assert {name for name in before if before[name] != after[name]} == changed
    assert set(after) - set(before) == {"texture-5/texture-5.sdf"}
    note = (tmp_path / "texture-5" / README).read_text(encoding="utf-8")
    assert [SIMULATOR_TARGETS[name].title in note for name in ("mjcf", "urdf", "sdf", "usd")] == [
        True,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("other", "needle"),
    [
        (Block.of("1", scale=2.0), "scale 1"),
        (Block.of("1", "released"), "preset paper"),
        (Block.of("1", height_mm=8.0), "height_mm"),
        (Block.of(dataclasses.replace(Block.of("2").texture, name="texture-1", number=1)), "waves"),
    ],
)
def test_a_folder_with_another_texture_is_refused_and_not_changed(other: Block, needle: str, tmp_path: Path) -> None:
    export_to_simulators([Block.of("1")], LIGHT, tmp_path)
    before = hashes_below(tmp_path)
    with pytest.raises(InputError, match="contains another texture") as refusal:
        export_to_simulators([Block.of("2"), other], LIGHT, tmp_path)
    assert needle in str(refusal.value) and "texture-1" in str(refusal.value)
    assert hashes_below(tmp_path) == before, "something was written"


def test_folders_with_other_files_are_refused(tmp_path: Path) -> None:
    place = tmp_path / "texture-1"
    place.write_text("a file")
    with pytest.raises(InputError, match="is a file"):
        export_to_simulators([Block.of("1")], LIGHT, tmp_path)
    place.unlink()
    place.mkdir()
    (place / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match=r"contains files but no texture\.json"):
        export_to_simulators([Block.of("1")], LIGHT, tmp_path)
    for text in ("", "[]", "{}", '{"block": {}, "targets": {}}', '{"block": 3, "targets": {"obj": 4}}'):
        (place / RECORD).write_text(text)
        with pytest.raises(InputError, match="is not a record of export-simulator"):
            export_to_simulators([Block.of("1")], LIGHT, tmp_path)
    assert (place / "thesis.tex").read_text() == "precious"
    with pytest.raises(InputError, match="not a folder"):
        export_to_simulators([Block.of("1")], LIGHT, place / "thesis.tex")


def test_a_failed_export_does_not_change_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    export_to_simulators([Block.of("1")], ["npy"], tmp_path)
    before = hashes_below(tmp_path)

    def half(asset: SimulatorAsset, where: Path) -> TargetFiles:
        (where / "half.obj").write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(SIMULATOR_TARGETS, "obj", dataclasses.replace(SIMULATOR_TARGETS["obj"], write=half))
    with pytest.raises(InputError, match="is full"):
        export_to_simulators([Block.of("1")], ["npy", "obj"], tmp_path)
    assert hashes_below(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["texture-1"]
    with pytest.raises(InputError, match="is full"):
        export_to_simulators([Block.of("2")], ["obj"], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["texture-1"]


@pytest.mark.parametrize("state", ["before the swap", "amid the swap", "after the swap"])
def test_a_killed_export_is_cleaned_up(state: str, tmp_path: Path) -> None:
    export_to_simulators([Block.of("1")], ["npy"], tmp_path)
    place = tmp_path / "texture-1"
    before = hashes_below(place)
    new, old = tmp_path / f"{folder._NEW}texture-1", tmp_path / f"{folder._OLD}texture-1"
    if state == "after the swap":
        old.mkdir()
        (old / "texture-1.npy").write_text("old")
    else:
        new.mkdir()
        (new / "texture-1.obj").write_text("half")
    if state == "amid the swap":
        place.rename(old)
    export_to_simulators([Block.of("2")], ["npy"], tmp_path)
    assert hashes_below(place) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["texture-1", "texture-2"]


def test_unknown_and_missing_targets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='did you mean "mjcf"'):
        export_to_simulators([Block.of("1")], ["mjfc"], tmp_path / "out")
    with pytest.raises(InputError, match="allowed: mjcf, urdf"):
        export_to_simulators([Block.of("1")], [], tmp_path / "out")
    with pytest.raises(InputError, match="without a key"):
        export_to_simulators([Block.of("1", key_mm=3.0)], ["obj"], tmp_path / "out")
    assert not (tmp_path / "out").exists()
