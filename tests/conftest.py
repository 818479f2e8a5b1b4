"""Shared by all tests: the switch between small and full counts."""

from __future__ import annotations

import signal

import pytest

# Started in the background of a shell without job control, a process ignores interruptions, and so does all that it
# starts: the tests that interrupt a command would wait for nothing.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the full counts too (make test-long)")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--long"):
        return
    full = [item for item in items if "long" in item.keywords]
    config.hook.pytest_deselected(items=full)
    items[:] = [item for item in items if "long" not in item.keywords]
