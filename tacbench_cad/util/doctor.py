"""What is installed here, whether it works, and the one command that repairs what does not.

The kernel's two wheels, ``cadquery-ocp`` (which CadQuery needs) and ``cadquery-ocp-novtk`` (which build123d brings),
write the same folder ``OCP``. Whichever was installed last wins, file by file, so the folder is compared with the list
of files and hashes that each wheel left behind.
"""

from __future__ import annotations

import base64
import ctypes
import hashlib
import importlib
import importlib.metadata
import platform
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import MissingToolError, TacbenchError
from tacbench_cad.util.packages import PACKAGES, has_module, install_command, version
from tacbench_cad.util.processes import Workers, cpu_count, why_not_importable

#: The wheel whose files must be the ones in place, and the one that overwrites them.
KERNEL, RIVAL = "cadquery-ocp", "cadquery-ocp-novtk"
#: What the kernel loads from the system on Linux, and the Debian packages that bring it.
LIBRARIES = {"libGL.so.1": "libgl1", "libX11.so.6": "libx11-6"}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked at.

    Args:
        name: Two or three words.
        ok: Whether it is as it should be.
        detail: What was found.
        repair: The command that mends it; None where all is well.
        pip: Arguments of ``pip install`` that mend it, where that is what it takes.
    """

    name: str
    ok: bool
    detail: str
    repair: str | None = None
    pip: tuple[str, ...] = field(default=(), metadata={"key": None})


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Everything that was found.

    Args:
        packages: A row for each package: its name, version and extra.
        findings: What was tried, and whether it works.
    """

    packages: tuple[dict[str, Any], ...]
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is broken. A package of an extra that is not installed is not broken."""
        return all(finding.ok for finding in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "version": __version__,
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
            "ok": self.ok,
            "packages": list(self.packages),
            "findings": to_plain(self.findings),
        }


def diagnose() -> Diagnosis:
    """Look at everything. Packages are imported in child processes, so a broken one does no harm here."""
    importlib.invalidate_caches()
    packages = tuple(
        {"name": one.distribution, "version": one.version, "extra": one.extra, "use": one.use} for one in PACKAGES
    )
    findings = [*base_findings(), *kernel_findings(), *library_findings()]
    return Diagnosis(packages=packages, findings=(*findings, *import_findings(findings)))


def base_findings() -> list[Finding]:
    """Whether the base install is whole."""
    arm_linux = sys.platform == "linux" and platform.machine() in ("aarch64", "armv7l")
    found = []
    for package in PACKAGES:
        if package.extra is None and package.version is None:
            without_wheel = package.distribution == "lib3mf" and arm_linux
            found.append(
                Finding(name=package.distribution, ok=True, detail="has no wheel for ARM Linux: no 3MF files here")
                if without_wheel
                else Finding(
                    name=package.distribution,
                    ok=False,
                    detail="is not installed, and the base install needs it",
                    repair=f"pip install {package.distribution}",
                    pip=(package.distribution,),
                )
            )
    return found


def kernel_findings() -> list[Finding]:
    """Whether the files of the right kernel wheel are the ones in place."""
    own, rival = version(KERNEL), version(RIVAL)
    if own is None and not has_module("cadquery"):
        return []
    if own is None:
        wheel = f"{KERNEL}=={rival}" if rival else f"{KERNEL}>=7.9,<8"
        detail = f"cadquery is installed without {KERNEL}" + (f"; {RIVAL} is no substitute" if rival else "")
        return [_to_reinstall(wheel, detail, f'"{wheel}"')]
    foreign, wheel = foreign_files(KERNEL), f"{KERNEL}=={own}"
    both = f"{KERNEL} {own} and {RIVAL} {rival} share the folder OCP" if rival else f"{KERNEL} {own}"
    if not foreign:
        return [Finding(name="kernel wheels", ok=True, detail=f"{both}; every file is {KERNEL}'s" if rival else both)]
    detail = f"{both}; {len(foreign)} of {KERNEL}'s files are missing or not its own, as {foreign[0]}"
    return [_to_reinstall(wheel, detail, wheel)]


def _to_reinstall(wheel: str, detail: str, quoted: str) -> Finding:
    options = ("--force-reinstall", "--no-deps")
    repair = " ".join(("pip install", *options, quoted))
    return Finding(name="kernel wheels", ok=False, detail=detail, repair=repair, pip=(*options, wheel))


def foreign_files(distribution: str) -> list[str]:
    """Files of an installed distribution that are missing, or differ from the hash that its wheel recorded."""
    found = []
    for file in importlib.metadata.files(distribution) or ():
        if file.hash is None or file.hash.mode != "sha256":
            continue
        path = file.locate()
        try:
            with open(path, "rb") as stream:  # noqa: PTH123 (a PackagePath's location is not always a Path)
                digest = hashlib.file_digest(stream, "sha256").digest()
        except OSError:
            found.append(str(file))
            continue
        if base64.urlsafe_b64encode(digest).decode().rstrip("=") != file.hash.value:
            found.append(str(file))
    return found


def library_findings() -> list[Finding]:
    """Whether the system libraries of the kernel load; asked on Linux only, and only where the kernel is installed."""
    if sys.platform != "linux" or not has_module("OCP"):
        return []
    missing = [name for name in LIBRARIES if not _loads(name)]
    detail = f"{', '.join(missing)} missing" if missing else ", ".join(LIBRARIES)
    repair = f"apt-get install -y {' '.join(LIBRARIES.values())}" if missing else None
    return [Finding(name="system libraries", ok=not missing, detail=detail, repair=repair)]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def import_findings(before: Sequence[Finding]) -> list[Finding]:
    """Whether each installed package can be imported, tried in child processes.

    Args:
        before: What was found so far: its repairs are the likely ones for an import that fails.
    """
    repairs = [finding.repair for finding in before if finding.repair]
    installed = [package for package in PACKAGES if package.version is not None]
    with Workers(cpu_count()) as workers:
        jobs = [workers.submit(why_not_importable, (package.module,)) for package in installed]
        found = []
        for package, job in zip(installed, jobs, strict=True):
            try:
                reason = job.result()
            except TacbenchError as error:
                reason = str(error)
            if reason is not None:
                repair = f"pip install --force-reinstall {package.distribution}=={package.version}"
                if package.extra is not None:
                    repair = repairs[0] if package.extra == "cad" and repairs else install_command(package.extra)
                found.append(Finding(name=f"import {package.module}", ok=False, detail=reason, repair=repair))
        if not found:
            detail = f"all {len(installed)} installed packages load"
            found.append(Finding(name="imports", ok=True, detail=detail))
    return found


def left_out_extras() -> dict[str, str]:
    """Extras of which something is not installed, and the command that installs each."""
    extras = [package.extra for package in PACKAGES if package.extra is not None and package.version is None]
    return {extra: install_command(extra) for extra in dict.fromkeys(extras)}


def repair(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Run the pip repairs of a diagnosis. System libraries are left to the user.

    Returns:
        The arguments of each ``pip install`` that ran.

    Raises:
        MissingToolError: pip is not there, or did not succeed.
    """
    done = []
    for finding in diagnosis.findings:
        if finding.ok or not finding.pip:
            continue
        command = [sys.executable, "-P", "-m", "pip", "install", "--disable-pip-version-check", *finding.pip]
        if subprocess.run(command, stdout=sys.stderr.fileno(), check=False).returncode != 0:
            raise MissingToolError(f"the repair failed; run it by hand: {finding.repair}")
        done.append(finding.pip)
    return done
