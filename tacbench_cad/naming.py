"""How numbers stand in file names, labels and reports."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def decimal(value: float) -> str:
    """The shortest decimals that give the number back exactly, without an exponent: ``0.5``, ``1``, ``0.00001``."""
    return np.format_float_positional(value, trim="-")


def report(title: str, lines: Mapping[str, str]) -> str:
    """A dimension report: the title, then one aligned line for each entry."""
    width = max(len(name) for name in lines)
    return "\n".join([title, *(f"  {name:<{width}}  {value}" for name, value in lines.items())])


def mm(*values: float) -> str:
    """Lengths for people: ``45.6 x 52.3 x 7.47 mm``."""
    return " x ".join(f"{value:.6g}" for value in values) + " mm"
