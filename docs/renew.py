"""Run the code of the manual's pages and renew the outputs and pictures in the pages.

``python docs/renew.py`` renews every page, ``python docs/renew.py start gallery`` renews two. A page is plain
Markdown. These marks, which GitHub hides, select the code that is run:

    ```python run              The block is run. Its output is written below it, into a block "text output".
    ```sh run lines=8+2        The first 8 and the last 2 lines of the output are shown; the default is 22+2.
    ```sh run quiet            The output is not shown.
    ```sh run varies           The numbers of the output differ from run to run: it is kept if only numbers differ.
    ```toml write=hex.toml     The block is saved as a file for the blocks below. The text above it names the file.
    ```python from=../examples/hexagonal.py    The block is kept equal to the file, and is not run.
    <!-- picture: out/plot.png 600 -->    The next line, ![what it shows](images/PAGE/plot.webp), shows this file of
                               the page's folder, at most 600 pixels wide. With the word "varies"
                               before -->, a committed picture is kept: it differs from run to run.
    <!-- run: python           Readers do not see this code, which ends at a line -->

Write the marks, run the program, and commit the page with its outputs and pictures.

The blocks of a page run in order, in a folder that is empty at first. The Python blocks of a page share their
variables. A command that fails ends the renewal of the page. Lines of progress are left out. A picture of an HTML file
is a screenshot by Chromium; where Chromium is missing, the committed picture stays. The help of all commands is written
between ``<!-- commands -->`` and ``<!-- end of commands -->``. A table whose first heading is "module" receives the
first lines of the modules' docstrings.

An output is rewritten only if it differs in more than durations, dates, addresses and the rounding of numbers, and a
picture only if the difference can be seen.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from PIL import Image

DOCS = Path(__file__).resolve().parent
#: The largest committed picture, in bytes.
MAX_PICTURE_BYTES = 150_000
#: The default for the numbers of first and last lines of an output that are shown.
MAX_LINES = "22+2"
#: The default width above which a picture is reduced, in pixels.
MAX_WIDTH_PX = 1400
#: Two pictures look alike if the colours of every tile of this side, in pixels, differ by no more than this on average.
TILE_PX, MAX_TILE_DIFFERENCE = 8, 16.0
#: The largest relative difference between numbers of outputs that are alike.
MAX_DIFFERENCE = 0.01
MAX_SECONDS = 1200
MAX_SCREENSHOTS = 30

_FENCE = re.compile(r"(?P<marks>`{3,})(?P<language>[\w-]+)(?P<words>(?: [^`]*)?)$")
_PICTURE = re.compile(r"<!-- picture: (?P<source>\S+)(?: (?P<width>\d+))?(?P<varies> varies)? -->$")
_TARGET = re.compile(r"!\[.+\]\((?P<target>images/[^)]+)\)$")
#: The row of a module in a table.
MODULE = re.compile(r"^\| `(?P<name>(?:tacbench_cad|housing)[\w.]*)` \|.*\|$", re.MULTILINE)
#: Text that differs between runs or machines: durations, dates, temporary folders, ports of the virtual rig, digests.
_VARIES = re.compile(
    r"\d+(?:\.\d+)? ?(?:ms|s|min|h)\b|\d{4}-\d\d-\d\d|\d\d:\d\d(?::\d\d)?(?:\.\d+)?|/tmp/\S+|/dev/\S+"
    r"|\b[0-9a-f]{64}\b"
)
#: Lines of progress. A page shows none of them, because their number depends on the speed of the machine.
_PROGRESS = re.compile(r"\[\d[\d,]*/\d[\d,]*\] |\S+  (?!(?P<all>\d+)/(?P=all) )\d+/\d+  .*\bleft\b|writing the page$")
#: Gaps and horizontal lines. Their length depends on the words beside them.
GAPS = re.compile(r"(?:[\s─━]|--+)+")
_NUMBER = re.compile(r"([-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)")


class PageError(Exception):
    """An error in the marks or in the code of a page."""


@dataclass(frozen=True)
class Item:
    """A marked part of a page."""

    #: The kind: ``block``, ``hidden`` (code), ``picture``, ``commands`` (the help of all), or ``module`` (a table row).
    kind: str
    #: The first line and the line after the last, counted from 0. An output block belongs to the block above it.
    start: int
    stop: int
    language: str = ""
    #: The words after the language, or in the comment of a picture.
    options: dict[str, str] = field(default_factory=dict)
    code: str = ""
    #: The current output in the page.
    output: str = ""


def parse(page: str, lines: list[str]) -> Iterator[Item]:
    """Yield the marked parts of a page in order."""
    i = 0
    while i < len(lines):
        start, line = i, lines[i]
        i += 1
        if fence := _FENCE.match(line):
            stop = closing(page, lines, i, fence["marks"])
            options = {key: value for key, _, value in (word.partition("=") for word in fence["words"].split())}
            code, i, output = "\n".join(lines[i:stop]) + "\n", stop + 1, ""
            if "output" in options:
                raise PageError(f"{page}:{start + 1}: There is no block with the word run above this output.")
            after = _FENCE.match(lines[i + 1]) if i + 1 < len(lines) and not lines[i] else None
            if "run" in options and after and after["words"].split() == ["output"]:
                stop = closing(page, lines, i + 2, after["marks"])
                output, i = "\n".join(lines[i + 2 : stop]), stop + 1
            if options.keys() & {"run", "write", "from"}:
                yield Item("block", start, i, fence["language"], options, code, output)
        elif line.startswith("<!-- run: "):
            stop = closing(page, lines, i, "-->")
            yield Item("hidden", start, stop + 1, line.split()[-1], code="\n".join(lines[i:stop]) + "\n")
            i = stop + 1
        elif picture := _PICTURE.match(line):
            target = _TARGET.match(lines[i]) if i < len(lines) else None
            if target is None:
                raise PageError(f"{page}:{i + 1}: A picture's comment needs ![what it shows](images/...) below it.")
            yield Item("picture", start, i + 1, options=picture.groupdict() | target.groupdict())
        elif line == "<!-- commands -->":
            i = closing(page, lines, i, "<!-- end of commands -->")
            yield Item("commands", start + 1, i)
        elif line.startswith("| module |"):
            while i < len(lines) and lines[i].startswith("|"):
                if row := MODULE.match(lines[i]):
                    yield Item("module", i, i + 1, options=row.groupdict())
                i += 1


def closing(page: str, lines: list[str], start: int, end: str) -> int:
    """Return the number of the next line that is the given end mark."""
    try:
        return lines.index(end, start)
    except ValueError:
        raise PageError(f"{page}:{start}: A block is not closed by {end}.") from None


@contextmanager
def captured() -> Iterator[io.BufferedRandom]:
    """Redirect the output of this process and its children to a file."""
    with tempfile.TemporaryFile() as file:
        copies = os.dup(1), os.dup(2)
        try:
            for stream in (1, 2):
                os.dup2(file.fileno(), stream)
            yield file
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for stream, copy in zip((1, 2), copies, strict=True):
                os.dup2(copy, stream)
                os.close(copy)


class Session:
    """The process state in which the blocks of one page run, in the current folder."""

    def __init__(self) -> None:
        self.main = ModuleType("__main__")
        sys.modules["__main__"] = self.main
        sys.path.insert(0, "")

    def run(self, language: str, code: str) -> str:
        """Run a block and return its output. If a block ends with an expression, its value is printed."""
        with captured() as file:
            problem = ""
            try:
                if language == "python":
                    self.execute(code)
                else:
                    command = ["bash", "-e", "-c", f"exec 2>&1\n{code}"]
                    subprocess.run(command, check=True, timeout=MAX_SECONDS, stdin=subprocess.DEVNULL)
            except subprocess.SubprocessError as error:
                problem = str(error).replace(code, "...")
            except BaseException:  # a block may raise any exception, including SystemExit
                problem = traceback.format_exc()
            sys.stdout.flush()
            sys.stderr.flush()
            file.seek(0)
            text = file.read().decode("utf-8", errors="replace")
        if problem:
            raise PageError(f"This block failed:\n{code}\n{text}{problem}")
        return text.replace(f"{Path.cwd()}/", "")

    def execute(self, code: str) -> None:
        """Execute Python code."""
        tree = ast.parse(code)
        last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, "<block>", "exec"), self.main.__dict__)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "<block>", "eval"), self.main.__dict__)
            if value is not None:
                print(repr(value))


def shortened(text: str, limit: str) -> str:
    """Keep the first and the last lines of an output: ``8+2`` or ``8``."""
    lines = [line.rstrip() for line in text.strip("\n").split("\n") if not _PROGRESS.match(line)]
    first, last = (int(number or 0) for number in f"{limit}+".split("+")[:2])
    if len(lines) > first + last + 1:
        lines[first : len(lines) - last] = ["..."]
    return "\n".join(lines)


def alike(old: str, new: str, *, varies: bool = False) -> bool:
    """Return whether two outputs differ only in durations and rounding, or also in other numbers if ``varies``."""
    words = [_NUMBER.split(GAPS.sub(" ", _VARIES.sub("?", text))) for text in (old, new)]
    if len(words[0]) != len(words[1]):
        return False
    return all(
        (varies or a == b or abs(float(a) - float(b)) <= MAX_DIFFERENCE * abs(float(b)))
        if i % 2
        else a.strip() == b.strip()
        for i, (a, b) in enumerate(zip(*words, strict=True))
    )


def fenced(text: str) -> list[str]:
    """Return the lines of an output as a block."""
    longest = max((len(marks) for marks in re.findall(r"`{3,}", text)), default=2)
    return ["", f"{'`' * (longest + 1)}text output", *text.split("\n"), "`" * (longest + 1)]


def look_alike(old: Path, new: Image.Image) -> bool:
    """Return whether a committed picture looks like a new picture."""
    import numpy as np
    from PIL import Image

    with Image.open(old) as file:
        pictures = [np.asarray(picture.convert("RGB"), dtype=float) for picture in (file, new)]
    if pictures[0].shape != pictures[1].shape:
        return False
    difference = np.abs(pictures[0] - pictures[1]).max(axis=2)
    rows, columns = (length - length % TILE_PX for length in difference.shape)
    tiles = difference[:rows, :columns].reshape(rows // TILE_PX, TILE_PX, columns // TILE_PX, TILE_PX)
    return bool(tiles.mean(axis=(1, 3)).max(initial=0.0) <= MAX_TILE_DIFFERENCE)


def encoded(picture: Image.Image) -> bytes:
    """Return the smallest file of a picture. Lossless compression is often smaller for drawings."""
    files = []
    for settings in ({"lossless": True, "quality": 100}, {"quality": 85}, {"quality": 60}):
        stream = io.BytesIO()
        picture.save(stream, "WEBP", method=6, **settings)
        files.append(stream.getvalue())
    return min(files[:2], key=len) if min(map(len, files[:2])) <= MAX_PICTURE_BYTES else files[2]


def screenshot(source: Path, width: int) -> Path | None:
    """Take a picture of an HTML file in Chromium; return None if Chromium is missing."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        program = None
    if program is None:
        return None
    target = source.with_suffix(".screenshot.png")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        page = browser.new_page(viewport={"width": width, "height": round(0.68 * width)})
        page.goto(source.resolve().as_uri(), wait_until="networkidle")
        # A page may load or draw slowly, so pictures are taken until two of them are equal.
        pictures = [b"", page.screenshot(path=target)]
        while pictures[-1] != pictures[-2] and len(pictures) < MAX_SCREENSHOTS:
            page.wait_for_timeout(2000)
            pictures.append(page.screenshot(path=target))
        browser.close()
    return target


