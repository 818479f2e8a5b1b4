"""The connection of a running ``tacbench acquire`` to the process that serves its page.

The process reads the run folders and the progress file, and sends the messages of the page. If it ends, the run goes
on: a pause ends, and questions are asked in the terminal.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path

from tacbench_cad.lab.acquire import Person, PressProgress, ProgressFile, is_label
from tacbench_cad.lab.study import Press, PrintedBlock
from tacbench_cad.util.errors import InputError, MissingToolError
from tacbench_cad.util.packages import require
from tacbench_cad.util.processes import safe_children

#: The longest time until the page has an address, and from the end of the run to the end of the page's process, in s.
START_S, END_S = 60.0, 10.0
#: The interval in which a waiting run looks for signals, in s.
WAIT_S = 0.05


class PageLink(PressProgress):
    """The page as a person who puts blocks in, and as progress updates that wait while the run is paused.

    Args:
        connection: The connection to the process that serves the page; see
            :func:`tacbench_cad.extensions.watch.serving.served`.
        file: The progress file.
        terminal: The person in the terminal, who is asked if the page has ended.
        say: Shows a message.
    """

    is_asked_always = True

    def __init__(
        self, connection: Connection, file: ProgressFile, terminal: Person, say: Callable[[str], None]
    ) -> None:
        self.connection, self.file, self.terminal, self._say = connection, file, terminal, say
        self._asked: tuple[str, str] | None = None  # the label of the block, and the name of its run
        self._is_in = threading.Event()
        self._running = threading.Event()
        self._running.set()
        self._gone = self._closing = False
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def before(self, press: Press, check: Callable[[], None]) -> None:
        """Wait while the run is paused."""
        while not self._running.wait(WAIT_S):
            check()

    def put_in(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """See :class:`~tacbench_cad.lab.acquire.person.Person`. The page confirms the block."""
        where = "the holder" if slot is None else f"slot {slot}"
        self._is_in.clear()
        self._asked = (label, printed.name)
        if not self._gone:
            self._say(f"put {label} into {where}, and type its label on the page")
        while not self._gone and not self._is_in.wait(WAIT_S):
            pass
        self._asked = None
        if not self._is_in.is_set():
            self.terminal.put_in(printed, label, slot)

    def first_touch(self, printed: PrintedBlock, positions: int) -> tuple[float, ...]:
        """See :class:`~tacbench_cad.lab.acquire.person.Person`. Heights are typed in the terminal."""
        return self.terminal.first_touch(printed, positions)

    def press_anyway(self, problem: str) -> bool:
        """See :class:`~tacbench_cad.lab.acquire.person.Person`. The question is asked in the terminal."""
        return self.terminal.press_anyway(problem)

    def close(self) -> None:
        """Let the process end. The page gets the outcome of the run before."""
        self._closing = True
        with suppress(OSError):
            self.connection.send("end")
        self._listener.join(END_S)

    def _listen(self) -> None:
        """Receive the messages of the page until its process ends."""
        with suppress(EOFError, OSError):
            while True:
                self._obey(*self.connection.recv())
        # The message comes first, because a waiting question is asked in the terminal as soon as the page is gone.
        if not self._closing:
            self._say("the page has ended; the run goes on")
        self._gone = True
        self._pause(False)

    def _obey(self, do: str, label: str) -> None:
        if do == "stop":
            press_ctrl_c()
        elif do == "in":
            asked = self._asked
            if asked is not None and is_label(label, *asked):  # an older question may still be open on another page
                self._is_in.set()
        elif do in ("pause", "continue"):
            self._pause(do == "pause")

    def _pause(self, paused: bool) -> None:
        if paused == self._running.is_set():
            (self._running.clear if paused else self._running.set)()
            self.file.write("paused", paused=paused)


def press_ctrl_c() -> None:
    """Do the same as Ctrl-C in the terminal: the main thread gets SIGINT, also in the middle of a move."""
    if hasattr(signal, "pthread_kill"):
        main = threading.main_thread().ident
        assert main is not None
        signal.pthread_kill(main, signal.SIGINT)
    else:
        signal.raise_signal(signal.SIGINT)


@contextmanager
def opened_page(
    folder: Path,
    *,
    port: int,
    host: str,
    browser: bool,
    file: ProgressFile,
    terminal: Person,
    say: Callable[[str], None],
) -> Iterator[PageLink]:
    """Start the process that serves the page, and end it after the body.

    Args:
        folder: The folder of the runs.
        port: The port; 0 for a free one.
        host: The address at which the page can be watched. It has its buttons only at 127.0.0.1.
        browser: Whether the page is opened in the browser.
        file: The progress file.
        terminal: The person in the terminal.
        say: Shows a message.

    Raises:
        InputError: The address or the port cannot be used.
        MissingToolError: The process could not be started.
    """
    require("the page", "starlette", "uvicorn", "websockets")
    from tacbench_cad.extensions.watch.serving import served

    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with safe_children():
        process = context.Process(target=served, args=(theirs, folder.absolute(), port, host, browser), daemon=True)
        process.start()
    theirs.close()
    try:
        addresses = _first_message(ours)
        if isinstance(addresses, str):
            raise InputError("page", None, addresses)
        say("open {}\nfor others, who can only watch: {}".format(*addresses))
        link = PageLink(ours, file, terminal, say)
        try:
            yield link
        finally:
            link.close()
    finally:
        process.join(END_S)
        process.kill()


def _first_message(connection: Connection) -> tuple[str, str] | str:
    """Wait for the addresses of the page with its buttons and of the page that only watches, or why there is none."""
    try:
        if connection.poll(START_S):
            message: tuple[str, str] | str = connection.recv()
            return message
    except EOFError:  # the process has ended
        pass
    raise MissingToolError("the page could not be started; leave out --page, or look at the message above")
