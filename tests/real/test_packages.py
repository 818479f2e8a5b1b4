"""Wheel and source archive: their contents, and their use in environments with nothing else installed.

Each environment is made with ``venv``. ``pip`` installs the wheel and one extra. The tests use the environment from an
empty folder and then remove it, because the largest has 2.7 GB.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from email import message_from_string
from pathlib import Path

import pytest
from helpers.checkout import ROOT, Once, versioned_files
from helpers.gcode_writer import write_gcode
from helpers.small_study import STUDY
from helpers.studies import write_study

from tacbench_cad import __version__
from tacbench_cad.spec.block import Block
from tacbench_cad.util.packages import PACKAGES

pytestmark = pytest.mark.real

#: The time limits for pip, which may have to download a gigabyte, and for a command, in s.
MAX_PIP_S, MAX_SECONDS = 1800.0, 300.0
#: Files that development leaves in the project's folder. No package may contain them.
LEFTOVERS = (
    ".venv/lib/left.py",
    "build/lib/left.txt",
    "dist/left.whl",
    "docs/_build/html/left.html",
    "docs/api/generated/left.rst",
    "stl_out/left.stl",
    "stl_out/manifest.json",
    "tacbench_cad/__pycache__/left.pyc",
    "tests/__pycache__/left.pyc",
    "examples/__pycache__/left.pyc",
    ".hypothesis/left",
    "runs/left/run.json",
)
#: A program that imports every module and prints the modules that cannot be imported, each with the missing package.
IMPORTS = """
import importlib, json, pkgutil, housing, tacbench_cad
missing = {}
for package in (tacbench_cad, housing):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                missing[module.name] = error.name
print(json.dumps([tacbench_cad.__file__, missing]))
"""


def call(argv: Sequence[str | Path], folder: Path, max_seconds: float) -> subprocess.CompletedProcess[str]:
    """Run a program as from a shell without the variables of this environment."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL", "PYTEST"))
    }
    return subprocess.run(
        [*map(str, argv)],
        cwd=folder,
        env=environment | {"COLUMNS": "200", "PIP_DISABLE_PIP_VERSION_CHECK": "1"},
        capture_output=True,
        encoding="utf-8",
        timeout=max_seconds,
        check=False,
    )


@dataclass(frozen=True)
class Environment:
    """A virtual environment, and the empty folder in which its programs run."""

    root: Path
    folder: Path

    @classmethod
    def new(cls, place: Path) -> Environment:
        """Make an environment that contains only pip."""
        environment = cls(place / "environment", place / "empty")
        environment.folder.mkdir(parents=True)
        subprocess.run([sys.executable, "-m", "venv", environment.root], check=True, timeout=MAX_SECONDS)
        return environment

    def program(self, name: str) -> Path:
        """Return the path of a program of the environment."""
        return self.root / ("Scripts" if sys.platform == "win32" else "bin") / name

    def pip(self, *words: str | Path) -> subprocess.CompletedProcess[str]:
        """Install packages in the versions with which the project is tested."""
        arguments = ["-m", "pip", "install", "--quiet", "--no-compile", "-c", ROOT / "constraints.txt", *words]
        return call([self.program("python"), *arguments], self.folder, MAX_PIP_S)

    def python(self, *words: str | Path) -> str:
        """Run Python, which must succeed, and return its output."""
        process = call([self.program("python"), *words], self.folder, MAX_SECONDS)
        assert process.returncode == 0, process.stderr
        return process.stdout

    def tacbench(self, line: str) -> str:
        """Run a command, which must succeed, and return its output."""
        process = call([self.program("tacbench"), *line.split()], self.folder, MAX_SECONDS)
        assert process.returncode == 0, f"tacbench {line}: {process.stdout}{process.stderr}"
        return process.stdout + process.stderr

    def refusal(self, line: str) -> str:
        """Run a command, which must end with exit code 2, and return its error message of one line."""
        process = call([self.program("tacbench"), *line.split()], self.folder, MAX_SECONDS)
        errors = [text for text in process.stderr.splitlines() if text.startswith("error: ")]
        assert process.returncode == 2, f"tacbench {line}: {process.returncode}, {process.stdout}{process.stderr}"
        assert len(errors) == 1 and "Traceback" not in process.stderr, f"tacbench {line}: {process.stderr}"
        return errors[0]

    def missing_modules(self) -> dict[str, str]:
        """Return the modules of the project that cannot be imported, each with the first missing package."""
        file, missing = json.loads(self.python("-c", IMPORTS))
        assert Path(file).is_relative_to(self.root.resolve()), "the imported package is not from the wheel"
        return dict(missing)


