"""The watch page without a browser: its contents, its messages, and its connection to a run."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the watch page needs the extra web")
pytest.importorskip("httpx2", reason="the test client of Starlette needs httpx2")

from helpers.rigs import FakeRig, printed, rig_settings, small_protocol, study_of
from helpers.studies import write_study
from starlette.applications import Starlette
from starlette.testclient import TestClient
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tacbench_cad.extensions.serving.server import Guard
from tacbench_cad.extensions.watch.app import Order, WatchPage
from tacbench_cad.extensions.watch.link import PageLink, opened_page
from tacbench_cad.extensions.watch.model import Watched
from tacbench_cad.lab.acquire.events import ProgressFile
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import Several
from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.rig.errors import NoAnswerError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.presses import Press, plan_presses
from tacbench_cad.util.errors import InputError, TacbenchError
from tacbench_cad.util.files import LOCK_NAME

PROTOCOL = small_protocol(repeats=1, stationary_frames=1)
TOKEN, HOST = "a-token-of-the-test", "127.0.0.1:8080"
HEADERS = {"host": HOST, "origin": f"http://{HOST}"}


class Stopping(ProgressFile):
    """A progress file whose reader looks after a number of presses of the second block; then the stage fails."""

    def __init__(self, out: Path, watched: Watched, after: int) -> None:
        super().__init__(out)
        self.watched, self.after = watched, after
        self.states: list[dict[str, Any]] = []

    def before(self, press: Press, check: Any) -> None:
        super().before(press, check)
        if press.number == self.after + 1 and self._run == printed(4).name:
            self.felt(0.5, 0.25)
            self.states.append(self.watched.state(wait=True))
            raise NoAnswerError("stage: no answer")

    def begin(self, name: str, done: int, total: int) -> None:
        super().begin(name, done, total)
        self._run = name


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Watched, dict[str, Any]]:
    """Return the folder, the reader, and the contents of the page in the middle of the second block."""
    out = tmp_path_factory.mktemp("watch") / "runs"
    watched = Watched(out)
    assert watched.state()["run"] is None
    file = Stopping(out, watched, 3)
    person = Typing(lambda prompt: prompt.split("(")[1].split(")")[0], lambda _: None)
    with pytest.raises(NoAnswerError):
        acquire_study(
            study_of(PROTOCOL, 1, 4),
            rig_settings(),
            out,
            person=person,
            progress=file,
            durable=False,
            opener=FakeRig().opener,
        )
    file.write("over", outcome="failed", message="stage: no answer")
    file.close()
    return out, watched, file.states[0]


def test_the_page_shows_the_press_that_is_under_way(session: tuple[Path, Watched, dict[str, Any]]) -> None:
    out, _, state = session
    run, running = state["run"], state["session"]
    assert state["under_way"] and running["pressing"] and running["over"] is None
    assert (running["saved"], running["planned"], running["blocks"]) == (8 + 3, 16, 2)
    assert running["run_s"] is not None and running["run_s"] <= running["study_s"]
    assert (run["name"], run["done"], run["total"]) == (printed(4).name, 3, 8)
    rows = Run.open(out / printed(4).name).rows
    assert run["newest"] == {"path": rows[2].path, "image": True}
    assert run["reference"]["path"] in [reference.path for reference in Run.open(out / run["name"]).references]
    plan = plan_presses(PROTOCOL, (1, 2), printed(4).name)
    assert run["press"] == {"number": 4, "position": plan[3].position, "target": 0.08045, "band": 0.00195}
    assert run["curve"][-1] == [-0.5, 0.25]
    assert len(run["curves"]) == len(run["points"]) == 3
    for curve, (depth, force) in zip(run["curves"], run["points"], strict=True):
        assert any(d == pytest.approx(depth, abs=2e-4) and f == pytest.approx(force, abs=2e-5) for d, f in curve)
    assert run["findings"] == [], "a run that is under way is not complete, which is no finding"
    assert [line["done"] for line in state["runs"]] == [8, 3]
    json.dumps(state, allow_nan=False)


def test_the_map_has_the_largest_error_of_each_position(session: tuple[Path, Watched, dict[str, Any]]) -> None:
    out, watched, state = session
    name = printed(1).name
    places = watched.state(name)["run"]["map"]
    assert [place["position"] for place in places] == [1, 2, 3, 4]
    assert {(place["x"], place["y"]) for place in places} == {(x, y) for x in (4.0, 9.0) for y in (18.0, 23.0)}
    bands = dict(zip(PROTOCOL.targets.forces_n, PROTOCOL.targets.bands_n, strict=True))
    for place in places:
        rows = [row for row in Run.open(out / name).rows if row.position == place["position"]]
        errors = [(row.measured_force_n - row.target_force_n) / bands[row.target_force_n] for row in rows]  # type: ignore[operator, index]
        assert place["error"] == pytest.approx(max(errors, key=abs), abs=0.01)
        assert (place["done"], place["planned"], place["now"]) == (2, 2, False)
    now = [place["position"] for place in state["run"]["map"] if place["now"]]
    assert now == [state["run"]["press"]["position"]]


def test_after_the_end_all_findings_and_the_outcome_are_shown(session: tuple[Path, Watched, dict[str, Any]]) -> None:
    out, watched, _ = session
    state = watched.state(wait=True)
    assert not state["under_way"]
    assert state["session"]["over"] == {"outcome": "failed", "message": "stage: no answer"}
    assert [finding["text"][:32] for finding in state["run"]["findings"]][:1] == ["is not complete: the run lacks 5"]
    complete = watched.state(printed(1).name, wait=True)["run"]
    expected = [{"where": each.where, "text": each.text} for each in check_run(out / printed(1).name).findings]
    assert (complete["name"], complete["findings"], complete["curves"]) == (printed(1).name, expected, [])
    assert len(complete["points"]) == 8, "the forces of a run that is over are those in its rows"


def test_the_page_works_without_the_extension_for_markers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_study(tmp_path, textures=(1,), copies=1, levels=(1,))
    monkeypatch.setitem(sys.modules, "tacbench_cad.extensions.markers", None)
    run = Watched(tmp_path).state(wait=True)["run"]
    assert run["newest"]["image"] and run["markers"] is None and run["findings"]


def test_a_damaged_run_is_named(session: tuple[Path, Watched, dict[str, Any]], tmp_path: Path) -> None:
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "run.json").write_text("{}")
    state = Watched(tmp_path).state(wait=True)
    assert "does not describe a run" in state["fault"] and state["run"] is None


def client_of(watched: Watched, order: Any = None) -> TestClient:
    return TestClient(Guard(Starlette(routes=WatchPage(watched, order).routes), TOKEN, 8080))


def test_frames_are_served_only_for_known_runs(session: tuple[Path, Watched, dict[str, Any]]) -> None:
    out, watched, _ = session
    client, name = client_of(watched), printed(1).name

    def frame(which: str, run: str) -> Any:
        return client.get(f"/{TOKEN}/frame/{which}", params={"run": run}, headers=HEADERS)

    newest = frame("newest", name)
    assert (newest.status_code, newest.headers["content-type"]) == (200, "image/png")
    assert newest.content == (out / name / Run.open(out / name).rows[-1].path).read_bytes()
    assert frame("reference", name).content == (out / name / Run.open(out / name).references[-1].path).read_bytes()
    for run in ("", "..", f"../{name}", "../../etc"):
        assert frame("newest", run).status_code == 404
    assert client.get(f"/{TOKEN}/frame/..%2f..%2frun.json", params={"run": name}, headers=HEADERS).status_code == 404


def error_of(socket: Any, text: str) -> str:
    """Send a message that is not allowed, and return the answer."""
    socket.send_text(text)
    while "error" not in (answer := json.loads(socket.receive_text())):
        pass
    assert "\n" not in answer["error"]
    return str(answer["error"])


@pytest.fixture
def asking(tmp_path: Path) -> Watched:
    """Return the runs of a session that asks for the first block."""
    file = ProgressFile(tmp_path)
    file.start(study_of(PROTOCOL, 1), 0)
    file.write("ask", run=printed(1).name, label="T1 PAPER X1 01", slot=None, picture=None)
    file.close()
    return Watched(tmp_path)


def test_the_socket_sends_the_contents_and_takes_four_messages(asking: Watched) -> None:
    orders: list[Order] = []
    with client_of(asking, orders.append).websocket_connect(f"/{TOKEN}/socket", headers=HEADERS) as socket:
        state = json.loads(socket.receive_text())
        assert state["buttons"] and state["session"]["question"]["label"] == "T1 PAPER X1 01"
        for message in ({"do": "stop"}, {"do": "pause"}, {"do": "continue"}, {"do": "in", "label": "t1 paper x101"}):
            socket.send_text(json.dumps(message))
        for text in ('{"do": "home"}', "[]", "{", '{"do": "in", "run": "x"}', "x" * 2000):
            error_of(socket, text)
    assert [order.do for order in orders] == ["stop", "pause", "continue", "in"]


def test_the_page_needs_the_typed_label_of_the_block_as_the_terminal_does(asking: Watched) -> None:
    orders: list[Order] = []
    with client_of(asking, orders.append).websocket_connect(f"/{TOKEN}/socket", headers=HEADERS) as socket:
        socket.receive_text()
        for typed in ("", "T4 PAPER X1 01", "T1", printed(4).name):
            error = error_of(socket, json.dumps({"do": "in", "label": typed}))
            assert "is not the label of this block, which must have T1 PAPER X1 01" in error
        assert orders == []
        socket.send_text(json.dumps({"do": "in", "label": printed(1).name}))
        error_of(socket, "{")
    assert len(orders) == 1
    with pytest.raises(InputError, match="no block is asked for"):
        WatchPage(Watched(asking.folder / "empty"), orders.append).obey('{"do": "in", "label": "T1 PAPER X1 01"}')


WATCHING = "a-token-to-watch"


def test_the_address_for_watching_has_no_buttons_and_takes_no_order(asking: Watched) -> None:
    orders: list[Order] = []
    app = Starlette(routes=WatchPage(asking, orders.append).routes)
    client = TestClient(Guard(app, TOKEN, 8080, watch=WATCHING, watch_at=("192.168.1.20", 8081)))
    there = {"host": "192.168.1.20:8081", "origin": "http://192.168.1.20:8081"}
    for headers in (HEADERS, there):
        with client.websocket_connect(f"/{WATCHING}/socket", headers=headers) as socket:
            state = json.loads(socket.receive_text())
            assert state["buttons"] is False and state["session"]["question"]
            for do in ("stop", "pause", "continue", "in"):
                error = error_of(socket, json.dumps({"do": do, "label": "T1 PAPER X1 01"}))
                assert "is not allowed, because this page only watches" in error
    with client.websocket_connect(f"/{TOKEN}/socket", headers=HEADERS) as socket:
        assert json.loads(socket.receive_text())["buttons"] is True
    assert client.get(f"/{TOKEN}/", headers=there).status_code == 403, "the token with the buttons stays on the machine"
    assert client.get(f"/{WATCHING}/", headers=there).status_code == 200
    assert orders == []


def test_orders_of_any_kind_never_print_a_traceback(tmp_path: Path) -> None:
    """Wrong orders, wrong frames, and clients that go away before the answer, at the real server."""
    (tmp_path / "serve.py").write_text(SERVER)
    server = subprocess.Popen(
        [sys.executable, "serve.py"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert server.stdout is not None and server.stderr is not None
    address = server.stdout.readline().strip()
    origin = address.rsplit("/", 2)[0]
    for order in ('{"do": "home"}', '{"do": ["stop"]}', "[" * 900, "null", '{"do": "\\ud800"}', b"\xff"):
        with connect(f"{address.replace('http', 'ws')}socket", origin=origin) as socket:
            socket.send(order)
            while "error" not in (answer := json.loads(socket.recv(timeout=60.0))):
                pass
            assert "Traceback" not in answer["error"]
        gone = connect(f"{address.replace('http', 'ws')}socket", origin=origin).__enter__()
        gone.send(order)
        gone.socket.shutdown(2)
        gone.socket.close()
    not_text = bytes([0x81, 0x82, 0, 0, 0, 0, 0xFF, 0xFE])  # a text frame that is not UTF-8
    for data in (not_text, None):
        with connect(f"{address.replace('http', 'ws')}socket", origin=origin) as socket:
            socket.send('{"do": "stop"}') if data is None else socket.socket.sendall(data)
            with pytest.raises(ConnectionClosed):
                while True:
                    socket.recv(timeout=60.0)
    with urllib.request.urlopen(address, timeout=60.0) as answer:
        assert answer.status == 200, "the server still works"
    server.send_signal(signal.SIGINT)
    output = server.communicate(timeout=60.0)[1]
    assert "page: RuntimeError: a fault of the program" in output.splitlines()
    assert [line for line in output.splitlines() if not line.startswith("page: ")] == []
    assert len(output.splitlines()) <= 2, "one for the fault, and one for the frame that is not UTF-8"


#: A server of a page whose order "stop" meets a fault of the program itself.
SERVER = """
from pathlib import Path
from tacbench_cad.extensions.serving.server import serve
from tacbench_cad.extensions.watch.app import WatchPage
from tacbench_cad.extensions.watch.model import Watched

