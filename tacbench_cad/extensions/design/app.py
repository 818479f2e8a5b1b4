"""The questions of the design page and the answers of the server.

The page sends a :class:`Question` as JSON to the path ``ask``, and the bytes of a height map to ``upload``. Answers are
JSON texts, except a picture; see :func:`tacbench_cad.extensions.design.model.picture`.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from tacbench_cad.extensions.design.document import (
    NEW_WAVE,
    STARTS,
    controls,
    fixed_controls,
    of_image,
    opened,
    start,
    toml,
)
from tacbench_cad.extensions.design.model import Design, facts, picture
from tacbench_cad.extensions.serving.server import file_routes, framed
from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry import Mesh
from tacbench_cad.making import build
from tacbench_cad.render import Scene, SceneFormula, Thing, page_of
from tacbench_cad.spec import PICTURES, TABLES
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import InputError, TacbenchError, one_line
from tacbench_cad.util.files import replacing
from tacbench_cad.util.untrusted import parse_json

#: The largest size of the JSON text of a message, in bytes.
MAX_TEXT = 1_000_000
#: The endings of height maps that the page accepts.
IMAGES = (*PICTURES, *TABLES, ".npy")
#: The content of the 3D page until the first picture of the block is there: one triangle.
PLACEHOLDER = Scene(
    things=(
        Thing(
            name="block",
            kind="block",
            title="the block",
            mesh=Mesh(np.eye(3), np.array([[0, 1, 2]], dtype=np.int32)),
            to_world=np.eye(4),
            set_number=None,
            facts=(),
            formula=SceneFormula(
                equation="", datum_mm=0.0, waves=None, range_mm=(0.0, 1.0), bound_mm=1.0, scale_mm=1.0
            ),
        ),
    )
)


@dataclass(frozen=True, kw_only=True)
class Question:
    """A message of the page.

    Args:
        do: What to do.
        design: The state of the page; None before the first texture is chosen.
        text: A texture file (open), the name of a texture (start).
        name: The name of the opened file.
        formats: The formats of the files to write.
        count: The number of waves.
    """

    do: Literal["hello", "start", "open", "waves", "picture", "facts", "toml", "write"]
    design: Design | None = None
    text: str = ""
    name: str = "texture.toml"
    formats: tuple[str, ...] = ()
    count: Annotated[int, Interval(ge=1, le=100)] = 1


class DesignPage:
    """The page and the folder that it writes to.

    Args:
        out: The folder of the files. The page cannot choose another.
        uploads: A folder for the height maps that the user drops on the page.
        first: The state at the beginning.
        name: The name of that state in :data:`tacbench_cad.extensions.design.document.STARTS`; empty for a file.
    """

    def __init__(self, out: Path, uploads: Path, first: Design, name: str = "") -> None:
        self._out, self._uploads, self._first, self._start = out, uploads, first, name
        # A state names its height map, because every tab, and every state of a tab, can have another.
        self._folders = {"": first.folder}
        self._slow = threading.Lock()

    @property
    def routes(self) -> list[BaseRoute]:
        """The routes of the page."""
        return [
            *file_routes("tacbench_cad.extensions.design", "page.html", "page.css", "page.js"),
            Route("/block.html", lambda request: framed(page_of(PLACEHOLDER)), methods=["GET"]),
            Route("/ask", self._respond, methods=["POST"]),
            Route("/upload", self._respond, methods=["POST"]),
        ]

    async def _respond(self, request: Request) -> Response:
        """Answer a question, or keep a height map. The name of the height map is in the address."""
        data, name = await request.body(), request.query_params.get("name")
        try:
            if name is not None:
                return JSONResponse(await asyncio.to_thread(self.upload, name, data))
            answer = await asyncio.to_thread(self.answer, question_of(data))
        except Exception as error:  # also a fault of this program, or of the system: the page says so and goes on
            unexpected = "" if isinstance(error, TacbenchError) else f"unexpected error: {type(error).__name__}: "
            return JSONResponse({"error": f"{unexpected}{one_line(error, 200)}"})
        return Response(answer) if isinstance(answer, bytes) else JSONResponse(answer)

    def _state_of(self, question: Question) -> Design:
        """Return the state of the page, with the folder of its files."""
        if question.design is None:
            raise InputError("design", None, "is missing")
        folder = self._folders.get(question.design.upload)
        if folder is None:
            raise InputError("upload", question.design.upload, "is unknown; open the height map again")
        return replace(question.design, folder=folder)

    def upload(self, given: str, content: bytes) -> dict[str, Any]:
        """Keep a height map and return the state that shows it.

        Args:
            given: The name of the file.
            content: Its bytes.

        Raises:
            InputError: The file has an unknown ending, or is not a height map.
        """
        name = re.sub(r"[^A-Za-z0-9._-]", "_", given)[-100:].lstrip(".-")
        if Path(name).suffix.lower() not in IMAGES:
            raise InputError("height map", given, f"must end in {', '.join(IMAGES)}")
        folder = Path(tempfile.mkdtemp(dir=self._uploads))
        (folder / name).write_bytes(content)
        state = of_image(folder, name)
        self._folders[folder.name] = folder
        return _state(replace(state, upload=folder.name))

    def answer(self, question: Question) -> dict[str, Any] | bytes:
        """Return the answer to a question.

        Raises:
            TacbenchError: The question asks for something that is not possible.
        """
        answers: dict[str, Callable[[], dict[str, Any] | bytes]] = {
            "picture": lambda: picture(self._state_of(question)),
            "hello": lambda: {
                **_state(self._first),
                "starts": list(STARTS),
                "start": self._start,
                "fixed": fixed_controls(self._first),
                "out": str(self._out),
                "formats": {name: row.why_missing() for name, row in FORMATS.items()},
            },
            "start": lambda: _state(start(question.text)),
            "open": lambda: _state(opened(question.text, question.name)),
            "waves": lambda: _state(_with_waves(self._state_of(question), question.count)),
            "facts": lambda: {"facts": facts(self._state_of(question))},
            "toml": lambda: {"toml": toml(self._state_of(question)), "name": f"{self._state_of(question).name}.toml"},
            "write": lambda: self._write(self._state_of(question), question.formats),
        }
        with self._slow if question.do in ("facts", "write") else contextlib.nullcontext():  # slow answers, one by one
            return answers[question.do]()

    def _write(self, design: Design, formats: tuple[str, ...]) -> dict[str, Any]:
        """Write the files of the block, and its texture file."""
        sources = {f"{design.name}.toml": toml(design).encode()}
        design.require_files()
        for name in design.files:
            sources[name] = (design.folder / name).read_bytes()
            path = self._out / name
            if path.exists() and path.read_bytes() != sources[name]:
                raise InputError(
                    "output file",
                    str(path),
                    "already has another content, and a texture file may name it; rename yours, or move this away",
                )
        result = build(design.request(formats=formats, out=self._out))
        for name, content in sources.items():
            path = self._out / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as temporary:
                temporary.write_bytes(content)
        return {
            "files": [*(str(row["file"]) for row in result.rows), *sources],
            "failed": [f"{failure.file}: {'; '.join(failure.faults)}" for failure in result.failures],
        }


def question_of(message: bytes) -> Question:
    """Return the question in a message of the page.

    Raises:
        InputError: The message is not a question.
    """
    if len(message) > MAX_TEXT:
        raise InputError("message", None, f"may have at most {MAX_TEXT:,} bytes")
    return from_plain(Question, parse_json(message, "message", "of the page"))


def _with_waves(design: Design, count: int) -> Design:
    """Return the state with this number of waves: the first of its own, or its own and new ones."""
    if design.texture.get("family") != "plane-waves":
        raise InputError("waves", count, "can be changed only in a texture of the family plane-waves")
    return replace(design, wave=(*design.wave, *[NEW_WAVE] * count)[:count])


def _state(design: Design) -> dict[str, Any]:
    """Return a state with its controls."""
    return {"design": to_plain(design), "groups": controls(design)}
