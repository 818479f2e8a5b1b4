"""Wheel and source archive: what is in them, and that they work where nothing else is installed.

Each environment is made by ``venv``, filled by ``pip`` from the wheel and one extra, used from an empty folder, and
removed: the largest takes 2.7 GB.
"""

from __future__ import annotations

import ast
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

#: For pip, which may have to bring a gigabyte, and for a command, in s.
PIP_PATIENCE_S, PATIENCE_S = 1800.0, 300.0
#: Lies about in the folder of somebody who works on the project; none of it may get into a package.
LITTER = (
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
#: Imports every module, and says which of them could not be had for want of what.
IMPORTS = """
import importlib, json, pkgutil, housing, tacbench_cad
missing = {}
for package in (tacbench_cad, housing):
    for one in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not one.name.endswith("__main__"):
            try:
                importlib.import_module(one.name)
            except ModuleNotFoundError as error:
                missing[one.name] = error.name
print(json.dumps([tacbench_cad.__file__, missing]))
"""


def call(argv: Sequence[str | Path], folder: Path, patience_s: float) -> subprocess.CompletedProcess[str]:
    """Run a program as from a shell that knows nothing of this environment."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL", "PYTEST"))}
    return subprocess.run(
        [*map(str, argv)],
        cwd=folder,
        env=kept | {"COLUMNS": "200", "PIP_DISABLE_PIP_VERSION_CHECK": "1"},
        capture_output=True,
        text=True,
        timeout=patience_s,
        check=False,
    )


@dataclass(frozen=True)
class Environment:
    """A virtual environment, and an empty folder to use it from."""

    root: Path
    here: Path

    @classmethod
    def new(cls, place: Path) -> Environment:
        """An environment with nothing but pip."""
        one = cls(place / "environment", place / "here")
        one.here.mkdir(parents=True)
        subprocess.run([sys.executable, "-m", "venv", one.root], check=True, timeout=PATIENCE_S)
        return one

    def program(self, name: str) -> Path:
        """A program of the environment."""
        return self.root / ("Scripts" if sys.platform == "win32" else "bin") / name

    def pip(self, *words: str | Path) -> subprocess.CompletedProcess[str]:
        """Install, with the versions that the project is tested with."""
        asked = ["-m", "pip", "install", "--quiet", "--no-compile", "-c", ROOT / "constraints.txt", *words]
        return call([self.program("python"), *asked], self.here, PIP_PATIENCE_S)

    def python(self, *words: str | Path) -> str:
        """What Python prints; it must succeed."""
        done = call([self.program("python"), *words], self.here, PATIENCE_S)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def tacbench(self, line: str) -> str:
        """What a command prints; it must succeed."""
        done = call([self.program("tacbench"), *line.split()], self.here, PATIENCE_S)
        assert done.returncode == 0, f"tacbench {line}: {done.stdout}{done.stderr}"
        return done.stdout + done.stderr

    def refuses(self, line: str) -> str:
        """The one line with which a command refuses."""
        done = call([self.program("tacbench"), *line.split()], self.here, PATIENCE_S)
        errors = [one for one in done.stderr.splitlines() if one.startswith("error: ")]
        assert done.returncode == 2, f"tacbench {line}: {done.returncode}, {done.stdout}{done.stderr}"
        assert len(errors) == 1 and "Traceback" not in done.stderr, f"tacbench {line}: {done.stderr}"
        return errors[0]

    def lacks(self) -> dict[str, str]:
        """The modules of ours that cannot be imported, and of which package the first is missing."""
        file, missing = json.loads(self.python("-c", IMPORTS))
        assert Path(file).is_relative_to(self.root.resolve()), "something else than the wheel was imported"
        return dict(missing)


@dataclass(frozen=True)
class Packages:
    """What was built, and the tree that it was built from."""

    tree: Path
    sdist: Path
    wheel: Path
    wheel_of_the_tree: Path

    def in_sdist(self) -> dict[str, bytes]:
        """The files of the source archive, by their names below its one folder."""
        with tarfile.open(self.sdist) as archive:
            files = [one for one in archive if one.isfile()]
            assert {one.name.partition("/")[0] for one in files} == {f"tacbench_cad-{__version__}"}
            return {one.name.partition("/")[2]: archive.extractfile(one).read() for one in files}  # type: ignore[union-attr]

    def in_wheel(self, wheel: Path | None = None) -> dict[str, bytes]:
        """The files of the wheel."""
        with zipfile.ZipFile(wheel or self.wheel) as archive:
            return {name: archive.read(name) for name in archive.namelist()}

    @property
    def metadata(self) -> str:
        """What the wheel says of itself."""
        return self.in_wheel()[f"tacbench_cad-{__version__}.dist-info/METADATA"].decode()


@pytest.fixture(scope="session")
def builder(once: Once) -> Environment:
    """The environment that packages are built in, by the programs that publish most of them."""

    def fill(folder: Path) -> None:
        done = Environment.new(folder).pip("build", "twine")
        (folder / "said.txt").write_text(done.stderr if done.returncode else "")

    place = once("builder", fill)
    said = (place / "said.txt").read_text()
    if said:
        pytest.skip(f"no package index answers, so nothing can be built or installed: {said.strip().splitlines()[-1]}")
    return Environment(place / "environment", place / "here")


@pytest.fixture(scope="session")
def packages(builder: Environment, source: Path, once: Once) -> Packages:
    """Source archive and wheel from a tree with litter, the wheel once from the archive and once from the tree."""

    def fill(folder: Path) -> None:
        tree = shutil.copytree(source, folder / "tree")
        for name in LITTER:
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            (tree / name).write_text("left over")
        builder.python("-m", "build", "--outdir", folder / "packages", tree)
        # A wheel straight from a tree takes what an earlier build left there; the archive's does not.
        shutil.rmtree(tree / "build")
        builder.python("-m", "build", "--wheel", "--outdir", folder / "of-the-tree", tree)

    place = once("packages", fill)
    (sdist,), (wheel,) = (place / "packages").glob("*.tar.gz"), (place / "packages").glob("*.whl")
    (other,) = (place / "of-the-tree").glob("*.whl")
    return Packages(place / "tree", sdist, wheel, other)


def ours(names: Iterable[str]) -> set[str]:
    """Those of the files that belong to the two packages."""
    return {name for name in names if name.startswith(("tacbench_cad/", "housing/"))}


def test_the_source_archive_holds_what_is_versioned(packages: Packages) -> None:
    found = {name for name in packages.in_sdist() if not name.startswith("tacbench_cad.egg-info/")}
    assert found - {"PKG-INFO", "setup.cfg"} == set(versioned_files())
    assert {"Makefile", "constraints.txt", ".ci/run", "docs/conf.py", "tests/conftest.py", "LICENSE"} <= found


def test_the_wheel_holds_the_packages_and_nothing_else(packages: Packages) -> None:
    found = packages.in_wheel()
    assert ours(found) == ours(versioned_files())
    assert {name.partition("/")[0] for name in found} == {
        "tacbench_cad",
        "housing",
        f"tacbench_cad-{__version__}.dist-info",
    }
    assert found[f"tacbench_cad-{__version__}.dist-info/licenses/LICENSE"] == (ROOT / "LICENSE").read_bytes()


def test_both_ways_lead_to_the_same_wheel(packages: Packages) -> None:
    assert packages.in_wheel() == packages.in_wheel(packages.wheel_of_the_tree)


def test_every_data_file_that_the_code_opens_is_in_the_wheel(packages: Packages) -> None:
    found = packages.in_wheel()
    data = {Path(name).name for name in ours(found) if not name.endswith(".py")}
    named = {
        node.value
        for name, text in found.items()
        if name.endswith(".py")
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    # Templates import their macros from each other, and the stubs are opened by ``attach_stub``.
    named |= {
        word
        for name, text in found.items()
        if name.endswith(".j2")
        for word in re.findall(r'"([\w.]+)"', text.decode())
    }
    assert data - named == {"py.typed", "__init__.pyi"}, "a data file that nothing opens"
    beside = {path.name for folder in ("tacbench_cad", "housing") for path in (ROOT / folder).rglob("*.*")}
    opened = {name for name in named & beside if not name.endswith(".py")}
    assert opened <= data and {"printers.toml", "page.html"} <= opened


def test_nothing_in_them_is_of_this_machine(packages: Packages) -> None:
    configured = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    ).stdout
    hosts = set(re.findall(r"https?://(?:[^/@\s]*@)?([\w.-]+)", configured))
    needles = [str(one).encode() for one in (ROOT, packages.tree, Path(sys.prefix), *sorted(hosts))]
    for archive in (packages.in_sdist(), packages.in_wheel()):
        assert [(name, one) for name, text in archive.items() for one in needles if one in text] == []


def test_metadata(packages: Packages, builder: Environment) -> None:
    checked = call(
        [builder.program("python"), "-m", "twine", "check", "--strict", packages.sdist, packages.wheel],
        builder.here,
        PATIENCE_S,
    )
    assert checked.returncode == 0, checked.stdout
    said = message_from_string(packages.metadata)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (said["Name"], said["Version"]) == ("tacbench-cad", __version__)
    assert (said["License-Expression"], said.get_all("License-File")) == ("MIT", ["LICENSE"])
    assert said["Description-Content-Type"] == "text/markdown"
    assert set(said.get_all("Provides-Extra", [])) == set(project["optional-dependencies"])
    assert not [one for one in said.get_all("Requires-Dist", []) if "@" in one], "a package at an address"
    assert (ROOT / "README.md").read_text(encoding="utf-8").strip() in packages.metadata
    assert packages.in_sdist()["PKG-INFO"].decode() == packages.metadata


@pytest.fixture
def environment(packages: Packages, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Environment]:
    """The wheel and the extras that a test names, in an environment of their own."""
    extras: str = request.param
    one = Environment.new(tmp_path)
    done = one.pip(f"{packages.wheel}[{extras}]" if extras else packages.wheel)
    assert done.returncode == 0, done.stderr
    yield one
    shutil.rmtree(one.root)


def extra(name: str) -> pytest.MarkDecorator:
    """Gives a test the environment of an extra."""
    return pytest.mark.parametrize("environment", [name], indirect=True, ids=[name or "base"])


def write_inputs(here: Path) -> None:
    """A recorded study, G-code of texture 1, and a file for acquire."""
    write_study(here / "runs", textures=(1, 2), copies=2)
    write_study(here / "others", textures=(1, 2), copies=2)
    (here / "study.toml").write_text(STUDY, encoding="utf-8")
    write_gcode(here / "texture-1.gcode", Block.of(1))


def extras_of(modules: set[str]) -> set[str | None]:
    """The extras that bring these modules."""
    return {package.extra for package in PACKAGES if package.module in modules}


#: What a command says in the base install; where it needs more, the extra.
IN_BASE = (
    ("--version", f"tacbench {__version__}"),
    ("textures", "texture-6"),
    ("cite", "Shepherd"),
    ("doctor", 'pip install "tacbench-cad[cad]"'),
    ("make --texture 1 --formats stl,3mf --parts blocks --out made", "texture-1_paper_x1.3mf"),
    (
        "make --texture 1 --out all",
        "left out: holder, jig: needs cadquery-ocp, build123d, not installed: run pip install",
    ),
    ("check-part made/texture-1_paper_x1.stl", "all checks passed"),
    ("check-part made/texture-1_paper_x1.3mf", "all checks passed"),
    ("plate --printer ender-3 --texture 1 --copies 2 --out plates", "T1 PAPER X1 01 02"),
    ("export-simulator --to mjcf,urdf,sdf,usd,obj,glb,npy,png16,taxim --texture 1 --out sim", "texture-1.xml"),
    (
        "check-gcode texture-1.gcode --texture 1",
        'no picture: pictures need matplotlib: pip install "tacbench-cad[plot]"',
    ),
    ("split runs --out splits", "split_copy.json"),
)
#: What needs more, and the extra that brings it.
BEYOND_BASE = (
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
    ("classify runs -o {out}", "analysis"),
    ("report runs -o {out}.html", "analysis"),
    ("compare runs others -o {out}", "analysis"),
)
#: The same, of commands that ask somebody, or find fault with these runs.
ALSO_BEYOND_BASE = (
    ("acquire --virtual --out {out}", "lab"),
    ("rig align study.toml", "lab"),
    ("rig calibrate-force --masses 0,50,100 --port virtual --out {out}.json", "lab"),
    ("check-runs runs", "lab"),
)


@extra("")
def test_base(environment: Environment) -> None:
    write_inputs(environment.here)
    for line, needle in IN_BASE:
        assert needle in environment.tacbench(line), line
    for line, needed in (*BEYOND_BASE, *ALSO_BEYOND_BASE):
        assert f'pip install "tacbench-cad[{needed}]"' in environment.refuses(line.format(out="refused")), line
    assert list(environment.here.glob("refused*")) == [], "written in spite of the refusal"
    lacks = environment.lacks()
    assert extras_of(set(lacks.values())) <= {"cad", "analysis"}
    assert {"tacbench_cad.cq", "tacbench_cad.bd", "housing.bd"} <= set(lacks), "of the two plugins' packages"
    light = ("tacbench_cad.lab.", "tacbench_cad.cli.", "tacbench_cad.making.", "tacbench_cad.slicing.")
    assert [name for name in lacks if name.startswith(light)] == ["tacbench_cad.lab.analysis.classification.network"]


@pytest.mark.long
@extra("lab")
def test_lab(environment: Environment) -> None:
    (environment.here / "study.toml").write_text(STUDY, encoding="utf-8")
    if sys.platform != "win32":  # which has no pseudo-terminals
        environment.tacbench("acquire study.toml --out runs")
        assert "2 presses: nothing wrong" in environment.tacbench("check-runs runs")
        assert environment.tacbench("export-runs runs --to tactile-data --out exported")
    environment.tacbench("simulate --study study.toml --out simulated --jobs 1")
    assert "2 presses: nothing wrong" in environment.tacbench("check-runs simulated")
    assert "plugged in" in environment.tacbench("rig probe")
    assert 'pip install "tacbench-cad[analysis]"' in environment.refuses("variance runs")
    lacks = environment.lacks()
    assert [name for name in lacks if name.startswith("tacbench_cad.lab.")] == [
        "tacbench_cad.lab.analysis.classification.network"
    ]


@pytest.mark.long
@extra("plot")
def test_plot(environment: Environment) -> None:
    environment.tacbench("show 4 --press -o press.png")
    environment.tacbench("make --texture 1 --parts blocks --formats stl --out made")
    for name in ("press.png", "made/preview.png"):
        assert (environment.here / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@extra("view")
def test_view(environment: Environment) -> None:
    environment.tacbench("view blocks -o view.html")
    assert "texture-6" in (environment.here / "view.html").read_text(encoding="utf-8")


@pytest.mark.long
@extra("analysis")
def test_analysis(environment: Environment) -> None:
    write_inputs(environment.here)
    environment.tacbench("variance runs -o variance --jobs 1")
    environment.tacbench("classify runs -o classified --hold-out copy --trials 1 --jobs 1")
    environment.tacbench("report runs -o report.html --variance variance --classify classified")
    assert "data:image/" in (environment.here / "report.html").read_text(encoding="utf-8")
    assert list((environment.here / "report_files").rglob("*.pdf"))
    assert "cad" in extras_of(set(environment.lacks().values()))


def use_cad(environment: Environment) -> None:
    """The print set of one texture, examined in every way, and every module."""
    assert "ok: kernel packages" in environment.tacbench("doctor --repair")
    assert "left out" not in environment.tacbench("make --texture 1 --verify full --out made")
    made = {path.name for path in (environment.here / "made").iterdir()}
    stems = {name.partition(".")[0] for name in made} - {"manifest", "preview"}
    assert len(stems) == 3, "block, holder, jig"
    assert {f"{stem}.{form}" for stem in stems for form in ("stl", "3mf", "step")} <= made
    for form in ("stl", "3mf", "step"):
        assert "all checks passed" in environment.tacbench(f"check-part made/texture-1_paper_x1.{form}")
    assert environment.lacks() == {}


@pytest.mark.long
@extra("cad")
def test_cad(environment: Environment) -> None:
    use_cad(environment)
    assert 'pip install "tacbench-cad[view]"' in environment.refuses("view -o no.html")


@pytest.mark.long
@extra("all")
def test_all(environment: Environment, source: Path) -> None:
    write_inputs(environment.here)
    use_cad(environment)
    environment.tacbench("view -o view.html")
    assert (environment.here / "view.html").stat().st_size > 1_000_000
    environment.tacbench("simulate --study study.toml --out simulated")
    assert "2 presses: nothing wrong" in environment.tacbench("check-runs simulated")
    # A simulator comes with no extra, PyTorch with another.
    others = re.compile(r"^\s*import (mujoco|torch)$", re.MULTILINE)
    examples = [one for one in sorted((source / "examples").glob("*.py")) if not others.search(one.read_text())]
    assert len(examples) >= 7
    for example in examples:
        environment.python(example)
    for number, (line, _) in enumerate(BEYOND_BASE):
        environment.tacbench(line.format(out=f"out-{number}"))