def fail(order):
    raise RuntimeError("a fault of the program")

serve(WatchPage(Watched(Path("runs")), fail).routes, browser=False, announce=lambda address: print(address, flush=True))
"""


# ---- the connection to a run ----


class Page:
    """The link to a process of a page whose messages the test sends."""

    def __init__(self, out: Path) -> None:
        out.mkdir(exist_ok=True)
        self.said: list[str] = []
        self.typed: list[str] = []
        self.file = ProgressFile(out)
        self.file.start(study_of(PROTOCOL, 1), 0)
        ours, self.process = multiprocessing.Pipe()
        self.link = PageLink(ours, self.file, Typing(self._type, self.said.append), self.said.append)

    def _type(self, prompt: str) -> str:
        self.typed.append(prompt)
        return printed(1).name

    def order(self, do: str, label: str = "") -> None:
        self.process.send((do, label))


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    page = Page(tmp_path / "runs")
    yield page
    page.process.close()
    page.link.close()
    page.file.close()


def later(delay_s: float, action: Any, *values: Any) -> threading.Timer:
    timer = threading.Timer(delay_s, action, values)
    timer.start()
    return timer


PRESS = plan_presses(PROTOCOL, (1, 2), "a")[0]


def test_what_a_library_prints_in_the_process_of_the_page_is_no_output_of_the_run() -> None:
    program = """
