"""The command ``tacbench doctor`` must find broken packages and name the command that repairs them."""

from __future__ import annotations

import base64
import hashlib
import importlib.metadata
import json
from pathlib import Path

import pytest

from tacbench_cad.cli import diagnosis as doctor
from tacbench_cad.cli import main
from tacbench_cad.util import packages as tools

Capture = pytest.CaptureFixture[str]


def install(folder: Path, name: str, version: str, files: dict[str, str]) -> None:
    """Write the files of an installed package and the list of their hashes."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = []
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).decode().rstrip("=")
        lines.append(f"{path},sha256={digest},{len(text)}")
    (info / "RECORD").write_text("\n".join([*lines, f"{info.name}/RECORD,,"]) + "\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder that comes before the installed packages in the search path."""
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    return tmp_path


def test_the_wrong_package_installed_last_is_found_with_its_repair(site: Path) -> None:
    install(site, "cadquery-ocp", "7.9.3.1", {"OCP/kernel.so": "with VTK", "OCP/IVtk.py": "x"})
    install(site, "cadquery-ocp-novtk", "7.9.3.1", {"OCP/kernel.so": "without VTK"})
    (finding,) = doctor.kernel_findings()
    assert not finding.ok
    assert "1 of the files of cadquery-ocp" in finding.detail and "OCP/kernel.so" in finding.detail
    assert finding.repair == "pip install --force-reinstall --no-deps cadquery-ocp==7.9.3.1"


def test_cadquery_without_its_own_kernel_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "version", lambda name: {"cadquery-ocp-novtk": "7.9.3.1"}.get(name))
    monkeypatch.setattr(doctor, "has_module", lambda name: name == "cadquery")
    (finding,) = doctor.kernel_findings()
    assert not finding.ok
    assert finding.repair == 'pip install --force-reinstall --no-deps "cadquery-ocp==7.9.3.1"'


@pytest.mark.skipif(doctor.sys.platform != "linux", reason="only Linux has these libraries")
def test_missing_system_libraries_are_named_with_their_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "has_module", lambda name: True)
    monkeypatch.setattr(doctor, "LIBRARIES", {"libnone.so.1": "libnone1", "libc.so.6": "libc6", "libno.so.2": "libno2"})
    (finding,) = doctor.library_findings()
    assert not finding.ok
    assert finding.detail == "libnone.so.1, libno.so.2 missing"
    assert finding.repair is not None and finding.repair.startswith("apt-get install -y libnone1")


def test_a_package_that_does_not_load_is_found_in_a_child(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (site / "tacbench_broken.py").write_text("raise ImportError('libGL.so.1: cannot open\\nshared object file')")
    install(site, "tacbench-broken", "1.0", {})
    broken = tools.Package(distribution="tacbench-broken", module="tacbench_broken", extra="plot", use="a test")
    monkeypatch.setattr(doctor, "PACKAGES", (broken,))
    (finding,) = doctor.import_findings([])
    assert not finding.ok and finding.name == "import tacbench_broken"
    assert "libGL.so.1: cannot open shared object file" in finding.detail


def test_a_package_that_ends_the_process_is_found(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (site / "tacbench_crash.py").write_text("import os\nos._exit(7)")
    install(site, "tacbench-crash", "1.0", {})
    crash = tools.Package(distribution="tacbench-crash", module="tacbench_crash", extra=None, use="a test")
    monkeypatch.setattr(doctor, "PACKAGES", (crash,))
    (finding,) = doctor.import_findings([])
    assert not finding.ok and "ended with code 7" in finding.detail


def test_repair_runs_pip_only_for_findings_that_pip_can_repair(monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[list[str]] = []

    class Done:
        returncode = 0

    def run(command: list[str], **_: object) -> Done:
        commands.append(command)
        return Done()

    monkeypatch.setattr(doctor.subprocess, "run", run)
    findings = (
        doctor.Diagnosis(name="fine", ok=True, detail=""),
        doctor.Diagnosis(name="system", ok=False, detail="", repair="apt-get install -y libgl1"),
        doctor.Diagnosis(name="wheels", ok=False, detail="", repair='pip install --no-deps "cadquery-ocp>=7,<8"'),
    )
    assert doctor.repair(findings) == ['pip install --no-deps "cadquery-ocp>=7,<8"']
    assert [command[1:5] for command in commands] == [["-P", "-m", "pip", "install"]]
    assert commands[0][-2:] == ["--no-deps", "cadquery-ocp>=7,<8"]


def test_json_and_exit_code_when_something_is_broken(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    finding = doctor.Diagnosis(name="kernel packages", ok=False, detail="mixed", repair="pip install x")
    monkeypatch.setattr(doctor, "diagnose", lambda: [finding])
    assert main(["doctor", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False
    assert document["findings"] == [
        {"name": "kernel packages", "ok": False, "detail": "mixed", "repair": "pip install x"}
    ]
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "BROKEN: kernel packages: mixed" in out and "repair: pip install x" in out
