"""A user's own stage by ``module:name``, and every way in which the name can be wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import example_stage

from tacbench_cad.lab.rig import plugin
from tacbench_cad.lab.rig.drivers import open_stage
from tacbench_cad.lab.rig.errors import NoAnswerError, OutOfRangeError
from tacbench_cad.lab.rig.stage import Stage
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError

HERE = Path(example_stage.__file__).parent
LIMITS = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))


def settings(driver: str, **more: object) -> StageSettings:
    return StageSettings(driver=driver, limits_mm=LIMITS, **more)  # type: ignore[arg-type]


def test_the_example_is_a_stage_within_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    with open_stage(settings("example_stage:ExampleStage", port="10.0.0.7")) as stage:
        assert isinstance(stage.stage, Stage)
        assert stage.identity == "example arm 1.0 at 10.0.0.7"
        assert stage.position() == (0.0, 0.0, 50.0)
        assert stage.move((1.0, 2.0, 3.0), 5.0) == (1.0, 2.0, 3.0)
        with pytest.raises(OutOfRangeError):
            stage.move((1.0, 2.0, -3.0), 5.0)


def test_options_become_keyword_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    options = {"start_mm": [1.0, 2.0, 3.0]}
    with open_stage(settings("example_stage:ExampleStage", options=options, home=False)) as stage:
        assert stage.position() == (1.0, 2.0, 3.0)


def test_an_example_of_twenty_lines_stays_one() -> None:
    source = (HERE / "example_stage.py").read_text(encoding="utf-8")
    code = [line for line in source.split("class ExampleStage")[1].splitlines()[1:] if line.strip()]
    assert len(code) <= 20


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        ("example_stage:", "must be module:name"),
        (":Arm", "must be module:name"),
        ("../evil:Arm", "must be module:name"),
        ("no_such_module_here:Arm", "cannot be imported: ModuleNotFoundError"),
        ("example_stage:ExampleStag", 'did you mean "ExampleStage"'),
        ("tacbench_cad.lab.rig.stage:__doc__", "cannot be called"),
        ("pathlib:Path", "lacks identity"),
    ],
)
def test_wrong_names_are_explained(driver: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    with pytest.raises(InputError, match=message):
        open_stage(settings(driver))


def test_an_option_that_it_does_not_take_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    with pytest.raises(InputError, match="cannot be opened: TypeError"):
        open_stage(settings("example_stage:ExampleStage", options={"speed": 3}))


def test_a_module_that_fails_when_imported_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "fails_when_imported.py").write_text("raise RuntimeError('no licence\\nfor this arm')\n")
    with pytest.raises(InputError, match="RuntimeError: no licence") as caught:
        plugin.load("fails_when_imported:Arm", tmp_path)
    assert "\n" not in str(caught.value)


def test_rig_errors_of_its_own_come_through(tmp_path: Path) -> None:
    (tmp_path / "silent_arm.py").write_text(
        "from tacbench_cad.lab.rig.errors import NoAnswerError\n"
        "def arm():\n    raise NoAnswerError('arm: does not answer')\n"
    )
    with pytest.raises(NoAnswerError, match="arm: does not answer"):
        plugin.made("silent_arm:arm", {}, (), tmp_path)


@pytest.mark.parametrize("driver", ["gbrl", "virtual-gbrl", "octoprint"])
def test_unknown_drivers_are_refused_with_a_hint(driver: str) -> None:
    with pytest.raises(InputError, match=r"grbl.*module:name"):
        open_stage(settings(driver, port="/dev/null"))


def test_unknown_options_are_refused_with_a_hint() -> None:
    with pytest.raises(InputError, match='did you mean "home_timeout_s"'):
        open_stage(settings("grbl", port="/dev/null", options={"home_timeot_s": 3}))


def test_a_virtual_stage_needs_its_port() -> None:
    with pytest.raises(InputError, match="port of its running firmware"):
        open_stage(settings("virtual-grbl"))
