"""The process that serves the watch page, for ``tacbench watch`` and for ``tacbench acquire --page``.

It has a lower priority than the run, so that it does not slow a press.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from tacbench_cad.extensions.serving.server import serve
from tacbench_cad.extensions.watch.app import LOOK_S, Order, WatchPage
from tacbench_cad.extensions.watch.model import Watched
from tacbench_cad.util.errors import InputError, one_line

#: The increase of the niceness of the process.
NICENESS = 10
#: The time in which the page still gets the outcome of a run that has ended, in s.
LAST_S = 5.0 * LOOK_S


def watch(
    folder: Path,
    *,
    port: int,
    host: str,
    browser: bool,
    announce: Callable[..., None],
    order: Callable[[Order], None] | None = None,
    end: threading.Event | None = None,
) -> None:
    """Serve the watch page of a folder.

    Args:
        folder: A run folder, or a folder of run folders.
        port: The port; 0 for a free one.
        host: The address on which the server listens.
        browser: Whether the page is opened in the browser.
        announce: See :func:`tacbench_cad.extensions.serving.server.serve`; a page that takes messages has buttons.
        order: Receives the messages of the page; None if the page only watches.
        end: An event that ends the server.

    Raises:
        InputError: The address or the port cannot be used.
    """
    with contextlib.suppress(AttributeError, OSError):  # Windows has no niceness
        os.nice(NICENESS)
    _use_one_thread()
    page = WatchPage(Watched(folder), order)
    where: dict[str, Any] = {"port": port, "host": host, "browser": browser}
    serve(page.routes, **where, announce=announce, end=end, has_buttons=order is not None)


def _use_one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def launched() -> None:
    """Serve the page for ``tacbench acquire --page``, whose process is at the other end of the standard streams.

    The first line of the standard input has the settings. The standard output gets lines of JSON: the addresses of the
    page (``address`` and ``watch``) or why there is none (``refused``), then the messages of the page. What a library
    prints goes to the standard error. The process ends when its standard input ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the run, and the end of the run ends this process
    with os.fdopen(os.dup(1), "w") as channel:
        os.dup2(2, 1)
        _serve(channel)


def _serve(channel: TextIO) -> None:
    """Serve the page; its messages go to the channel."""

    def tell(**values: object) -> None:
        with contextlib.suppress(OSError):  # the run has ended
            print(json.dumps(values), file=channel, flush=True)

    settings = json.loads(sys.stdin.readline())
    end = threading.Event()
    threading.Thread(target=_end_with_input, args=(end,), daemon=True).start()
    try:
        watch(
            Path(settings["folder"]),
            port=settings["port"],
            host=settings["host"],
            browser=settings["browser"],
            announce=lambda address, watching: tell(address=address, watch=watching),
            order=lambda order: tell(**vars(order)),
            end=end,
        )
    except InputError as error:
        tell(refused=one_line(error))


def _end_with_input(end: threading.Event) -> None:
    while sys.stdin.readline():
        pass
    time.sleep(LAST_S)
    end.set()
