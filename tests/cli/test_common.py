"""Output that several commands share."""

from __future__ import annotations

import pytest

from tacbench_cad.cli.common import print_simulated

Capture = pytest.CaptureFixture[str]

#: The simulated devices that the runs of one study list.
RUNS = tuple(
    f"{device}: {device} of the virtual rig, block of a virtual printer, copy {copy} of texture {texture}"
    for texture in range(1, 7)
    for copy in (1, 2)
    for device in ("stage", "gauge", "sensor")
)


def test_simulated_devices_are_listed_in_one_short_line(capsys: Capture) -> None:
    print_simulated(RUNS)
    assert capsys.readouterr().out == "simulated: stage, gauge, sensor (see run.json)\n"


def test_nothing_is_printed_for_real_data(capsys: Capture) -> None:
    print_simulated(())
    assert capsys.readouterr().out == ""
