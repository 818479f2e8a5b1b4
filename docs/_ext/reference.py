"""The reference of the API, made from the code: a page for each public module, and the index's tables of modules."""

from __future__ import annotations

import ast
import builtins
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from functools import cache, partial, reduce
from operator import or_
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin

import numpy as np
from docutils import nodes
from numpy.typing import ArrayLike, NDArray
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from sphinx.util.inspect import signature, stringify_signature
from sphinx.util.typing import restify

import housing
import tacbench_cad

GENERATED = Path("api") / "generated"
#: The packages whose public names are loaded lazily from other modules.
PUBLIC = ("housing", "tacbench_cad", "tacbench_cad.lab", "tacbench_cad.virtual_rig")
#: Longer values of constants are not shown.
MOST_LETTERS = 300
#: A table of modules in the index, and a row of it.
MODULE_TABLE = re.compile(r"^\| module \|.*\n(?:\|.*\n)*", re.MULTILINE)
MODULE_ROW = re.compile(r"^\| `((?:tacbench_cad|housing)[\w.]*)` \|", re.MULTILINE)
#: Names of other projects are no links: they have no pages here, and the build asks no network for theirs.
OTHERS = re.compile(
    r"(abc|argparse|collections|concurrent|contextlib|datetime|functools|pathlib|random|socket|subprocess|typing|build123d"
    r"|cadquery|cv2|dask|distributed|jinja2|joblib|lib3mf|manifold3d|matplotlib|numpy|OCP|pymeshlab|serial|sklearn)\."
)


def public_modules() -> list[str]:
    """Names of all modules that a user may import; the commands have a page of their own."""
    found = []
    for package in (housing, tacbench_cad):
        inside = pkgutil.walk_packages(package.__path__, f"{package.__name__}.", onerror=importlib.import_module)
        found += [package.__name__, *(one.name for one in inside)]
    return [name for name in found if not re.search(r"\._|^tacbench_cad\.cli\b", name)]


class Arrays:
    """Stands for ``NDArray``: an array in an annotation is ``NDArray[float64]``, not what NumPy makes of it."""

    def __class_getitem__(cls, kind: type) -> type:
        """The name of such arrays as a type."""
        return type(f"NDArray[{kind.__name__}]", (), {"__module__": "numpy.typing"})


def short(value: Any) -> Any:
    """A value of a module; where it is a type of arrays, or is made of some, with names as the code has them."""
    origin, inside = get_origin(value), get_args(value)
    if value is ArrayLike:
        return type("ArrayLike", (), {"__module__": "numpy.typing"})
    if value is NDArray:
        return Arrays
    if origin is np.ndarray:
        return Arrays[get_args(inside[1])[0]]
    if origin is UnionType:
        return reduce(or_, map(short, inside))
    return tuple[tuple(map(short, inside))] if origin is tuple else value


def import_for_annotations(name: str) -> None:
    """Import a module with what it imports for its annotations only, so that these become links."""
    module = importlib.import_module(name)
    vars(module).update({key: short(value) for key, value in vars(module).items() if not key.startswith("_")})
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for one in (one for one in node.body if isinstance(one, ast.ImportFrom)):
                source = importlib.import_module(one.module or "")
                for alias in one.names:
                    vars(module).setdefault(alias.asname or alias.name, getattr(source, alias.name))


@cache
def public_names(package: str) -> dict[str, str]:
    """The public names of a package that loads them lazily, each with its full name where it is defined."""
    stub = Path(importlib.import_module(package).__file__ or "").with_suffix(".pyi")
    names = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        for alias in node.names if isinstance(node, ast.ImportFrom) and node.module else ():
            value = getattr(importlib.import_module(package), alias.name)
            module = getattr(value, "__module__", None) if inspect.isclass(value) or inspect.isfunction(value) else None
            names[alias.name] = f"{module or f'{package}.{node.module}'}.{alias.name}"
    return names


def module_page(name: str, inside: list[str]) -> str:
    """The page of a module: its docstring, everything public in the order of the source, and the modules in it.

    These pages stand in no table of contents: two hundred lines beside every page would help nobody, and cost a minute.
    """
    above = [name[: at.start()] for at in re.finditer(r"\.", name)]
    way = " / ".join([":doc:`API </api/index>`", *(f":py:mod:`{one}`" for one in above[-1:])])
    lines = [":orphan:", "", name, "=" * len(name), "", way, "", f".. automodule:: {name}", ""]
    if name in PUBLIC:
        # Its names are documented where they are defined: two pages with one name would make links ambiguous.
        lines[-1:] = ["   :no-members:", "", ".. rubric:: Public names", ""]
        lines += [f"* :py:obj:`{word} <{target}>`" for word, target in sorted(public_names(name).items())]
        lines += [""]
    if inside:
        lines += [".. rubric:: Modules", "", ".. modules::", "", *(f"   {one}" for one in inside), ""]
    return "\n".join(lines)


def write_module_pages(app: Sphinx) -> None:
    """Write the pages of all modules, and warn if the index does not name each of them once."""
    folder, modules = app.srcdir / GENERATED, public_modules()
    folder.mkdir(exist_ok=True)
    for page in folder.iterdir():
        if page.stem not in modules:
            page.unlink()
    index = app.srcdir / "api" / "index.md"
    tables = MODULE_TABLE.findall(index.read_text(encoding="utf-8"))
    rows = [name for table in tables for name in MODULE_ROW.findall(table)]
    logger = logging.getLogger(__name__)
    for name in modules:
        import_for_annotations(name)
        inside = [one for one in modules if one.rpartition(".")[0] == name]
        page, text = folder / f"{name}.rst", module_page(name, inside)
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")
        if rows.count(name) != 1:
            logger.warning("%s is named %d times, not once", name, rows.count(name), location="api/index")


