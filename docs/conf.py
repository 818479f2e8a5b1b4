"""Sphinx's settings for the manual. Its pages are plain Markdown; ``renew.py`` runs the code in them."""

from __future__ import annotations

import sys
from importlib.metadata import distribution
from pathlib import Path

from sphinx.application import Sphinx

from tacbench_cad import __version__

# The folder of renew.py, which the extension uses, and the folder of the extension.
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent / "_ext")]

project = "tacbench-cad"
author = "The tacbench-cad authors"
copyright = "the tacbench-cad authors, MIT licence"
release = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.mathjax",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "reference",
]
exclude_patterns = ["_build"]
nitpicky = True
# A single capital is a type variable. The names of other projects are no links: see _ext/reference.py.
# Bounds of numbers in annotations are no classes.
nitpick_ignore_regex = [
    ("py:class", r"tacbench_cad\..*\.[A-Z]"),
    ("py:class", r"types\.FrameType|pd\.DataFrame"),
    ("py:class", r"-?(inf|\d+(\.\d+)?(e-?\d+)?)"),
]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

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


#: The table of contents beside every page.
CONTENTS = {
    "Begin": ("start", "gallery", "view", "questions"),
    "Print": (
        "print-set",
        "block",
        "outlines",
        "holder",
        "jig",
        "coupon",
        "textures",
        "design",
        "sources",
        "plates",
        "scan",
        "compensate",
    ),
    "Press": (
        "first-rig",
        "rig",
        "devices",
        "run",
        "slide",
        "watch",
        "runs",
        "your-frames",
        "own-data",
        "simulation",
        "simulation-model",
    ),
    "Analyse": ("analysis", "series", "networks", "numbers", "columns", "regions", "share"),
    "Script and extend": ("scripting", "cad", "any-part", "any-mesh", "freecad", "extending", "simulators"),
    "Background": ("paper", "accuracy", "measured"),
    "Reference": ("commands", "study-file", "api/index"),
}


def add_contents(app: Sphinx, name: str, source: list[str]) -> None:
    """Add the table of contents to the first page."""
    if name == "index":
        for title, pages in CONTENTS.items():
            listed = "\n".join(pages)
            source[0] += f"\n```{{toctree}}\n:caption: {title}\n:maxdepth: 1\n:hidden:\n{listed}\n```\n"


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the table of contents."""
    app.connect("source-read", add_contents)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
