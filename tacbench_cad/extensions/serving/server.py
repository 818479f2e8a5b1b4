"""The server of a page, which answers only those who know the token in its address.

A page in the browser must be safe from other users of the machine and from other pages in the same browser. Therefore:

- The server listens on 127.0.0.1, unless the user gives another address of the machine.
- The address contains a random token. A request without it is refused.
- A page with buttons has a second address, whose token only allows to watch. The server answers the address with the
  buttons on 127.0.0.1 only, so that its token never crosses a network, where others could read it.
- Other users of the machine can read the command line of the browser. The browser is therefore started with an address
  that works once and leads to the page.
- The header Host must name the address of the server. A page of another site that points its own name to this address
  (DNS rebinding) sends its own name.
- The header Origin, which the browser adds to the requests of a script, must be the address of this server.
- A policy in every answer forbids the browser to load anything from another address.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence
from importlib import resources
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

from tacbench_cad.util.errors import InputError, one_line

HOST = "127.0.0.1"
#: The addresses that mean all networks of the machine. A page of another site could then send any name.
_ALL_ADDRESSES = ("", "0.0.0.0", "::")
#: The largest message that a page may send, in bytes.
MAX_MESSAGE = 64_000_000
#: The media types of the files of a page.
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
#: The time in which connections are closed after Ctrl-C, in s.
_CLOSING_S = 1


class Guard:
    """The part of the server that refuses requests from elsewhere.

    Args:
        app: The application, which gets only allowed requests.
        token: The token, the first part of every path.
        port: The port of the server.
        host: The address of the server.
        once: A path that leads to the page the first time it is requested; empty for none.
        watch: A second token, which only allows to watch: the application finds ``may_order`` False in the scope of its
            requests. Empty for none.
        watch_at: The address and the port at which only this token is valid; None if there is no such address.
    """

    def __init__(
        self,
        app: ASGIApp,
        token: str,
        port: int,
        host: str = HOST,
        once: str = "",
        *,
        watch: str = "",
        watch_at: tuple[str, int] | None = None,
    ) -> None:
        self.app = app
        self._token = token.encode()
        self._once = once
        here = _names(host, port)
        self._hosts = here if watch_at is None else (*here, *_names(*watch_at))
        #: The values of the header Host with which each token is valid.
        self._valid = {self._token: here} | ({watch.encode(): self._hosts} if watch else {})
        policy = (
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self' "
            f"{' '.join(f'ws://{name}' for name in self._hosts)}; frame-src 'self'; base-uri 'none'; "
            "form-action 'none'; frame-ancestors 'none'"
        )
        self._headers = [
            (b"content-security-policy", policy.encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cache-control", b"no-store"),
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass an allowed request on, and refuse all others."""
        refusal = self._refusal(scope)
        if refusal is None and self._opens(scope):
            self._once = ""
            await RedirectResponse(f"/{self._token.decode()}/")(scope, receive, self._with_headers(send))
        elif refusal is None:
            token = _token(scope)
            scope = {**scope, "root_path": f"/{token.decode()}", "may_order": token == self._token}
            with contextlib.suppress(WebSocketDisconnect):  # the page was closed before it got its answer
                await self.app(scope, receive, self._with_headers(send))
        elif scope["type"] == "http":
            await PlainTextResponse(refusal, 403)(scope, receive, self._with_headers(send))
        else:
            await send({"type": "websocket.close", "code": 1008, "reason": refusal})

    def _opens(self, scope: Scope) -> bool:
        """Return whether this is the request for the address that works once."""
        return bool(self._once) and scope["type"] == "http" and scope["path"] == f"/{self._once}"

    def _refusal(self, scope: Scope) -> str | None:
        """Return why a request is not allowed, or None."""
        if scope["type"] not in ("http", "websocket"):
            return "This server has only pages and WebSockets."
        headers: dict[bytes, list[str]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name, []).append(value.decode("latin-1"))
        hosts = headers.get(b"host", [])
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return "The header Host must be the address and the port of this server."
        given = _token(scope)
        valid = [secrets.compare_digest(given, token) and hosts[0] in names for token, names in self._valid.items()]
        if not self._opens(scope) and not any(valid):
            return "The address has no valid token. Use the whole address that the command printed."
        origins = headers.get(b"origin", [])
        needed = scope["type"] == "websocket"
        if (needed or origins) and origins != [f"http://{hosts[0]}"]:
            return "The request comes from a page of another server."
        return None

    def _with_headers(self, send: Send) -> Send:
        """Return a function that adds the headers of security to an answer."""

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                own = {name for name, _ in message["headers"]}
                added = [header for header in self._headers if header[0] not in own]
                message = {**message, "headers": [*message["headers"], *added]}
            await send(message)

        return answer


def _names(host: str, port: int) -> tuple[str, ...]:
    """Return the values of the header Host that mean an address of the server."""
    return tuple(f"{name}:{port}" for name in ((HOST, "localhost") if host == HOST else (in_url(host),)))


