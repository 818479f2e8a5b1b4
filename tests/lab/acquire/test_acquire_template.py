"""Test the file of ``acquire --init``: it is refused until it is filled in. The manual shows every key and default."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from tacbench_cad.lab.acquire.study_file import StudyFile, read_study
from tacbench_cad.lab.study.editing import TEMPLATE_FILE, write_template
from tacbench_cad.lab.study.motion import MotionSettings, motion_of
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    HolderRim,
    PressChecks,
    PressLimits,
    PressPositions,
    PressSteps,
    PressTargets,
    Protocol,
    SensorSettings,
    StageSettings,
)
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError

#: The line before the keys of a second sensor, which replace those of the first.
TAXELS = "# For taxels instead:"
#: The line before the keys of a motion.
MOTION = "# [protocol.motion]\n"
#: The commented keys whose values are examples, because they have no defaults.
EXAMPLES = ("port", "device", "calibration", "key_mm", "baud")
#: The keys of ``[sensor]`` that belong to every driver.
GENERAL = ("driver", "device", "channels")
#: The keys that a user has to fill in, with values for the tests.
FILLED = {
    "texture": "1",
    "printer": '"bambu-p1p"',
    "filament": '"pla-minus"',
    "origin_mm": "[50, 50, -40]",
    "limits_mm": "[[0, 200], [0, 200], [-60, 0]]",
    "exposure": "100",
}
TEMPLATE = TEMPLATE_FILE.read_text(encoding="utf-8")
#: The file with every key, from the manual.
MANUAL = (Path(__file__).parents[3] / "docs" / "study-file.md").read_text(encoding="utf-8")
EVERY_KEY = MANUAL.partition("```toml\n")[2].partition("```")[0]


def filled_in(text: str) -> str:
    return re.sub(rf"(?m)^({'|'.join(FILLED)}) = .*$", lambda line: f"{line[1]} = {FILLED[line[1]]}", text)


READY, COMPLETE = filled_in(TEMPLATE), filled_in(EVERY_KEY)


def read(folder: Path, text: str) -> StudyFile:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def with_defaults(text: str) -> str:
    """Return the text with every commented default as a key; keys that are only examples stay comments."""
    before, motion, rest = text.partition(MOTION)
    text = before + rest[rest.index("\n[stage]") :] if motion else text
    return re.sub(rf"(?m)^# (?!(?:{'|'.join(EXAMPLES)}) =)([a-z_]+ = )", r"\1", text.partition(TAXELS)[0])


def without_study(text: str) -> str:
    before, _, rest = text.partition("# [study]\n")
    return before + rest[rest.index("[holder]") :]


def test_the_template_is_refused_until_it_is_filled_in(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    write_template(path)
    keys = "[block] texture, [block] printer, [block] filament, [stage] origin_mm, [stage] limits_mm, [sensor] exposure"
    with pytest.raises(InputError, match=re.escape(f"study.toml: {keys}: must be filled in")):
        read_study(path)
    for key in FILLED:
        empty = re.search(rf"(?m)^{key} = (.*)$", TEMPLATE)
        assert empty is not None
        with pytest.raises(InputError, match=rf"^[^,]*\] {key}: must be filled in"):
            read(tmp_path, READY.replace(f"{key} = {FILLED[key]}", f"{key} = {empty[1]}"))


def test_only_the_origin_may_be_empty_before_teaching(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(READY.replace(FILLED["origin_mm"], "[]", 1))
    assert read_study(path, teaching=True).required_rig.stage.limits_mm[0] == (0.0, 200.0)
    write_template(tmp_path / "new.toml")
    with pytest.raises(InputError, match=r"\[block\] texture.*limits_mm, \[sensor\] exposure: must be filled in"):
        read_study(tmp_path / "new.toml", teaching=True)


def test_the_filled_in_template_is_valid(tmp_path: Path) -> None:
    file = read(tmp_path, READY)
    assert file.study.protocol == Protocol()
    assert file.out == tmp_path / "runs"
    assert file.required_rig.holder == HolderRim()


@pytest.mark.parametrize(("fit", "gap_mm"), [('"slip"', 0.15), ('"loose"', 0.30), ('"press"', 0.05), ("0.22", 0.22)])
def test_the_gap_follows_the_fit_of_the_holder(tmp_path: Path, fit: str, gap_mm: float) -> None:
    text = COMPLETE.replace('# fit = "slip"', f"fit = {fit}")
    assert read(tmp_path, text).study.holder == HolderRim(gap_mm=gap_mm)
    assert read(tmp_path, text.replace("# gap_mm = 0.15", "gap_mm = 0.2")).study.holder == HolderRim(gap_mm=0.2)


def test_an_unknown_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"study.toml: \[holder\] fit = 'slop': did you mean \"slip\""):
        read(tmp_path, COMPLETE.replace('# fit = "slip"', 'fit = "slop"'))


def test_the_commented_values_are_the_defaults(tmp_path: Path) -> None:
    plain = read(tmp_path, READY)
    explicit = read(tmp_path, with_defaults(without_study(COMPLETE)))
    assert explicit.study == plain.study
    stage, shown = plain.required_rig.stage, explicit.required_rig.stage
    for field in fields(StageSettings):
        if field.name != "options":
            assert getattr(stage, field.name) == getattr(shown, field.name), field.name
    assert explicit.required_rig.gauge.timeout_s == plain.required_rig.gauge.timeout_s


def test_the_example_study_is_valid(tmp_path: Path) -> None:
    text = re.sub(r"(?s)\[block\].*?# \[study\]\n", "[study]\n", COMPLETE)
    head, _, rest = text.partition("[study]\n")
    own, _, rest = rest.partition("[holder]")
    own = re.sub(r"(?m)^# (?=[a-z_]+ = |    \{|\])", "", own)
    file = read(tmp_path, f"{head}[study]\n{own}[holder]{rest}")
    assert len(file.study.blocks) == 6 * (6 + 2)
    assert file.study.blocks[-1].printed.block.key_mm == 3.0


@pytest.mark.parametrize(
    "kind",
    [
        PressChecks,
        PressLimits,
        PressPositions,
        PressSteps,
        PressTargets,
        StageSettings,
        GaugeSettings,
        SensorSettings,
        HolderRim,
    ],
)
def test_every_key_is_explained(kind: type) -> None:
    for field in fields(kind):  # type: ignore[arg-type]
        if (kind, field.name) != (SensorSettings, "options"):
            assert re.search(rf"(?m)^(?:# )?{field.name} = ", EVERY_KEY), field.name


def test_the_sensor_drivers_accept_the_shown_keys() -> None:
    from tacbench_cad.lab.rig.camera import CameraOptions
    from tacbench_cad.lab.rig.taxels import TaxelOptions

    sections = COMPLETE.partition("[sensor]")[2].split(TAXELS)
    for text, options in zip(sections, (CameraOptions, TaxelOptions), strict=True):
        values = tomllib.loads(re.sub(r"(?m)^# (?=[a-z_]+ = )", "", f"# {text}"))
        from_plain(options, {key: value for key, value in values.items() if key not in GENERAL})


def test_the_template_is_short_and_agrees_with_the_manual() -> None:
    assert len(TEMPLATE.splitlines()) <= 90
    keys = re.findall(r"(?m)^(?:# )?[a-z_]+ = .*$", TEMPLATE)
    assert len(keys) > 20 and set(keys) <= set(EVERY_KEY.splitlines())


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("mine")
    with pytest.raises(InputError, match="already exists"):
        write_template(path)
    assert path.read_text() == "mine"
    with pytest.raises(InputError, match="already exists"):
        write_template(tmp_path)


def test_the_commented_motion_has_the_defaults(tmp_path: Path) -> None:
    before, _, rest = COMPLETE.partition(MOTION)
    keys, stage, after = rest.partition("\n[stage]")
    motion = re.sub(r"(?m)^# ([a-z_]+ = )", r"\1", MOTION[2:] + keys)
    protocol = read(tmp_path, before + motion + stage + after).study.protocol
    assert protocol.motion is not None
    assert (protocol.motion.name, protocol.motion.frames) == ("slide", MotionSettings(name="slide").frames)
    assert motion_of(protocol.motion) == motion_of(MotionSettings(name="slide"))