@dataclass(frozen=True)
class Packages:
    """The packages, and the tree from which they were built."""

    tree: Path
    sdist: Path
    wheel: Path

    def in_sdist(self) -> dict[str, bytes]:
        """Return the files of the source archive by their paths below its top folder."""
        with tarfile.open(self.sdist) as archive:
            files = [member for member in archive if member.isfile()]
            assert {member.name.partition("/")[0] for member in files} == {f"tacbench_cad-{__version__}"}
            return {member.name.partition("/")[2]: archive.extractfile(member).read() for member in files}  # type: ignore[union-attr]

    def in_wheel(self) -> dict[str, bytes]:
        """Return the files of the wheel."""
        with zipfile.ZipFile(self.wheel) as archive:
            return {name: archive.read(name) for name in archive.namelist()}

    @property
    def metadata(self) -> str:
        """The metadata of the wheel."""
        return self.in_wheel()[f"tacbench_cad-{__version__}.dist-info/METADATA"].decode()


@pytest.fixture(scope="session")
def builder(once: Once) -> Environment:
    """Return an environment with the programs ``build`` and ``twine``."""

    def fill(folder: Path) -> None:
        done = Environment.new(folder).pip("build", "twine")
        (folder / "errors.txt").write_text(done.stderr if done.returncode else "")

    place = once("builder", fill)
    errors = (place / "errors.txt").read_text()
    if errors:
        pytest.skip(
            f"no package index answers, so nothing can be built or installed: {errors.strip().splitlines()[-1]}"
        )
    return Environment(place / "environment", place / "empty")


@pytest.fixture(scope="session")
def packages(builder: Environment, source: Path, once: Once) -> Packages:
    """Build a source archive from a tree with left-over files, and a wheel from the archive."""

    def fill(folder: Path) -> None:
        tree = shutil.copytree(source, folder / "tree")
        for name in LEFTOVERS:
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            (tree / name).write_text("left over")
        builder.python("-m", "build", "--outdir", folder / "packages", tree)

    place = once("packages", fill)
    (sdist,), (wheel,) = (place / "packages").glob("*.tar.gz"), (place / "packages").glob("*.whl")
    return Packages(place / "tree", sdist, wheel)


def of_project(names: Iterable[str]) -> set[str]:
    """Return the names of the files that belong to the two packages of the project."""
    return {name for name in names if name.startswith(("tacbench_cad/", "housing/"))}


def test_the_source_archive_contains_the_versioned_files(packages: Packages) -> None:
    names = {name for name in packages.in_sdist() if not name.startswith("tacbench_cad.egg-info/")}
    assert names - {"PKG-INFO", "setup.cfg"} == set(versioned_files())
    assert {"Makefile", "constraints.txt", ".ci/run", "docs/conf.py", "tests/conftest.py", "LICENSE"} <= names


def test_the_wheel_contains_only_the_packages(packages: Packages) -> None:
    files = packages.in_wheel()
    assert of_project(files) == of_project(versioned_files())
    assert {name.partition("/")[0] for name in files} == {
        "tacbench_cad",
        "housing",
        f"tacbench_cad-{__version__}.dist-info",
    }
    assert files[f"tacbench_cad-{__version__}.dist-info/licenses/LICENSE"] == (ROOT / "LICENSE").read_bytes()


