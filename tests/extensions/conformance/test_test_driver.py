"""``tacbench test-driver``: one page and an exit code."""

from __future__ import annotations

import io
import json
import re
import sys
from pathlib import Path

import pytest
from helpers import wrong_drivers
from helpers.checkout import ROOT

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]
HERE = Path(wrong_drivers.__file__).parent


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    monkeypatch.delitem(sys.modules, "wrong_drivers", raising=False)


def test_a_virtual_stage_passes_on_one_page(capsys: Capture) -> None:
    words = ["test-driver", "virtual-grbl", "--set", "options.speed=50", "--beyond", "0,0,500"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "15 of 15 checks passed" in out
    assert "failed" not in out and len(out.splitlines()) < 40


def test_a_wrong_sensor_is_named_with_exit_code_1(capsys: Capture) -> None:
    assert main(["test-driver", "wrong_drivers:ChangingShape"]) == 1
    assert "failed: shape" in capsys.readouterr().out
    assert main(["test-driver", "wrong_drivers:ChangingShape", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["kind"] == "sensor" and not document["passed"]
    assert [check["name"] for check in document["checks"] if check["result"] == "failed"] == ["shape"]


def test_the_command_asks_before_a_stage_moves_and_for_the_mass(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    limits = "limits_mm=[[0,100],[0,100],[0,100]]"
    assert main(["test-driver", "wrong_drivers:GoodStage", "--set", limits]) == 2
    assert "Remove block and sensor" in capsys.readouterr().err
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n"))
    assert main(["test-driver", "wrong_drivers:GoodGauge", "--mass-g", "100"]) == 1
    out, err = capsys.readouterr()
    assert "Put 100 g on the gauge" in err and "the force did not change with the mass" in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["grlb"], "is not a driver; allowed: arduino, grbl"),
        (["wrong_drivers:STAGES"], "is required for wrong_drivers:STAGES: stage, gauge or sensor"),
        (["wrong_drivers:GoodSensor", "--set", "gain"], "must be KEY=VALUE"),
        (["wrong_drivers:GoodGauge", "--mass-g", "0"], "must be from 1 to 10000 g"),
        (["wrong_drivers:GoodStage"], "limits_mm"),
    ],
)
def test_wrong_words_are_explained_in_one_line(words: list[str], message: str, capsys: Capture) -> None:
    assert main(["test-driver", *words]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line


def test_an_exception_while_the_device_is_opened_is_a_failed_check(capsys: Capture) -> None:
    assert main(["test-driver", "wrong_drivers:GoodSensor", "--set", "gain=3"]) == 1
    assert "raised TypeError instead of a RigError" in capsys.readouterr().out


#: The checks that the example drivers of the manual fail on purpose: one is full of defects, one only stores positions.
FAILING = {
    "hasty_arm:HastyArm": {"unit", "blocking", "small move", "stop"},
    "dry_stage:DryStage": {"blocking", "stop"},
}


def manual_files() -> dict[str, str]:
    """Return the Python files that the pages of the manual write, by their names."""
    text = "".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").glob("*.md")))
    return dict(re.findall(r"```python write=(\w+\.py)\n(.*?)```", text, re.DOTALL))


DRIVERS = [
    f"{Path(name).stem}:{word}"
    for name, code in manual_files().items()
    for word in re.findall(r"^class (\w+)\(Closing\):", code, re.MULTILINE)
]


def test_the_manual_has_these_drivers() -> None:
    assert {*FAILING, "my_arm:MyStage", "my_skin:Skin"} <= set(DRIVERS)


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_drivers_of_the_manual_pass(
    driver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    for name, code in manual_files().items():
        (tmp_path / name).write_text(code, encoding="utf-8")
        monkeypatch.delitem(sys.modules, Path(name).stem, raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
    is_stage = "def move(" in (tmp_path / f"{driver.partition(':')[0]}.py").read_text()
    limits = ["--set", "limits_mm=[[0,300],[0,300],[0,100]]"] if is_stage else []
    code = main(["test-driver", driver, *limits, "--json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert {check["name"] for check in checks if check["result"] == "failed"} == FAILING.get(driver, set())
    assert code == int(driver in FAILING)
    assert sum(check["result"] == "passed" for check in checks) >= 7
