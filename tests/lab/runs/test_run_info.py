"""Test ``run.json``: it round-trips, and it is compared with the current rig."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.interpolation import height_map
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError

HEX = Texture(
    name="hex",
    equation="three waves",
    surface=WaveSum(
        tuple(Wave(amplitude=0.3, f=frequency, g=1.0 - frequency, phase=0.1) for frequency in (0.0, 0.25, 1.0 / 3.0))
    ),
)
MAP = Texture(name="map", surface=height_map(np.random.default_rng(0).normal(size=(31, 26)), height_mm=2.0))
BLOCKS = {
    **{f"paper {number}": Block.of(number) for number in range(1, 7)},
    **{f"released {number}": Block.of(number, "released") for number in range(1, 7)},
    "scaled": Block.of(4, scale=1.5),
    "with key and label": Block.of(1, key_mm=3.0, label=True),
    "on a grid with its copy engraved": Block.of(2, sampling="grid", copy=7),
    "other sides": Block.of(3, size_mm=(25.0, 31.0), height_mm=8.0),
    "a user's own texture": Block.of(HEX),
    "a texture with creases": Block.of("diamond"),
    "a height map": Block.of(MAP, mm_per_unit=(1.0, 1.0, 1.0), size_mm=(24.0, 28.0)),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_the_block_is_rebuilt_from_run_json(name: str, make_info: Any) -> None:
    info = make_info(printed=PrintedBlock(block=BLOCKS[name], printer="my-printer", filament="tpu", copy=3))
    again = RunInfo.from_dict(json.loads(json.dumps(info.as_dict())))
    assert again == info
    assert again.printed.block == BLOCKS[name]
    assert again.printed.name == info.printed.name
    assert again.printed.block.height_at(4.0, 18.0) == BLOCKS[name].height_at(4.0, 18.0)
    assert again.presses == info.presses
    assert info.differences(again) == []


def test_a_shuffled_order_round_trips(make_info: Any) -> None:
    info = make_info(protocol=make_info().protocol.changed(order="random", seed=7))
    again = RunInfo.from_dict(json.loads(json.dumps(info.as_dict())))
    assert again.presses == info.presses
    assert [press.position for press in info.presses] != [press.position for press in make_info().presses]


def test_differences_are_reported_with_both_values(make_info: Any) -> None:
    info = make_info()
    settings = {"settings": {"requested": {"exposure": 7}, "actual": {"exposure": 5}}}
    other = make_info(sensor=settings, protocol=info.protocol.changed(settle_s=0.5), slot=1)
    assert info.differences(other) == [
        "protocol.steps.settle_s was 0.2, is now 0.5",
        "slot was 0, is now 1",
        "sensor.settings.requested.exposure was 5, is now 7",
    ]


def test_added_and_missing_settings_are_reported(make_info: Any) -> None:
    bare = make_info(gauge={"simulated": ""})
    assert bare.differences(make_info()) == ["gauge.calibration.scale_n_per_count was missing, is now 0.001"]
    assert make_info().differences(bare) == ["gauge.calibration.scale_n_per_count was 0.001, is now missing"]


def test_ports_identities_and_versions_may_change(make_info: Any) -> None:
    stage = {**make_info().stage, "identity": "virtual GRBL on /dev/pts/9", "port": "elsewhere", "firmware": "1.1i"}
    assert make_info().differences(make_info(stage=stage)) == []


def test_simulated_devices_are_listed(make_info: Any) -> None:
    assert make_info().simulated == ("stage: stage model",)
    assert make_info(stage={"simulated": ""}).simulated == ()


@pytest.mark.parametrize("value", [float("nan"), {1, 2}, object()])
def test_values_that_json_cannot_store_are_refused(value: object, make_info: Any) -> None:
    with pytest.raises(InputError, match="gauge: has a value that JSON cannot store"):
        make_info(gauge={"simulated": "", "scale": value})


@pytest.mark.parametrize("levels", [(), (2, 1), (1, 1), (0,), (3,)])
def test_levels_outside_the_protocol_are_refused(levels: tuple[int, ...], make_info: Any) -> None:
    with pytest.raises(InputError, match="levels"):
        make_info(levels=levels)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("block",), None),
        (("block", "waves"), "sin x"),
        (("block", "waves"), [[1, 2]]),
        (("block", "preset"), "own"),
        (("protocol", "targets", "forces_n"), [3.0, 1.0]),
        (("protocol", "haste"), 1),
        (("frame", "origin_mm"), [1.0]),
        (("levels",), 5),
        (("stage",), [1]),
        (("holder",), {}),
        (("sensor", "shape"), 7),
        (("sensor", "settings"), [1]),
        (("sensor", "settings", "actual"), "none"),
        (("sensor", "shape"), [24, "x"]),
    ],
)
def test_a_damaged_document_is_refused_with_a_message(path: tuple[str, ...], value: object, make_info: Any) -> None:
    document = json.loads(json.dumps(make_info().as_dict()))
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    with pytest.raises(InputError):
        RunInfo.from_dict(document)


def test_a_missing_key_is_reported(make_info: Any) -> None:
    document = make_info().as_dict()
    del document["holder"]
    with pytest.raises(InputError, match=r"run\.json: holder: is missing"):
        RunInfo.from_dict(document)
