"""Sphinx's settings for the manual. The build runs every code cell, each page in an empty folder of its own."""

from __future__ import annotations

import os
import sys
from functools import partial
from importlib.metadata import distribution
from pathlib import Path

import nbclient
from docutils import nodes
from jupyter_cache.executors import utils as execution
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

from tacbench_cad import __version__

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
# Cells call ``tacbench`` as a reader does; tables are as wide as a page of the manual.
# Pages are made side by side: a command in a cell keeps to one processor, and does not load the CAD kernel in several.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ.update(COLUMNS="110", OPENBLAS_NUM_THREADS="1", PYTHON_CPU_COUNT="1")
# Jupyter's kernel asks programs for colours; what they print here is for a page, not for a terminal.
os.environ.update(TTY_COMPATIBLE="0", _TYPER_FORCE_DISABLE_TERMINAL="1")
os.environ["BASH_ENV"] = str(Path(__file__).parent / "_ext" / "cells.bash")
os.environ["TACBENCH_EXAMPLES"] = str(Path(__file__).parent.parent / "examples")
# Output comes in pieces of 100 bytes. nbclient merges them; myst-nb's own merging would break the line after each.
execution.executenb = partial(nbclient.execute, coalesce_streams=True, store_widget_state=False)

project = "tacbench-cad"
author = "The tacbench-cad authors"
copyright = "the tacbench-cad authors, MIT licence"
release = __version__
extensions = [
    "myst_nb",
    "sphinx.ext.mathjax",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "commands",
    "reference",
]
exclude_patterns = ["_build"]
nitpicky = True
# A single capital is a type variable. The names of other projects are no links: see _ext/reference.py.
# Bounds of numbers in annotations are no classes.
nitpick_ignore_regex = [("py:class", r"tacbench_cad\..*\.[A-Z]"), ("py:class", r"-?(inf|\d+(\.\d+)?(e-?\d+)?)")]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_execution_timeout = 1200

# The reference is made from the code by _ext/reference.py, a page a module.
autodoc_default_options = {"members": True, "special-members": "__call__"}
autodoc_member_order = "bysource"
napoleon_use_ivar = True
add_module_names = False
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = f"tacbench-cad {release}"
html_copy_source = False
# MathJax comes from a Python package: nothing is loaded from a network.
html_static_path = [
    "_static",
    str(distribution("sphinx-mathjax-offline").locate_file("sphinx-mathjax-offline/static/mathjax/tex-svg-full.js")),
]
html_css_files = ["manual.css", "reference.css"]
mathjax_path = "tex-svg-full.js"


def show_what_a_reader_types(app: Sphinx, doctree: nodes.document) -> None:
    """Show a cell that is run by ``%%bash`` as the commands in it, and one of ``%%writefile`` as the file."""
    for block in doctree.findall(nodes.literal_block):
        first, _, rest = block.astext().partition("\n")
        magic, _, argument = first.partition(" ")
        if magic not in ("%%bash", "%%writefile"):
            continue
        suffix = Path(argument).suffix
        block["language"] = "bash" if magic == "%%bash" else {"": "text", ".txt": "text"}.get(suffix, suffix[1:])
        block.rawsource = rest
        block.children = [nodes.Text(rest)]
        if magic == "%%writefile":
            block.parent.insert(0, nodes.paragraph(argument, argument, classes=["caption"]))


def spread_what_takes_long(app: Sphinx, env: BuildEnvironment, docnames: list[str]) -> None:
    """Put pages with cells among those of the reference: each worker gets ten names that follow each other."""
    with_cells = [name for name in docnames if "/" not in name]
    reference = [name for name in docnames if "/" in name]
    share = len(reference) // max(len(with_cells), 1) + 1
    docnames[:] = [
        name for i, page in enumerate(with_cells) for name in (page, *reference[i * share : (i + 1) * share])
    ]


def setup(app: Sphinx) -> None:
    """Connect what is ours."""
    app.connect("env-before-read-docs", spread_what_takes_long)
    app.connect("doctree-read", show_what_a_reader_types)