def test_no_package_contains_paths_or_hosts_of_this_machine(packages: Packages) -> None:
    configured = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, timeout=MAX_SECONDS, check=True
    ).stdout
    hosts = set(re.findall(r"https?://(?:[^/@\s]*@)?([\w.-]+)", configured))
    needles = [str(needle).encode() for needle in (ROOT, packages.tree, Path(sys.prefix), *sorted(hosts))]
    for archive in (packages.in_sdist(), packages.in_wheel()):
        assert [(name, needle) for name, text in archive.items() for needle in needles if needle in text] == []


def test_metadata(packages: Packages, builder: Environment) -> None:
    checked = call(
        [builder.program("python"), "-m", "twine", "check", "--strict", packages.sdist, packages.wheel],
        builder.folder,
        MAX_SECONDS,
    )
    assert checked.returncode == 0, checked.stdout
    metadata = message_from_string(packages.metadata)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (metadata["Name"], metadata["Version"]) == ("tacbench-cad", __version__)
    assert (metadata["License-Expression"], metadata.get_all("License-File")) == ("MIT", ["LICENSE"])
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert set(metadata.get_all("Provides-Extra", [])) == set(project["optional-dependencies"])
    assert not [requirement for requirement in metadata.get_all("Requires-Dist", []) if "@" in requirement], (
        "a requirement is the address of a package"
    )
    assert (ROOT / "README.md").read_text(encoding="utf-8").strip() in packages.metadata
    assert packages.in_sdist()["PKG-INFO"].decode() == packages.metadata


@pytest.fixture
def environment(packages: Packages, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Environment]:
    """Install the wheel with the extras that a test names in a new environment."""
    extras: str = request.param
    created = Environment.new(tmp_path)
    process = created.pip(f"{packages.wheel}[{extras}]" if extras else packages.wheel)
    assert process.returncode == 0, process.stderr
    yield created
    shutil.rmtree(created.root)


def extra(name: str) -> pytest.MarkDecorator:
    """Return the mark that gives a test the environment of an extra."""
    return pytest.mark.parametrize("environment", [name], indirect=True, ids=[name or "base"])


def write_inputs(folder: Path) -> None:
    """Write two recorded studies, the G-code of texture 1, and a settings file for acquire."""
    write_study(folder / "runs", textures=(1, 2), copies=2)
    write_study(folder / "others", textures=(1, 2), copies=2)
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    write_gcode(folder / "texture-1.gcode", Block.of(1))


def extras_of(modules: set[str]) -> set[str | None]:
    """Return the extras that install these modules."""
    return {package.extra for package in PACKAGES if package.module in modules}


#: Commands that work in the base install, each with a part of its output.
IN_BASE = (
    ("--version", f"tacbench {__version__}"),
    ("textures", "texture-6"),
    ("cite", "Shepherd"),
    ("doctor", 'pip install "tacbench-cad[cad]"'),
    ("make --texture 1 --formats stl,3mf --parts blocks --out made", "texture-1_paper_x1.3mf"),
    (
        "make --texture 1 --out all",
        "left out: holder, jig: needs cadquery-ocp, not installed: run pip install",
    ),
    ("check-part made/texture-1_paper_x1.stl", "all checks passed"),
    ("check-part made/texture-1_paper_x1.3mf", "all checks passed"),
    ("plate --printer ender-3 --texture 1 --copies 2 --out plates", "T1 PAPER X1 01 02"),
    ("export-simulator --to mjcf,urdf,sdf,usd,obj,glb,npy,png16,taxim --texture 1 --out sim", "texture-1.xml"),
    (
        "check-gcode texture-1.gcode --texture 1",
        'no picture: pictures need matplotlib: pip install "tacbench-cad[plot]"',
    ),
)
#: Commands that need an extra, with the name of the extra.
NEEDS_EXTRA = (
    ("make --texture 1 --formats step --out {out}", "cad"),
    ("make --parts holder --out {out}", "cad"),
    ("make --texture 1 --verify full --out {out}", "cad"),
    ("show 1 -o {out}.png", "plot"),
    ("view -o {out}.html", "view"),
    ("acquire study.toml --out {out}", "lab"),
    ("rig probe", "lab"),
    ("simulate --study study.toml --out {out}", "lab"),
    ("export-runs runs --to tactile-data --out {out}", "lab"),
    ("variance runs", "analysis"),
    ("grade runs", "analysis"),
    ("split runs --out {out}", "analysis"),
    ("classify runs -o {out}", "analysis"),
    ("report runs -o {out}.html", "analysis"),
    ("compare runs others -o {out}", "analysis"),
)


