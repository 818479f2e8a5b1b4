"""The messages between the watch page and its server.

The server sends the contents of the page as JSON whenever they change. If the page belongs to a running ``tacbench
acquire``, it may send one of four messages: ``stop``, ``pause``, ``continue``, and ``in`` with the label that its user
has read on the block in the holder and typed. It can do nothing else. A page that was opened by the address for
watching may send none.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from tacbench_cad.extensions.serving.server import file_routes
from tacbench_cad.extensions.watch.model import Watched
from tacbench_cad.lab.acquire import is_label
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError, TacbenchError, one_line
from tacbench_cad.util.untrusted import parse_json

#: The time between two looks at the run folders, in s.
LOOK_S = 0.2
#: The largest message of the page, in characters.
MAX_TEXT = 1000


@dataclass(frozen=True, kw_only=True)
class Order:
    """A message of the page.

    Args:
        do: What to do.
        label: The label of the block that is in the holder, as it was typed (``in``).
    """

    do: Literal["stop", "pause", "continue", "in"]
    label: str = ""


class WatchPage:
    """The page.

    Args:
        watched: The runs.
        order: Receives the messages of the page; None if the page only watches.
    """

    def __init__(self, watched: Watched, order: Callable[[Order], None] | None = None) -> None:
        self._watched, self._order = watched, order
        self._looking = asyncio.Lock()

    @property
    def routes(self) -> list[BaseRoute]:
        """The routes of the page."""
        return [
            *file_routes("tacbench_cad.extensions.watch", "page.html", "page.css", "page.js"),
            Route("/frame/{which}", self._frame, methods=["GET"]),
            WebSocketRoute("/socket", self._talk),
        ]

    async def _frame(self, request: Request) -> Response:
        try:
            data, kind = await asyncio.to_thread(
                self._watched.frame, request.query_params.get("run", ""), request.path_params["which"]
            )
        except TacbenchError as error:
            return PlainTextResponse(one_line(error), 404)
        return Response(data, media_type=kind)

    async def _talk(self, socket: WebSocket) -> None:
        await socket.accept()
        may_order = self._order is not None and socket.scope.get("may_order", True)
        sending = asyncio.create_task(self._send(socket, socket.query_params.get("run", ""), may_order))
        try:
            while (message := await socket.receive())["type"] == "websocket.receive":
                try:
                    self.obey(message.get("text") or "", may_order)
                except InputError as error:
                    await socket.send_text(json.dumps({"error": one_line(error)}))
        finally:
            sending.cancel()

    async def _send(self, socket: WebSocket, name: str, may_order: bool) -> None:
        """Send the contents of the page when they change."""
        last = ""
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the page was closed
            while True:
                async with self._looking:
                    state = await asyncio.to_thread(self._watched.state, name)
                text = json.dumps({"buttons": may_order, **state}, allow_nan=False)
                if text != last:
                    await socket.send_text(text)
                last = text
                await asyncio.sleep(LOOK_S)

    def obey(self, text: str, may_order: bool = True) -> None:
        """Pass a message of the page on.

        Args:
            text: The message.
            may_order: Whether the page has the buttons.

        Raises:
            InputError: The message is not one of the four, the page only watches, or the label is another one.
        """
        if len(text) > MAX_TEXT:
            raise InputError("message", len(text), f"must have at most {MAX_TEXT} characters")
        order = from_plain(Order, parse_json(text, "message", "of the page"), "message: ")
        if self._order is None or not may_order:
            raise InputError("message", order.do, "is not allowed, because this page only watches")
        if order.do == "in":
            asked = self._watched.question
            if asked is None:
                raise InputError("label", order.label, "is not needed now: no block is asked for")
            if not is_label(order.label, asked["label"], asked["run"]):
                raise InputError(
                    "label", order.label, f"is not the label of this block, which must have {asked['label']}"
                )
        self._order(order)
