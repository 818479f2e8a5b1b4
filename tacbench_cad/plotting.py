"""Drawing with matplotlib in a style of our own, whatever the user's settings say."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from tacbench_cad.errors import MissingToolError


@contextlib.contextmanager
def only_style(what: str, style: Mapping[str, Any]) -> Iterator[None]:
    """Draw with matplotlib's own defaults and these changes to them; afterwards all is as it was.

    Args:
        what: What is drawn, for the message where matplotlib is missing: ``pictures``.
        style: Changes to matplotlib's defaults.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise MissingToolError(f'{what} need matplotlib: pip install "tacbench-cad[plot]"') from None
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, "backend": matplotlib.rcParams["backend"], **style}):
        yield
