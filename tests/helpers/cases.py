"""The cases of a test that stay in the quick run."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def mostly_long(cases: Iterable[Any], *quick: Any) -> list[Any]:
    """Mark all cases as long except ``quick``, which stand for them in the quick run."""
    cases = list(cases)
    assert all(case in cases for case in quick), "a quick case is not among the cases"
    return [
        case if case in quick else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.long)
        for case in cases
    ]
