"""The connection of a running ``tacbench acquire`` to the process that serves its page.

The process reads the run folders and the progress file, and sends the messages of the page. If it ends, the run goes
on: a pause ends, and questions are asked in the terminal.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tacbench_cad.lab.acquire import Person, PressProgress, ProgressFile, is_label
from tacbench_cad.lab.study import Press, PrintedBlock
from tacbench_cad.util.errors import InputError, MissingToolError, one_line
from tacbench_cad.util.packages import require

#: The longest time until the page has an address, and from the end of the run to the end of the page's process, in s.
START_S, END_S = 60.0, 10.0
#: The interval in which a waiting run looks for signals, in s.
WAIT_S = 0.05
#: The child gets exactly our module path: -P and PYTHONSAFEPATH exclude the files of the current folder.
_PROGRAM = "import sys; sys.path[:] = {path!r}; from tacbench_cad.extensions.watch.serving import launched; launched()"


class PageLink(PressProgress):
    """The page as a person who puts blocks in, and as progress updates that wait while the run is paused.

    Args:
        process: The process that serves the page.
        file: The progress file.
        terminal: The person in the terminal, who is asked if the page has ended.
        say: Shows a message.
    """

    is_asked_always = True

    def __init__(
        self, process: subprocess.Popen[str], file: ProgressFile, terminal: Person, say: Callable[[str], None]
    ) -> None:
        self.process, self.file, self.terminal, self._say = process, file, terminal, say
        self._asked: tuple[str, str] | None = None  # the label of the block, and the name of its run
        self._is_in = threading.Event()
        self._running = threading.Event()
        self._running.set()
        self._gone = self._closing = False
        self._started = threading.Event()
        self._first: dict[str, str] = {}
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def addresses(self) -> tuple[str, str]:
        """Wait for the address of the page with its buttons, and for the one of the page that only watches.

        Raises:
            InputError: The address or the port cannot be used.
            MissingToolError: The process has ended.
        """
        self._started.wait(START_S)
        if "refused" in self._first:
            raise InputError("page", None, self._first["refused"])
        if "address" not in self._first:
            raise MissingToolError("the page could not be started; leave out --page, or look at the message above")
        return self._first["address"], self._first["watch"]

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
        """End the process. The page gets the outcome of the run before."""
        self._closing = True
        assert self.process.stdin is not None
        try:
            self.process.stdin.close()
            self.process.wait(END_S)
        except (OSError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
        self._listener.join()

    def _listen(self) -> None:
        """Receive the messages of the page until its process ends."""
        assert self.process.stdout is not None
        try:
            with self.process.stdout as lines:
                for line in lines:
                    message = _message_of(line)
                    if message is None:
                        self._say(f"page: {one_line(line, 200)}")
                    elif "do" in message:
                        self._obey(message["do"], message["label"])
                    else:
                        self._first = message
                        self._started.set()
        finally:
            # The message comes first, because a waiting question is asked in the terminal as soon as the page is gone.
            if not self._closing and "address" in self._first:
                self._say("the page has ended; the run goes on")
            self._gone = True
            self._started.set()
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


def _message_of(line: str) -> dict[str, str] | None:
    """Return a message of the process; None for a line that is not one, such as a warning of a library."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    is_known = isinstance(message, dict) and set(message) in ({"do", "label"}, {"address", "watch"}, {"refused"})
    return message if is_known and all(isinstance(value, str) for value in message.values()) else None


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
    # In a session of its own, the process does not get the Ctrl-C of the terminal.
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", _PROGRAM.format(path=sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        errors="replace",
        env={**os.environ, "PYTHONSAFEPATH": "1"},
        start_new_session=True,
    )
    link = PageLink(process, file, terminal, say)
    try:
        settings = {"folder": str(folder.absolute()), "port": port, "host": host, "browser": browser}
        assert process.stdin is not None
        process.stdin.write(json.dumps(settings) + "\n")
        process.stdin.flush()
        address, watching = link.addresses()
        say(f"open {address}\nfor others, who can only watch: {watching}")
        yield link
    finally:
        link.close()