class Modules(SphinxDirective):
    """A table of the modules in its content, each with the first line of its docstring."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Make the table."""
        lines = [".. list-table::", "   :class: reference", ""]
        for name in self.content:
            summary = inspect.cleandoc(importlib.import_module(name).__doc__ or "").partition("\n")[0]
            lines += [f"   * - :py:mod:`{name}`", f"     - {summary}"]
        return self.parse_text_to_nodes("\n".join(lines))


def tables_of_modules(app: Sphinx, name: str, source: list[str]) -> None:
    """Give the index's tables of modules, which are plain Markdown, links to the modules' pages."""
    if name == "api/index":
        link = partial(MODULE_ROW.sub, r"| [`\1`](generated/\1.rst) |")
        source[0] = MODULE_TABLE.sub(lambda table: link(table[0]), source[0])


class CodeLinks(SphinxPostTransform):
    """Links from the pages to the reference: from a class ``Block``, a function ``build()`` or a full name."""

    default_priority = 5

    def run(self, **kwargs: Any) -> None:
        """Turn code that names something public into a reference."""
        if self.env.docname.startswith(GENERATED.as_posix()):
            return
        for node in list(self.document.findall(nodes.literal)):
            target = documented(node.astext())
            if target is None or node.parent is None or isinstance(node.parent, nodes.reference):
                continue
            link = self.env.domains.python_domain.resolve_xref(
                self.env, self.env.docname, self.app.builder, "obj", target, addnodes.pending_xref(), node.deepcopy()
            )
            if link is not None:
                node.replace_self(link)


def documented(text: str) -> str | None:
    """The full name of what a piece of code names: a public class, a public function with brackets, a dotted name."""
    name = text.removesuffix("()")
    if not re.fullmatch(r"[A-Za-z_][\w.]*", name):
        return None
    package, _, last = name.rpartition(".")
    if package in PUBLIC:
        return public_names(package).get(last, name)
    if package:
        return name if name.startswith(("tacbench_cad.", "housing.")) else None
    if name in PUBLIC:
        return name
    if name == text and not re.match(r"[A-Z]+[a-z]", name):
        return None
    return next((names[name] for names in map(public_names, PUBLIC) if name in names), None)


def shorten(
    app: Sphinx, what: str, name: str, obj: Any, options: object, arguments: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Show a default that has no short text as dots."""
    if what == "class" and arguments == "(*args, **kwargs)":
        # A metaclass of build123d hides what the class takes.
        arguments = stringify_signature(
            signature(obj.__init__, bound_method=True), show_return_annotation=False, unqualified_typehints=True
        )
    enums = arguments and re.sub(r"<(\w+\.\w+)>", r"\1", arguments)
    return enums and re.sub(r"=\s?<[^<>]*>", "=...", enums), returned


def known_bases(kind: type) -> Iterator[type]:
    """The base classes that say something to a user; a private one of ours stands for its own."""
    for base in kind.__bases__:
        if base.__name__.startswith("_"):
            yield from known_bases(base)
        elif base.__name__ not in ("object", "ABC", "Generic", "Protocol"):
            yield base


def skip_foreign(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Leave out what other projects put into our classes, such as scikit-learn's requests for metadata."""
    module = getattr(obj, "__module__", None)
    foreign = inspect.isfunction(obj) and module and not module.startswith(("tacbench_cad", "housing"))
    return True if foreign else None


def complete(app: Sphinx, what: str, name: str, obj: type, options: object, lines: list[str]) -> None:
    """Name the bases of a class, and keep Napoleon from taking words before a colon for the type of an attribute."""
    if what in ("class", "exception") and (bases := [restify(base, "smart") for base in known_bases(obj)]):
        lines[:0] = [f"Bases: {', '.join(bases)}", ""]
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]


def tidy(app: Sphinx, doctree: nodes.document) -> None:
    """Leave out a constant's value where it would fill the page, and links to what has no page here."""
    for node in list(doctree.findall(addnodes.desc_annotation)):
        if node.astext().startswith(" = ") and len(node.astext()) > MOST_LETTERS:
            node.parent.remove(node)
    for link in list(doctree.findall(addnodes.pending_xref)):
        target = link["reftarget"]
        known = target == "None" or any(isinstance(vars(one).get(target), type) for one in (builtins, np))
        if link["refdomain"] == "py" and (known or OTHERS.match(target)):
            link.replace_self(link.children)


def link_public_name(
    app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, content: nodes.TextElement
) -> nodes.Element | None:
    """Link a public name, ``tacbench_cad.lab.Run``, to the page of the module that defines it."""
    package, _, name = node["reftarget"].rpartition(".")
    package = package or node.get("py:module")
    target = public_names(package).get(name) if node["refdomain"] == "py" and package in PUBLIC else None
    if target is None:
        return None
    return env.domains["py"].resolve_xref(env, node["refdoc"], app.builder, node["reftype"], target, node, content)


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect all of it."""
    app.connect("missing-reference", link_public_name)
    app.add_directive("modules", Modules)
    app.add_post_transform(CodeLinks)
    app.connect("source-read", tables_of_modules)
    app.connect("builder-inited", write_module_pages)
    app.connect("autodoc-process-signature", shorten)
    app.connect("autodoc-skip-member", skip_foreign)
    app.connect("autodoc-process-docstring", complete, priority=400)
    app.connect("doctree-read", tidy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
