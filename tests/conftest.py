"""Shared by all tests: the switch between small and full counts."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the full counts that the issues name")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--long"):
        return
    skip = pytest.mark.skip(reason="full counts: run with --long (make test-long)")
    for item in items:
        if "long" in item.keywords:
            item.add_marker(skip)