def renew_picture(source: Path, width: int, target: Path) -> bool:
    """Write a picture into the manual if it looks different from the committed one; return whether it was written."""
    from PIL import Image

    if not source.is_file():
        raise PageError(f"{source}: No block of the page writes this picture.")
    if source.suffix == ".html":
        file = screenshot(source, width)
        if file is None:
            print(f"{target.relative_to(DOCS)}: Chromium is missing, so the picture is not renewed", file=sys.stderr)
            return False
        source = file
    with Image.open(source) as original:
        picture = Image.new("RGB", original.size, "white")
        picture.paste(original, mask=original.convert("RGBA").getchannel("A"))
    if picture.width > width:
        picture = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
    data = encoded(picture)
    if len(data) > MAX_PICTURE_BYTES:
        raise PageError(
            f"{source}: {len(data)} bytes as WebP are too many. Write a width below {width} pixels after its name."
        )
    with Image.open(io.BytesIO(data)) as decoded:
        if target.is_file() and look_alike(target, decoded):
            return False
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(data)
    return True


def renew(page: Path) -> list[str]:
    """Renew a page, run its blocks in the current folder, and return the names of the rewritten files."""
    name, text = page.relative_to(DOCS).as_posix(), page.read_text(encoding="utf-8")
    lines = text.split("\n")
    items = list(parse(name, lines))
    session, result, position, renewed = Session(), [], 0, []
    for item in items:
        result += lines[position : item.start]
        position = item.stop
        try:
            result += renewed_lines(page, item, session, lines, renewed)
        except PageError as error:
            raise PageError(f"{name}:{item.start + 1}: {error}") from None
    new = "\n".join([*result, *lines[position:]])
    if page.read_text(encoding="utf-8") != text:
        raise PageError(f"{name}: The page was edited while its code ran. Renew it again.")
    if new != text:
        page.write_text(new, encoding="utf-8")
        renewed.insert(0, name)
    return renewed


