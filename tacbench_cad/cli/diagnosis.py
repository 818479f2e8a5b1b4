"""Diagnosis of the installation: which packages are installed, whether they work, and the commands that repair them.

Two packages contain the CAD kernel: ``cadquery-ocp``, which CadQuery needs, and ``cadquery-ocp-novtk``, which build123d
installs. Both write to the folder ``OCP``, so the package that was installed last overwrites files of the other. The
diagnosis therefore compares the files in that folder with the hashes that each package recorded.
"""

from __future__ import annotations

import base64
import ctypes
import hashlib
import importlib
import importlib.metadata
import platform
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from tacbench_cad.util.errors import MissingToolError, TacbenchError
from tacbench_cad.util.packages import PACKAGES, has_module, install_command, version
from tacbench_cad.util.processes import Workers, cpu_count, why_not_importable

#: The package whose files must be in the folder OCP, and the package that overwrites them.
KERNEL, RIVAL = "cadquery-ocp", "cadquery-ocp-novtk"
#: The system libraries that the kernel loads on Linux, and the Debian packages that contain them.
LIBRARIES = {"libGL.so.1": "libgl1", "libX11.so.6": "libx11-6"}


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The result of one check of the installation.

    Args:
        name: The name of the check, two or three words.
        ok: Whether the check passed.
        detail: The versions, files or errors that the check met.
        repair: The command that repairs the installation; None if the check passed.
    """

    name: str
    ok: bool
    detail: str
    repair: str | None = None


def diagnose() -> list[Diagnosis]:
    """Run all checks. Packages are imported in child processes, so that a broken package cannot end this process."""
    importlib.invalidate_caches()
    findings = [*base_findings(), *kernel_findings(), *library_findings()]
    return [*findings, *import_findings([finding.repair for finding in findings if finding.repair])]


def base_findings() -> list[Diagnosis]:
    """Check that the packages of the base installation are installed. There is no lib3mf for Linux on ARM."""
    arm_linux = sys.platform == "linux" and platform.machine() in ("aarch64", "armv7l")
    return [
        Diagnosis(
            name=package.distribution,
            ok=False,
            detail="is not installed, but the base installation needs it",
            repair=f"pip install {package.distribution}",
        )
        for package in PACKAGES
        if package.extra is None and package.version is None and not (package.module == "lib3mf" and arm_linux)
    ]


def kernel_findings() -> list[Diagnosis]:
    """Check that the folder OCP contains the files of the right package."""
    own, rival = version(KERNEL), version(RIVAL)
    if own is None and not has_module("cadquery"):
        return []
    if own is None:
        wheel = f"{KERNEL}=={rival}" if rival else f"{KERNEL}>=7.9,<8"
        detail = f"cadquery is installed without {KERNEL}" + (f"; {RIVAL} cannot replace it" if rival else "")
        return [_to_reinstall(detail, f'"{wheel}"')]
    foreign, wheel = foreign_files(KERNEL), f"{KERNEL}=={own}"
    both = f"{KERNEL} {own} and {RIVAL} {rival} share the folder OCP" if rival else f"{KERNEL} {own}"
    if not foreign:
        detail = f"{both}; every file belongs to {KERNEL}" if rival else both
        return [Diagnosis(name="kernel packages", ok=True, detail=detail)]
    detail = f"{both}; {len(foreign)} of the files of {KERNEL} are missing or overwritten, for example {foreign[0]}"
    return [_to_reinstall(detail, wheel)]


def _to_reinstall(detail: str, wheel: str) -> Diagnosis:
    repair = f"pip install --force-reinstall --no-deps {wheel}"
    return Diagnosis(name="kernel packages", ok=False, detail=detail, repair=repair)


def foreign_files(distribution: str) -> list[str]:
    """List the files of an installed package that are missing, or whose hash is not the recorded one."""
    foreign = []
    for file in importlib.metadata.files(distribution) or ():
        if file.hash is None or file.hash.mode != "sha256":
            continue
        path = file.locate()
        try:
            with open(path, "rb") as stream:  # noqa: PTH123 (a PackagePath's location is not always a Path)
                digest = hashlib.file_digest(stream, "sha256").digest()
        except OSError:
            foreign.append(str(file))
            continue
        if base64.urlsafe_b64encode(digest).decode().rstrip("=") != file.hash.value:
            foreign.append(str(file))
    return foreign


def library_findings() -> list[Diagnosis]:
    """Check that the system libraries of the kernel can be loaded; only on Linux with the kernel installed."""
    if sys.platform != "linux" or not has_module("OCP"):
        return []
    missing = [name for name in LIBRARIES if not loads(name)]
    detail = f"{', '.join(missing)} missing" if missing else ", ".join(LIBRARIES)
    repair = f"apt-get install -y {' '.join(LIBRARIES.values())}" if missing else None
    return [Diagnosis(name="system libraries", ok=not missing, detail=detail, repair=repair)]


def loads(library: str) -> bool:
    """Return whether a system library can be loaded."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def import_findings(repairs: Sequence[str]) -> list[Diagnosis]:
    """Check in child processes that each installed package can be imported.

    Args:
        repairs: The repairs of the other checks. They probably help where an import of a CAD package fails.
    """
    installed = [package for package in PACKAGES if package.version is not None]
    with Workers(cpu_count()) as workers:
        jobs = [workers.submit(why_not_importable, (package.module,)) for package in installed]
        findings = []
        for package, job in zip(installed, jobs, strict=True):
            try:
                reason = job.result()
            except TacbenchError as error:
                reason = str(error)
            if reason is not None:
                repair = f"pip install --force-reinstall {package.distribution}=={package.version}"
                if package.extra is not None:
                    repair = repairs[0] if package.extra == "cad" and repairs else install_command(package.extra)
                findings.append(Diagnosis(name=f"import {package.module}", ok=False, detail=reason, repair=repair))
        if not findings:
            detail = f"all {len(installed)} installed packages can be imported"
            findings.append(Diagnosis(name="imports", ok=True, detail=detail))
    return findings


def left_out_extras() -> dict[str, str]:
    """Return the extras with a missing package, each with the command that installs it."""
    extras = [package.extra for package in PACKAGES if package.extra is not None and package.version is None]
    return {extra: install_command(extra) for extra in dict.fromkeys(extras)}


def repair(findings: Sequence[Diagnosis]) -> list[str]:
    """Run the repairs that pip can do, and return their commands. The user has to install system libraries.

    Raises:
        MissingToolError: pip is not installed, or failed.
    """
    commands = [finding.repair for finding in findings if (finding.repair or "").startswith("pip install ")]
    for command in filter(None, commands):
        pip = [sys.executable, "-P", "-m", "pip", "install", "--disable-pip-version-check", *shlex.split(command)[2:]]
        if subprocess.run(pip, stdout=sys.stderr.fileno(), check=False).returncode != 0:
            raise MissingToolError(f"the repair failed; try to run it yourself: {command}")
    return [command for command in commands if command]
