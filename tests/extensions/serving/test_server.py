"""The server of a page: it answers only requests with the token that come from its own page on this machine."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the design page needs the extra web")
pytest.importorskip("httpx2", reason="the test client of Starlette needs httpx2")

from starlette.applications import Starlette
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocket, WebSocketDisconnect

from tacbench_cad.extensions.serving.server import Guard, bound_socket, file_routes, framed, in_url
from tacbench_cad.util.errors import InputError

TOKEN, PORT = "a-token-of-the-test", 8080
HERE = {"host": f"127.0.0.1:{PORT}"}


async def echo(socket: WebSocket) -> None:
    await socket.accept()
    await socket.send_text(await socket.receive_text())
    await socket.close()


@pytest.fixture(scope="module")
def client() -> TestClient:
    routes = [*file_routes("tacbench_cad.extensions.design", "page.html", "page.css"), WebSocketRoute("/socket", echo)]
    routes.append(Route("/frame.html", lambda request: framed("<title>in a frame</title>")))
    return TestClient(Guard(Starlette(routes=routes), TOKEN, PORT))


def test_the_page_is_served_with_a_policy_that_forbids_all_other_addresses(client: TestClient) -> None:
    for path, kind in (("", "text/html"), ("page.css", "text/css")):
        answer = client.get(f"/{TOKEN}/{path}", headers=HERE)
        assert (answer.status_code, answer.headers["content-type"].partition(";")[0]) == (200, kind)
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        assert set(re.findall(r"\w+://[\w.:]+", policy)) == {f"ws://127.0.0.1:{PORT}", f"ws://localhost:{PORT}"}
        assert answer.headers["cache-control"] == "no-store"
        assert answer.headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize(
    "path", ["/", f"/{TOKEN[:-1]}/", f"/{TOKEN}x/", "/%F0%9F%98%80/", f"//{TOKEN}/", "/x/../page.css"]
)
def test_a_request_without_the_token_is_refused(client: TestClient, path: str) -> None:
    answer = client.get(path, headers=HERE)
    assert answer.status_code == 403
    assert TOKEN not in answer.text


def test_the_address_for_the_browser_works_once() -> None:
    client = TestClient(
        Guard(Starlette(routes=file_routes("tacbench_cad.extensions.design", "page.html")), TOKEN, PORT, once="x")
    )
    assert client.get("/x/", headers=HERE).status_code == 403
    assert client.get("/x", headers={"host": "evil.example"}).status_code == 403
    answer = client.get("/x", headers=HERE, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (307, f"/{TOKEN}/")
    assert client.get(f"/{TOKEN}/", headers=HERE).status_code == 200
    refused = client.get("/x", headers=HERE, follow_redirects=False)
    assert refused.status_code == 403 and TOKEN not in refused.text


@pytest.mark.parametrize(
    "host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1", "127.0.0.1:80", f"127.0.0.1.evil:{PORT}"]
)
def test_a_request_to_another_name_is_refused(client: TestClient, host: str) -> None:
    assert client.get(f"/{TOKEN}/", headers={"host": host}).status_code == 403


def test_both_names_of_this_machine_are_allowed(client: TestClient) -> None:
    for name in ("127.0.0.1", "localhost"):
        host = f"{name}:{PORT}"
        headers = {"host": host, "origin": f"http://{host}"}
        assert client.get(f"/{TOKEN}/", headers=headers).status_code == 200


@pytest.mark.parametrize(("host", "name"), [("192.168.1.20", "192.168.1.20"), ("fd00::7", "[fd00::7]")])
def test_at_another_address_only_this_address_is_allowed(host: str, name: str) -> None:
    routes = file_routes("tacbench_cad.extensions.watch", "page.html", "page.css", "page.js")
    client = TestClient(Guard(Starlette(routes=routes), TOKEN, PORT, host))
    there = {"host": f"{name}:{PORT}", "origin": f"http://{name}:{PORT}"}
    answer = client.get(f"/{TOKEN}/", headers=there)
    assert answer.status_code == 200
    assert f"ws://{name}:{PORT};" in answer.headers["content-security-policy"]
    assert in_url(host) == name
    for other in (HERE, {"host": f"localhost:{PORT}"}, there | {"origin": "http://evil.example"}):
        assert client.get(f"/{TOKEN}/", headers=other).status_code == 403


@pytest.mark.parametrize("path", ["page.js", "../server.py", "app.py", "..%2f..%2fserver.py", "%2e%2e/__init__.py"])
def test_no_other_file_is_served(client: TestClient, path: str) -> None:
    assert client.get(f"/{TOKEN}/{path}", headers=HERE).status_code in (403, 404)


def test_the_page_cannot_be_changed(client: TestClient) -> None:
    for method in ("post", "put", "delete"):
        assert getattr(client, method)(f"/{TOKEN}/", headers=HERE).status_code == 405


def test_a_socket_needs_the_origin_of_the_page(client: TestClient) -> None:
    origin = {"origin": f"http://127.0.0.1:{PORT}"}
    with client.websocket_connect(f"/{TOKEN}/socket", headers=HERE | origin) as connection:
        connection.send_text("hello")
        assert connection.receive_text() == "hello"
    refused: list[tuple[str, dict[str, str]]] = [
        ("/socket", HERE | origin),
        (f"/{TOKEN}/socket", HERE),
        (f"/{TOKEN}/socket", HERE | {"origin": "http://evil.example"}),
        (f"/{TOKEN}/socket", HERE | {"origin": f"http://localhost:{PORT}"}),
        (f"/{TOKEN}/socket", HERE | {"origin": "null"}),
        (f"/{TOKEN}/socket", {"host": f"evil.example:{PORT}", "origin": f"http://evil.example:{PORT}"}),
    ]
    for path, headers in refused:
        with pytest.raises(WebSocketDisconnect) as closing, client.websocket_connect(path, headers=headers):
            pass
        assert closing.value.code == 1008


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_does_not_exist_is_refused(port: int) -> None:
    with pytest.raises(InputError, match="must be from 0 to 65535"):
        bound_socket(port)


@pytest.mark.parametrize(
    ("host", "message"),
    [
        ("0.0.0.0", "means all networks; give one address of this machine"),
        ("::", "means all networks"),
        ("192.0.2.77", "is not an address of this machine"),
        ("no such name", "is not an address of this machine"),
    ],
)
def test_an_address_that_is_not_one_of_this_machine_is_refused(host: str, message: str) -> None:
    with pytest.raises(InputError, match=f"host = '{host}': {message}"):
        bound_socket(0, host)


def test_a_used_port_is_refused() -> None:
    with bound_socket(0) as first:
        address: tuple[Any, ...] = first.getsockname()
        assert address[0] == "127.0.0.1"
        with pytest.raises(InputError, match=rf"port = {address[1]}: cannot be used: .+; choose another"):
            bound_socket(address[1])


def test_the_command_ends_with_0_when_it_is_interrupted(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tacbench_cad", "design", "2", "--no-browser", "-o", str(tmp_path / "out")]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env=os.environ | {"TMPDIR": str(tmp_path)}
    ) as process:
        assert process.stderr is not None
        first = process.stderr.readline()
        address = re.fullmatch(r"open http://127\.0\.0\.1:(\d+)/([\w-]{30,})/\n", first)
        assert address, first
        with socket.create_connection(("127.0.0.1", int(address[1])), timeout=20) as connection:
            connection.sendall(f"GET /{address[2]}/ HTTP/1.1\r\nHost: 127.0.0.1:{address[1]}\r\n\r\n".encode())
            assert connection.recv(20).startswith(b"HTTP/1.1 200")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == 0
        assert process.stderr.read() == "press Ctrl-C to end\n"
    assert list(tmp_path.iterdir()) == [], (
        "no files are left, and the folder of the files is made when files are written"
    )
