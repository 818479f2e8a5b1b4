"""The API reference: generate a page for each public module, and turn public names in the pages into links."""

from __future__ import annotations

import ast
import builtins
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from functools import cache, reduce
from operator import or_
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, get_args, get_origin

import numpy as np
from annotated_types import Ge, Interval, Len
from docutils import nodes
from numpy.typing import ArrayLike, NDArray
from renew import MODULE, summary_of
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
from tacbench_cad.util.types import Floats

GENERATED = Path("api") / "generated"
#: The packages that load their public names from other modules when they are used.
PUBLIC = tuple(
    ".".join((package.__name__, *stub.relative_to(folder).parent.parts))
    for package in (housing, tacbench_cad)
    for folder in map(Path, package.__path__)
    for stub in sorted(folder.rglob("__init__.pyi"))
)
#: The length in characters above which the value of a constant is not shown.
MAX_VALUE_LENGTH = 300
#: Names of other projects. They are not links, because they have no pages here and the build uses no network.
OTHERS = re.compile(
    r"(abc|argparse|collections|concurrent|contextlib|datetime|functools|importlib|multiprocessing|pathlib|random|re|socket"
    r"|subprocess|threading|typing|annotated_types|build123d|cadquery|cv2|dask|distributed|jinja2|joblib|lib3mf|manifold3d"
    r"|matplotlib|numpy|OCP|pandas|pymeshlab|serial|shapely|sklearn|starlette|tomlkit)\."
)


def public_modules() -> list[str]:
    """Return the names of all modules that a user may import, without the commands, which have their own page."""
    names = []
    for package in (housing, tacbench_cad):
        modules = pkgutil.walk_packages(package.__path__, f"{package.__name__}.", onerror=importlib.import_module)
        names += [package.__name__, *(module.name for module in modules)]
    return [name for name in names if not re.search(r"\._|^tacbench_cad\.cli\b|\.(\w*command|completing)$", name)]


class Arrays:
    """A replacement for ``NDArray``, which shows an array in an annotation as ``NDArray[float64]``."""

    def __class_getitem__(cls, kind: type) -> type:
        """Return a type with the name of these arrays."""
        return type(f"NDArray[{kind.__name__}]", (), {"__module__": "numpy.typing"})


def short(value: Any) -> Any:
    """Return a value of a module. A type that contains arrays is replaced by a type with the names in the code."""
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
    """Import a module together with the names that it imports only for type hints, so that these become links."""
    module = importlib.import_module(name)
    vars(module).update({key: short(value) for key, value in vars(module).items() if not key.startswith("_")})
    # A dataclass repeats the annotations of the fields that it inherits, which are written with these names.
    for bound in (Annotated, Ge, Interval, Len):
        vars(module).setdefault(bound.__name__, bound)
    vars(module).setdefault("Floats", short(Floats))
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for statement in (child for child in node.body if isinstance(child, ast.Import)):
                for alias in statement.names:
                    vars(module).setdefault(alias.asname or alias.name, importlib.import_module(alias.name))
            for statement in (child for child in node.body if isinstance(child, ast.ImportFrom)):
                source = importlib.import_module(statement.module or "")
                for alias in statement.names:
                    vars(module).setdefault(alias.asname or alias.name, getattr(source, alias.name))


@cache
def public_names(package: str) -> dict[str, str]:
    """Return the public names of one of the packages ``PUBLIC``, each with the full name of its definition."""
    stub = Path(importlib.import_module(package).__file__ or "").with_suffix(".pyi")
    names = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        for alias in node.names if isinstance(node, ast.ImportFrom) and node.module else ():
            value = getattr(importlib.import_module(package), alias.name)
            module = getattr(value, "__module__", None) if inspect.isclass(value) or inspect.isfunction(value) else None
            names[alias.name] = f"{module or f'{package}.{node.module}'}.{alias.name}"
    return names


def module_page(name: str, inside: list[str]) -> str:
    """Return the page of a module: its docstring, its public names in the order of the source, and its modules.

    These pages are not in the table of contents, because 200 lines beside every page would not be useful and would take
    a minute of the build.
    """
    parent = name.rpartition(".")[0]
    path = ":doc:`API </api/index>`" + (f" / :py:mod:`{parent}`" if parent else "")
    lines = [":orphan:", "", name, "=" * len(name), "", path, "", f".. automodule:: {name}", ""]
    if name in PUBLIC:
        # The names are documented on the pages of their definitions. A second description would make links ambiguous.
        lines[-1:] = ["   :no-members:", "", ".. rubric:: Public names", ""]
        lines += [f"* :py:obj:`{word} <{target}>`" for word, target in sorted(public_names(name).items())]
        lines += [""]
    if inside:
        lines += [".. rubric:: Modules", "", ".. modules::", "", *(f"   {module}" for module in inside), ""]
    return "\n".join(lines)