import multiprocessing, os, pathlib, sys
from tacbench_cad.extensions.watch import serving
def watch(*_, announce, **__):
    print("a library prints", flush=True)
    os.write(1, b"another one writes\\n")
    announce("http://there/", "http://there/watch/")
serving.watch = watch
ours, theirs = multiprocessing.Pipe()
serving.served(theirs, pathlib.Path("x"), 0, "127.0.0.1", False)
assert ours.recv() == ("http://there/", "http://there/watch/")
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout == "" and result.stderr.splitlines() == ["a library prints", "another one writes"]


def test_a_pause_waits_before_the_next_press_and_a_signal_ends_it(page: Page) -> None:
    page.link.before(PRESS, lambda: pytest.fail("a run that is not paused does not wait"))
    page.order("pause")
    checks: list[float] = []
    later(0.3, page.order, "continue")
    while page.link._running.is_set():
        time.sleep(0.01)
    page.link.before(PRESS, lambda: checks.append(time.monotonic()))
    assert len(checks) > 1
    page.order("pause")
    while page.link._running.is_set():
        time.sleep(0.01)

    def interrupted() -> None:
        raise RunInterruptedError("SIGINT")

    with pytest.raises(RunInterruptedError):
        page.link.before(PRESS, interrupted)
    events = [json.loads(line) for line in page.file.path.read_text().splitlines()]
    assert [event["paused"] for event in events if event["event"] == "paused"] == [True, False, True]


