"""The Marlin driver with the virtual printer of OctoPrint, an independent implementation of Marlin.

The test needs OctoPrint in a separate environment, ``.venv-octoprint``, which ``.ci/run`` creates.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.rig.errors import OutOfRangeError, RigError
from tacbench_cad.lab.study.spec import StageSettings

ROOT = Path(__file__).parent.parent.parent
PYTHON = ROOT / ".venv-octoprint" / "bin" / "python"

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are needed; Windows has none"),
    pytest.mark.skipif(
        not PYTHON.exists(),
        reason="OctoPrint is not there: python3 -m venv .venv-octoprint, "
        "then .venv-octoprint/bin/pip install OctoPrint==1.11.8",
    ),
]
LIMITS = ((0.0, 200.0), (0.0, 200.0), (0.0, 100.0))


@contextmanager
def _printer(*options: str) -> Iterator[str]:
    """Return the path of a terminal that is connected to the printer of OctoPrint."""
    script = ROOT / "tests" / "helpers" / "octoprint_printer.py"
    with subprocess.Popen(
        [PYTHON, script, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        path = process.stdout.readline().strip()
        assert path, "OctoPrint's printer did not start"
        try:
            yield path
        finally:
            process.stdin.close()
            process.wait(timeout=30)


def test_the_marlin_driver_moves_octoprints_printer() -> None:
    with _printer("--marlin2") as port:
        settings = StageSettings(driver="marlin", port=port, limits_mm=LIMITS, timeout_s=5.0)
        with open_stage(settings, Clock()) as stage:
            assert "Marlin 2.1.2" in stage.identity
            for target in ((10.0, 20.0, 30.0), (12.5, 20.0, 30.0), (12.5, 23.25, 7.125)):
                assert stage.move(target, 100.0) == pytest.approx(target, abs=0.011)
                assert stage.position() == pytest.approx(target, abs=0.011)
            with pytest.raises(OutOfRangeError):
                stage.move((-1.0, 0.0, 10.0), 100.0)
            assert stage.position() == pytest.approx((12.5, 23.25, 7.125), abs=0.011)
            # The driver resets the line numbers, which OctoPrint accepts as Marlin does.
            stage.home()
            assert stage.position() == (0.0, 0.0, 0.0)


def test_marlin_1_is_refused() -> None:
    # The printer of OctoPrint has the name "Virtual Marlin 1.0" by default.
    with _printer() as port, pytest.raises(RigError, match="'Virtual Marlin' is not Marlin 2"):
        open_stage(StageSettings(driver="marlin", port=port, limits_mm=LIMITS, timeout_s=5.0), Clock())
