"""The process that serves the watch page, for ``tacbench watch`` and for ``tacbench acquire --page``.

It has a lower priority than the run, so that it does not slow a press.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

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
    import cv2

    cv2.setNumThreads(1)
    page = WatchPage(Watched(folder), order)
    where: dict[str, Any] = {"port": port, "host": host, "browser": browser}
    serve(page.routes, **where, announce=announce, end=end, has_buttons=order is not None)


def served(connection: Connection, folder: Path, port: int, host: str, browser: bool) -> None:
    """Serve the page for ``tacbench acquire --page``, in a process of its own.

    Args:
        connection: The connection to the run. It gets the two addresses of the page, or the reason why there is none,
            and then each message of the page: what to do and a label. The process ends when the run sends something or
            closes the connection.
        folder: See :func:`watch`; likewise the others.
        port: Likewise.
        host: Likewise.
        browser: Likewise.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the run, and the end of the run ends this process
    os.dup2(2, 1)  # what a library prints is no output of the run
    end = threading.Event()
    threading.Thread(target=_end_with_run, args=(connection, end), daemon=True).start()

    def tell(message: tuple[str, ...] | str) -> None:
        with contextlib.suppress(OSError):  # the run has ended
            connection.send(message)

    try:
        watch(
            folder,
            port=port,
            host=host,
            browser=browser,
            announce=lambda *addresses: tell(addresses),
            order=lambda order: tell((order.do, order.label)),
            end=end,
        )
    except InputError as error:
        tell(one_line(error))


def _end_with_run(connection: Connection, end: threading.Event) -> None:
    with contextlib.suppress(EOFError, OSError):
        connection.recv()
    time.sleep(LAST_S)
    end.set()