def write_module_pages(app: Sphinx) -> None:
    """Write the pages of all modules, and warn if the index does not name each module exactly once."""
    folder, modules = app.srcdir / GENERATED, public_modules()
    folder.mkdir(exist_ok=True)
    for page in folder.iterdir():
        if page.stem not in modules:
            page.unlink()
    _, _, tables = (app.srcdir / "api" / "index.md").read_text(encoding="utf-8").partition("| module |")
    rows = [row["name"] for row in MODULE.finditer(tables)]
    logger = logging.getLogger(__name__)
    for name in modules:
        import_for_annotations(name)
        inside = [module for module in modules if module.rpartition(".")[0] == name]
        page, text = folder / f"{name}.rst", module_page(name, inside)
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")
        if rows.count(name) != 1:
            logger.warning("%s is in %d tables instead of 1", name, rows.count(name), location="api/index")


class Modules(SphinxDirective):
    """A directive for a table of modules, each with the first line of its docstring."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Make the table."""
        lines = [".. list-table::", "   :class: reference", ""]
        for name in self.content:
            lines += [f"   * - :py:mod:`{name}`", f"     - {summary_of(name)}"]
        return self.parse_text_to_nodes("\n".join(lines))


class CodeLinks(SphinxPostTransform):
    """Links from the pages to the reference, for a class ``Block``, a function ``build()`` or a full name."""

    default_priority = 5

    def run(self, **kwargs: Any) -> None:
        """Turn public names in code style into references."""
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
    """Return the full name of a public class, a public function with brackets, or a dotted name; None for others."""
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
    """Show dots instead of a default value that has no short text."""
    if what == "class" and arguments == "(*args, **kwargs)":
        # A metaclass of build123d hides the parameters of the class.
        arguments = stringify_signature(
            signature(obj.__init__, bound_method=True), show_return_annotation=False, unqualified_typehints=True
        )
    enums = arguments and re.sub(r"<(\w+\.\w+)>", r"\1", arguments)
    return enums and re.sub(r"=\s?<[^<>]*>", "=...", enums), returned


def known_bases(kind: type) -> Iterator[type]:
    """Yield the base classes that are useful to a user. A private class is replaced by its own base classes."""
    for base in kind.__bases__:
        if base.__name__.startswith("_"):
            yield from known_bases(base)
        elif base.__name__ not in ("object", "ABC", "Generic", "Protocol"):
            yield base


def skip_foreign(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Leave out members that other projects add to the classes, such as the metadata requests of scikit-learn."""
    module = getattr(obj, "__module__", None)
    foreign = inspect.isfunction(obj) and module and not module.startswith(("tacbench_cad", "housing"))
    return True if foreign else None


def complete(app: Sphinx, what: str, name: str, obj: type, options: object, lines: list[str]) -> None:
    """Name the bases of a class, and prevent Napoleon from reading words before a colon as the type of an attribute."""
    if what in ("class", "exception") and (bases := [restify(base, "smart") for base in known_bases(obj)]):
        lines[:0] = [f"Bases: {', '.join(bases)}", ""]
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]


def tidy(app: Sphinx, doctree: nodes.document) -> None:
    """Remove long values of constants, and links to names that have no page here."""
    for node in list(doctree.findall(addnodes.desc_annotation)):
        if node.astext().startswith(" = ") and len(node.astext()) > MAX_VALUE_LENGTH:
            node.parent.remove(node)
    for link in list(doctree.findall(addnodes.pending_xref)):
        target = link["reftarget"]
        known = target == "None" or any(isinstance(vars(module).get(target), type) for module in (builtins, np))
        if link["refdomain"] == "py" and (known or OTHERS.match(target)):
            link.replace_self(link.children)


def link_public_name(
    app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, content: nodes.TextElement
) -> nodes.Element | None:
    """Link a public name, such as ``tacbench_cad.lab.Run``, to the page of the module that defines it."""
    package, _, name = node["reftarget"].rpartition(".")
    package = package or node.get("py:module")
    target = public_names(package).get(name) if node["refdomain"] == "py" and package in PUBLIC else None
    if target is None:
        return None
    return env.domains["py"].resolve_xref(env, node["refdoc"], app.builder, node["reftype"], target, node, content)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive, the links and the handlers of events."""
    app.connect("missing-reference", link_public_name)
    app.add_directive("modules", Modules)
    app.add_post_transform(CodeLinks)
    app.connect("builder-inited", write_module_pages)
    app.connect("autodoc-process-signature", shorten)
    app.connect("autodoc-skip-member", skip_foreign)
    app.connect("autodoc-process-docstring", complete, priority=400)
    app.connect("doctree-read", tidy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
