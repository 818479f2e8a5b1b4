"""A study on a stage with emulated firmware, whose load cell is emulated too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tacbench_cad.lab.acquire.study_file import StudyFile, virtual_study
from tacbench_cad.lab.study.spec import GaugeSettings


def emulated_study(driver: str, **options: Any) -> StudyFile:
    """Return a virtual study whose gauge is the load cell beside the emulated stage."""
    file = virtual_study(driver=driver, **options)
    return replace(file, rig=replace(file.required_rig, gauge=GaugeSettings(driver="virtual-serial")))