@extra("")
def test_base(environment: Environment) -> None:
    write_inputs(environment.folder)
    for line, needle in IN_BASE:
        assert needle in environment.tacbench(line), line
    for line, needed in NEEDS_EXTRA:
        assert f'pip install "tacbench-cad[{needed}]"' in environment.refusal(line.format(out="refused")), line
    assert list(environment.folder.glob("refused*")) == [], "a refused command has written a file"
    missing = environment.missing_modules()
    assert extras_of(set(missing.values())) <= {"cad", "analysis", "web"}
    light = ("tacbench_cad.lab.", "tacbench_cad.cli.", "tacbench_cad.making.", "tacbench_cad.extensions.slicing.")
    analysis = "tacbench_cad.lab.analysis."
    assert [name for name in missing if name.startswith(light) and not name.startswith(analysis)] == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("environment", "line", "file"),
    [
        ("plot", "show 4 --press -o press.png", "press.png"),
        ("view", "view blocks -o view.html", "view.html"),
        ("lab", "simulate --study study.toml --out simulated --jobs 1", "simulated"),
        ("analysis", "report runs -o report.html", "report.html"),
        ("cad", "make --texture 1 --formats step --out made", "made/texture-1_paper_x1.step"),
    ],
    indirect=["environment"],
)
def test_a_single_extra(environment: Environment, line: str, file: str) -> None:
    write_inputs(environment.folder)
    environment.tacbench(line)
    assert (environment.folder / file).exists()


@pytest.mark.long
@extra("all")
def test_all(environment: Environment, source: Path) -> None:
    """Make and check the print set of one texture in every format, import every module, and run the examples."""
    write_inputs(environment.folder)
    assert "ok: kernel packages" in environment.tacbench("doctor --repair")
    assert "left out" not in environment.tacbench("make --texture 1 --verify full --out made")
    names = {path.name for path in (environment.folder / "made").iterdir()}
    stems = {name.partition(".")[0] for name in names} - {"manifest", "preview"}
    assert len(stems) == 3, "there must be a block, a holder and a jig"
    assert {f"{stem}.{form}" for stem in stems for form in ("stl", "3mf", "step")} <= names
    for form in ("stl", "3mf", "step"):
        assert "all checks passed" in environment.tacbench(f"check-part made/texture-1_paper_x1.{form}")
    assert environment.missing_modules() == {}
    environment.tacbench("simulate --study study.toml --out simulated")
    assert "2 presses: nothing wrong" in environment.tacbench("check-runs simulated")
    # No extra installs a simulator, and another extra installs PyTorch.
    unavailable = re.compile(r"^\s*(import (mujoco|torch)$|from ocp_vscode import)", re.MULTILINE)
    examples = [path for path in sorted((source / "examples").glob("*.py")) if not unavailable.search(path.read_text())]
    assert len(examples) >= 7
    for example in examples:
        environment.python(example)
    for number, (line, _) in enumerate(NEEDS_EXTRA):
        environment.tacbench(line.format(out=f"out-{number}"))