def summary_of(module: str) -> str:
    """Return the first line of the docstring of a module."""
    return inspect.cleandoc(importlib.import_module(module).__doc__ or "").partition("\n")[0]


def renewed_lines(page: Path, item: Item, session: Session, lines: list[str], renewed: list[str]) -> list[str]:
    """Run one item and return its lines in the renewed page."""
    options = item.options
    shown = lines[item.start : item.stop]
    if item.kind == "hidden":
        session.run(item.language, item.code)
    elif item.kind == "picture":
        target = page.parent / options["target"]
        kept = options["varies"] and target.is_file()
        if not kept and renew_picture(Path(options["source"]), int(options["width"] or MAX_WIDTH_PX), target):
            renewed.append(target.relative_to(DOCS).as_posix())
    elif item.kind == "commands":
        import help_pages

        return ["", *help_pages.reference().split("\n"), ""]
    elif item.kind == "module":
        summary = summary_of(options["name"]).replace("``", "`").replace("|", r"\|")
        return [f"| `{options['name']}` | {summary} |"]
    elif "from" in options:
        text = (page.parent / options["from"]).read_text(encoding="utf-8").rstrip("\n")
        shown = [shown[0], *text.split("\n"), shown[-1]]
    if "write" in options:
        file = Path(options["write"])
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("\n".join([*shown[1:-1], ""]), encoding="utf-8")
    if "run" in options:
        block = shown[: item.code.count("\n") + 2]
        output = shortened(session.run(item.language, item.code), options.get("lines", MAX_LINES))
        if "quiet" in options or not output:
            return block
        return [*block, *fenced(item.output if alike(item.output, output, varies="varies" in options) else output)]
    return shown