def test_the_run_goes_on_if_the_process_of_the_page_dies(page: Page) -> None:
    page.order("pause")
    while page.link._running.is_set():
        time.sleep(0.01)
    closing = later(0.1, page.process.close)
    page.link.before(PRESS, lambda: None)
    page.link.put_in(printed(1), "T1 PAPER X1 01", None)
    assert page.typed == ["Its label (T1 PAPER X1 01): "], "the question is asked in the terminal"
    assert page.said[0] == "the page has ended; the run goes on"
    closing.join()


def test_stop_in_a_session_lifts_the_sensor(page: Page, tmp_path: Path) -> None:
    rig, out = FakeRig(), tmp_path / "runs"

    class StopsLater(ProgressFile):
        def felt(self, z_mm: float, force_n: float) -> None:
            if force_n > 0.05 and not stopped.is_set():
                stopped.set()
                page.order("stop")
                time.sleep(0.5)

    stopped = threading.Event()
    with pytest.raises(RunInterruptedError) as caught:
        acquire_study(
            study_of(PROTOCOL, 1),
            rig_settings(),
            out,
            person=page.link,
            progress=Several(StopsLater(tmp_path / "missing"), page.link),
            durable=False,
            opener=rig.opener,
        )
    assert caught.value.signal == "SIGINT" and caught.value.lifted
    assert rig.stage.position()[2] >= 5.0