def _token(scope: Scope) -> bytes:
    """Return the first part of the path of a request."""
    path: str = scope["path"]
    return path.encode("utf-8", "surrogateescape").partition(b"/")[2].partition(b"/")[0]


class _OneLine(logging.Handler):
    """Shows the faults of the server in the terminal, each in one line and without a traceback."""

    def emit(self, record: logging.LogRecord) -> None:
        error = (record.exc_info or (None, None))[1]
        shown = record.getMessage() if error is None else f"{type(error).__name__}: {error}"
        print(f"page: {one_line(shown, 200)}", file=sys.stderr)


def file_routes(package: str, page: str, *others: str) -> list[BaseRoute]:
    """Return the routes of the files of a page. No other file is served.

    Args:
        package: The Python package that contains the files.
        page: The HTML file, which has the address of the folder.
        others: The names of the other files.
    """
    folder = resources.files(package)

    def route(path: str, name: str) -> Route:
        kind = _TYPES[name[name.rindex(".") :]]

        async def answer(_: Any) -> Response:
            return Response((folder / name).read_bytes(), media_type=kind)

        return Route(path, answer, methods=["GET"])

    return [route("/", page), *(route(f"/{name}", name) for name in others)]


def framed(page: str) -> Response:
    """Return the answer with an HTML page that a page of this server shows in a frame.

    The page has its own policy in its text, which forbids it to load anything.
    """
    return HTMLResponse(page, headers={"content-security-policy": "frame-ancestors 'self'"})


def in_url(host: str) -> str:
    """Return an address as it is written in a URL: an IPv6 address gets brackets."""
    return f"[{host}]" if ":" in host else host


def bound_socket(port: int, host: str = HOST) -> socket.socket:
    """Return a socket that listens on one address of this machine.

    Args:
        port: The port; 0 for a free one.
        host: The address.

    Raises:
        InputError: The address or the port cannot be used.
    """
    if not 0 <= port <= 65535:
        raise InputError("port", port, "must be from 0 to 65535; 0 chooses a free port")
    if host in _ALL_ADDRESSES:
        raise InputError("host", host, "means all networks; give one address of this machine, such as 192.168.1.20")
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InputError("host", host, f"is not an address of this machine: {error.strerror}") from None
    listener = socket.socket(family)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRNOTAVAIL:
            raise InputError("host", host, "is not an address of this machine") from None
        raise InputError(
            "port", port, f"cannot be used: {error.strerror}; choose another, or 0 for a free port"
        ) from None
    return listener


def serve(
    routes: Sequence[BaseRoute],
    *,
    port: int = 0,
    host: str = HOST,
    browser: bool = True,
    announce: Callable[..., None] = print,
    end: threading.Event | None = None,
    has_buttons: bool = False,
) -> None:
    """Serve a page until Ctrl-C is pressed.

    Args:
        routes: The page: the result of :func:`file_routes`, and its WebSockets.
        port: The port; 0 for a free one.
        host: The address on which the server listens.
        browser: Whether the page is opened in the browser.
        announce: Receives the address of the page and, if it has buttons, the address for people who only watch.
        end: An event that ends the server.
        has_buttons: Whether the page has buttons that not everybody may use. At another address than 127.0.0.1, it can
            then only be watched.

    Raises:
        InputError: The address or the port cannot be used.
    """
    with contextlib.ExitStack() as stack:
        outside = stack.enter_context(bound_socket(port, host))
        listeners, watch, watch_at = [outside], "", None
        if has_buttons:
            watch, outside_port = secrets.token_urlsafe(24), outside.getsockname()[1]
            watch_address = f"http://{in_url(host)}:{outside_port}/{watch}/"
            if host != HOST:
                listeners.append(stack.enter_context(bound_socket(port, HOST)))
                host, watch_at = HOST, (host, outside_port)
        token, once, port = secrets.token_urlsafe(24), secrets.token_urlsafe(24), listeners[-1].getsockname()[1]
        server_address = f"http://{in_url(host)}:{port}"
        app = Starlette(routes=list(routes))
        settings = uvicorn.Config(
            Guard(app, token, port, host, once if browser else "", watch=watch, watch_at=watch_at),
            log_config=None,
            log_level="warning",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=MAX_MESSAGE,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=_CLOSING_S,
        )
        logger = logging.getLogger("uvicorn.error")
        logger.handlers, logger.propagate = [_OneLine()], False
        announce(f"{server_address}/{token}/", *([watch_address] if has_buttons else []))
        if browser:  # a browser without windows keeps the thread busy until it is closed
            threading.Thread(target=webbrowser.open, args=(f"{server_address}/{once}",), daemon=True).start()
        server = uvicorn.Server(settings)
        if end is not None:  # then a signal does not end it
            server.capture_signals = contextlib.nullcontext  # type: ignore[assignment]
            threading.Thread(target=_stop_after, args=(end, server), daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=listeners)


def _stop_after(end: threading.Event, server: uvicorn.Server) -> None:
    end.wait()
    server.should_exit = True
