"""Measure how many small errors in the code the tests notice (mutation testing).

    python benchmarks/mutation.py [--seed 26] [--count 300] [--rooms ROOM,ROOM,...] [--out FILE]

Each mutant changes one place of one module: a comparison, an arithmetic operator, a number (plus 1), a condition
(negated), a statement (removed) or a returned value (None). The mirrored tests of the module then run in a copy of the
project: first the test files with the module's name, then the other files of the folder. A mutant is killed if a test
fails, timed out if the tests do not end (which a person would notice too), and has survived otherwise.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 600.0
ROOMS = "spec,geometry,lab/acquire,lab/analysis"
COMPARISONS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COMPARISONS |= {ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
OPERATORS |= {ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult}


@dataclass
class Mutant:
    """One change of one module, and what the tests made of it."""

    room: str
    module: str
    site: int
    line: int
    kind: str
    result: str = ""
    seconds: float = 0.0


def sites(tree: ast.Module) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """Yield the places of a module that can be changed, always in the same order, with the kind of change."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            yield node, "comparison"
        elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS:
            yield node, "operator"
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node, "number"
        elif isinstance(node, ast.If | ast.IfExp | ast.While):
            yield node, "condition"
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield node, "statement"
        elif isinstance(node, ast.Return) and node.value is not None:
            yield node, "return"


def mutated(source: str, site: int) -> str:
    """Return the source of a module with one place changed."""
    tree = ast.parse(source)
    match list(sites(tree))[site][0]:
        case ast.Compare() as node:
            node.ops[0] = COMPARISONS[type(node.ops[0])]()
        case ast.BinOp() | ast.AugAssign() as node:
            node.op = OPERATORS[type(node.op)]()
        case ast.Constant() as node:
            node.value += 1
        case ast.If() | ast.IfExp() | ast.While() as node:
            node.test = ast.UnaryOp(op=ast.Not(), operand=node.test)
        case ast.Expr() | ast.Return() as node:
            node.value = ast.Constant(value=None)
    return ast.unparse(ast.fix_missing_locations(tree))


def chosen(rooms: list[str], count: int, seed: int) -> list[Mutant]:
    """Return equally many random mutants of each room in turn; a smaller sample is the beginning of a larger one."""
    samples: list[list[Mutant]] = [[] for _ in rooms]
    for room, sample in zip(rooms, samples, strict=True):
        for path in sorted((ROOT / "tacbench_cad" / room).rglob("*.py")):
            for site, (node, kind) in enumerate(sites(ast.parse(path.read_text()))):
                sample.append(Mutant(room, str(path.relative_to(ROOT)), site, node.lineno, kind))
        random.Random(seed).shuffle(sample)
    return [mutant for group in zip(*samples, strict=False) for mutant in group][:count]


def mirrored(module: str) -> list[list[str]]:
    """Return the test files with a module's name, and the other files of the mirrored folder."""
    folder = Path("tests", *Path(module).parts[1:-1])
    folder = next(place for place in (folder, *folder.parents) if (ROOT / place).is_dir())
    every = sorted(str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob("test_*.py"))
    first = [name for name in every if Path(module).stem in Path(name).stem]
    return [files for files in (first, [name for name in every if name not in first]) if files]


def run_tests(copy: Path, files: list[str], failing: set[str], limit_s: float | None) -> tuple[str, set[str]]:
    """Run test files in the copy until the first new failure, and return the result and the tests that failed."""
    command = [sys.executable, "-m", "pytest", "-q", "-rfE", "--no-header", "--tb=no", "-p", "no:cacheprovider", *files]
    command += ["-x"] * (limit_s is not None) + [f"--deselect={name}" for name in sorted(failing)]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryFile("w+") as out:
        tests = subprocess.Popen(command, cwd=copy, stdout=out, stderr=out, env=environment, start_new_session=True)
        try:
            code = tests.wait(limit_s)
        except subprocess.TimeoutExpired:
            os.killpg(tests.pid, signal.SIGKILL)
            tests.wait()
            return "timed out", set()
        out.seek(0)
        lines = [line.split(" ") for line in out.read().splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return "survived" if code in (0, 5) else "killed", {words[1] for words in lines}


def main() -> int:
    """Run the mutants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=26)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--rooms", default=ROOMS)
    parser.add_argument("--out", type=Path, default=Path("mutants.json"))
    options = parser.parse_args()
    rooms = options.rooms.split(",")
    mutants = chosen(rooms, options.count, options.seed)
    with tempfile.TemporaryDirectory() as temporary:
        copy = Path(temporary) / "copy"
        shutil.copytree(ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(".git", ".*_cache", "__pycache__"))
        known: dict[tuple[str, ...], set[str]] = {}
        for mutant in mutants:
            start, path = time.monotonic(), copy / mutant.module
            source = path.read_text()
            for files in mirrored(mutant.module):
                if tuple(files) not in known:  # tests that fail without a change say nothing about a mutant
                    known[tuple(files)] = run_tests(copy, files, set(), None)[1]
                path.write_text(mutated(source, mutant.site))
                mutant.result, _ = run_tests(copy, files, known[tuple(files)], LIMIT_S)
                path.write_text(source)
                if mutant.result != "survived":
                    break
            mutant.seconds = time.monotonic() - start
            print(f"{mutant.result:10} {mutant.module}:{mutant.line} {mutant.kind} {mutant.seconds:.0f} s", flush=True)
            options.out.write_text(json.dumps([asdict(one) for one in mutants if one.result], indent=1))
    print(f"{'room':16}{'mutants':>9}{'killed':>11}{'timed out':>11}{'survived':>11}{'noticed (%)':>13}")
    for room in [*rooms, ""]:
        counts = Counter(mutant.result for mutant in mutants if room in ("", mutant.room))
        total = max(1, counts.total())
        cells = "".join(f"{counts[result]:11}" for result in ("killed", "timed out", "survived"))
        print(f"{room or 'all':16}{total:9}{cells}{100.0 * (total - counts['survived']) / total:13.1f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
