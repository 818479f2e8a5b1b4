"""Drivers are found by entry points: ours and those of other packages."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers import example_stage
from helpers.devices import install_package

from tacbench_cad.cli import rig
from tacbench_cad.lab.rig import registry
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.rig.registry import GROUPS, Driver, find_driver
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.entries import groups
from tacbench_cad.util.errors import InputError, MissingToolError

OWN = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "entry-points"
]
EXAMPLE = Path(example_stage.__file__).read_text(encoding="utf-8")
LIMITS = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))


@pytest.fixture(autouse=True)
def _forget_installed_packages() -> Iterator[None]:
    yield
    groups.cache_clear()


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in GROUPS for name in OWN[GROUPS[kind]]])
def test_each_of_our_drivers_can_be_loaded_and_describes_itself(kind: registry.Kind, name: str) -> None:
    driver = find_driver(kind, name)
    assert isinstance(driver, Driver) and driver.summary and "install" in driver.install


def test_a_class_of_another_package_is_a_driver_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_package(tmp_path, monkeypatch, "[tacbench.stages]\nlab-arm = lab_arm:ExampleStage\n", lab_arm=EXAMPLE)
    settings = StageSettings(driver="lab-arm", port="10.0.0.7", limits_mm=LIMITS)
    with open_stage(settings) as stage:
        assert stage.identity == "example arm 1.0 at 10.0.0.7"
        assert stage.move((1.0, 2.0, 3.0), 5.0) == (1.0, 2.0, 3.0)
    with pytest.raises(InputError, match='did you mean "lab-arm"'):
        find_driver("stage", "lab-arn")
    with pytest.raises(InputError, match="allowed: imada, mark-10"):
        find_driver("gauge", "lab-arm")


OWN_DRIVER = """
from tacbench_cad.lab.rig.registry import GROUPS, Driver

def opened(settings, context):
    raise AssertionError("must not be opened")

DRIVER = Driver(
    open=opened, summary="an arm", connection="network", modules=("no_such_arm",), install="pip install no-such-arm"
)
"""


def test_a_missing_package_of_a_driver_is_named_with_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_package(tmp_path, monkeypatch, "[tacbench.stages]\nlab-arm = lab_arm:DRIVER\n", lab_arm=OWN_DRIVER)
    with pytest.raises(
        MissingToolError, match="'lab-arm': needs no_such_arm, not installed: run pip install no-such-arm"
    ):
        open_stage(StageSettings(driver="lab-arm", limits_mm=LIMITS))


def test_another_package_cannot_replace_our_driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_package(tmp_path, monkeypatch, "[tacbench.stages]\ngrbl = lab_arm:DRIVER\n", lab_arm=OWN_DRIVER)
    assert registry.drivers("stage")["grbl"].value == OWN["tacbench.stages"]["grbl"]


def listed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    rig.command(["drivers", *words], prog_name="tacbench rig", standalone_mode=False)
    return capsys.readouterr().out


def test_the_list_names_what_each_driver_needs(capsys: pytest.CaptureFixture[str]) -> None:
    drivers = {(row["kind"], row["name"]): row for row in json.loads(listed(capsys, "--json"))["drivers"]}
    grbl = drivers["stage", "grbl"]
    assert grbl["needs"] == ["pyserial"] and grbl["missing"] == [] and grbl["package"] == "tacbench-cad"
    assert "any USB camera that OpenCV opens" in listed(capsys)


def test_a_driver_that_cannot_be_imported_is_listed_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install_package(tmp_path, monkeypatch, "[tacbench.gauges]\nlab-cell = lab_cell:Cell\n", lab_cell="1 / 0\n")
    (row,) = [row for row in json.loads(listed(capsys, "--json"))["drivers"] if row["name"] == "lab-cell"]
    assert row["package"] == "lab-arm" and "ZeroDivisionError" in row["error"]
    assert "ZeroDivisionError" in listed(capsys)