@contextmanager
def opened(tmp_path: Path, said: list[str], **changes: Any) -> Iterator[PageLink]:
    settings = {"port": 0, "host": "127.0.0.1", "browser": False, **changes}
    file, terminal = ProgressFile(tmp_path), Typing(lambda _: "", said.append)
    with opened_page(tmp_path, file=file, terminal=terminal, say=said.append, **settings) as link:
        yield link


def test_the_real_process_gives_its_address_survives_ctrl_c_and_ends_with_the_run(tmp_path: Path) -> None:
    said: list[str] = []
    host = "127.0.0.2" if sys.platform == "linux" else "127.0.0.1"  # Linux has many addresses of its own
    before = set(multiprocessing.active_children())
    with opened(tmp_path, said, host=host):
        here, there = (line.split()[-1] for line in said[0].splitlines())
        assert said[0] == f"open {here}\nfor others, who can only watch: {there}"
        assert here.startswith("http://127.0.0.1:") and there.startswith(f"http://{host}:")
        for address, buttons in ((here, True), (there, False)):
            with urllib.request.urlopen(address, timeout=20.0) as answer:
                assert b"<title>Watch the presses" in answer.read()
            where = address.replace("http", "ws")
            with connect(f"{where}socket", origin=address.rsplit("/", 2)[0]) as socket:
                assert json.loads(socket.recv(timeout=20.0))["buttons"] is buttons
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(there.rsplit("/", 2)[0] + "/" + here.split("/")[-2] + "/", timeout=20.0)
        (process,) = set(multiprocessing.active_children()) - before
        assert process.pid is not None
        os.kill(process.pid, signal.SIGINT)
        time.sleep(1.0)
        with urllib.request.urlopen(here, timeout=20.0) as answer:
            assert answer.status == 200
    assert process.exitcode == 0 and said[1:] == []


def test_an_address_that_cannot_be_used_is_refused_before_anything_is_pressed(tmp_path: Path) -> None:
    with (
        pytest.raises(TacbenchError, match=r"page: host = '192.0.2.77': is not an address"),
        opened(tmp_path, [], host="192.0.2.77"),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_a_killed_run_left_does_not_hide_the_outcome(tmp_path: Path) -> None:
    file = ProgressFile(tmp_path)
    file.start(replace(study_of(PROTOCOL, 1)), 0)
    (tmp_path / LOCK_NAME).touch()
    path = file.path
    path.write_text(path.read_text().replace(f'"process":{os.getpid()}', '"process":999999999'))
    killed = Watched(tmp_path).state()
    assert (killed["under_way"], killed["session"]["killed"]) == (False, sys.platform != "win32")
    path.write_text(path.read_text().replace('"process":999999999', f'"process":{os.getpid()}'))
    assert Watched(tmp_path).state()["under_way"]
    file.pressed(1, Force(mean_n=0.08, spread_n=0.0, samples=1), True, tmp_path)
    file.write("over", outcome="done", message="")
    file.close()
    assert not Watched(tmp_path).state()["under_way"]