def environment() -> dict[str, str]:
    """Return the environment variables for the pages: the commands of this environment, and outputs without colours."""
    return os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "COLUMNS": "100",
        "MPLBACKEND": "agg",
        "PYTHONUTF8": "1",
        # Several pages are renewed at the same time, so the commands of each page use one processor.
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHON_CPU_COUNT": "1",
        "TTY_COMPATIBLE": "0",
        "TACBENCH_EXAMPLES": str(DOCS.parent / "examples"),
    }


def renew_in_process(page: Path) -> tuple[list[str], str]:
    """Renew a page in a separate process and folder; return the rewritten files, and the error or an empty string."""
    with tempfile.TemporaryDirectory(prefix="page-") as folder:
        command = [sys.executable, __file__, "--in-this-folder", page]
        process = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True)
    return process.stdout.split(), process.stderr if process.returncode else ""


def main() -> int:
    """Renew the named pages, or all pages."""
    parser = argparse.ArgumentParser(description="Renew outputs and pictures of the manual's pages.")
    parser.add_argument("pages", nargs="*", help="names of pages, such as start; all pages without a name")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count(), help="the number of pages that are renewed at the same time"
    )
    parser.add_argument("--in-this-folder", type=Path, metavar="PAGE", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.in_this_folder:
        try:
            print(*renew(options.in_this_folder), sep="\n")
        except PageError as error:
            sys.exit(str(error))
        return 0
    pages = [DOCS / f"{name.removesuffix('.md')}.md" for name in options.pages] or [
        *DOCS.glob("*.md"),
        DOCS / "api" / "index.md",
    ]
    # Pages with much code take longest, so they start first.
    pages.sort(key=lambda page: page.read_text(encoding="utf-8").count(" run"), reverse=True)
    begin, failed = time.monotonic(), False
    with ThreadPoolExecutor(options.jobs) as executor:
        futures = {executor.submit(renew_in_process, page): page for page in pages}
        for count, future in enumerate(as_completed(futures), 1):
            renewed, problem = future.result()
            failed |= bool(problem)
            outcome = f"failed\n{problem}" if problem else f"rewrote {', '.join(renewed)}" if renewed else "no change"
            page = futures[future].relative_to(DOCS)
            print(f"[{count}/{len(pages)}] {time.monotonic() - begin:.0f} s  {page}: {outcome}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
