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

from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.web.server import serve
from tacbench_cad.web.watch.app import LOOK_S, Order, WatchPage
from tacbench_cad.web.watch.model import Watched

#: The increase of the niceness of the process.
NICENESS = 10
#: The time in which the page still gets the outcome of a run that has ended, in s.
LAST_S = 5.0 * LOOK_S


def watch(
    folder: Path,
    station: str = "",
    *,
    port: int,
    host: str,
    browser: bool,
    announce: Callable[[str], None],
    order: Callable[[Order], None] | None = None,
    end: threading.Event | None = None,
) -> None:
    """Serve the watch page of a folder.

    Args:
        folder: A run folder, or a folder of run folders.
        station: The name of the rig whose session is shown, if several rigs write to the folder.
        port: The port; 0 for a free one.
        host: The address on which the server listens.
        browser: Whether the page is opened in the browser.
        announce: Receives the address of the page.
        order: Receives the messages of the page; None if the page only watches.
        end: An event that ends the server.

    Raises:
        InputError: The address or the port cannot be used.
    """
    with contextlib.suppress(AttributeError, OSError):  # Windows has no niceness
        os.nice(NICENESS)
    _use_one_thread()
    page = WatchPage(Watched(folder, station), order)
    serve(page.routes, port=port, host=host, browser=browser, announce=announce, end=end)


def _use_one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def launched() -> None:
    """Serve the page for ``tacbench acquire --page``, whose process is at the other end of the standard streams.

    The first line of the standard input has the settings. The standard output gets lines of JSON: the address of the
    page (``address``) or why there is none (``refused``), then the messages of the page. The process ends when its
    standard input ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the run, and the end of the run ends this process
    settings = json.loads(sys.stdin.readline())
    end = threading.Event()
    threading.Thread(target=_end_with_input, args=(end,), daemon=True).start()
    try:
        watch(
            Path(settings["folder"]),
            settings["station"],
            port=settings["port"],
            host=settings["host"],
            browser=settings["browser"],
            announce=lambda address: _tell(address=address),
            order=lambda order: _tell(**vars(order)),
            end=end,
        )
    except InputError as error:
        _tell(refused=one_line(error))


def _tell(**values: object) -> None:
    with contextlib.suppress(OSError):  # the run has ended
        print(json.dumps(values), flush=True)


def _end_with_input(end: threading.Event) -> None:
    while sys.stdin.readline():
        pass
    time.sleep(LAST_S)
    end.set()
