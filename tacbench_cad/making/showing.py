"""The scene of ``tacbench view``: the parts of a request in their places of use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.making.planning import FileSource
from tacbench_cad.making.request import PARTS, Request, plan
from tacbench_cad.render.viewing.page import write_page
from tacbench_cad.render.viewing.scene import Facts, Scene, Thing, block_thing
from tacbench_cad.spec.texture_files import find_textures
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError, MissingToolError
from tacbench_cad.util.processes import why_not_importable
from tacbench_cad.util.text import report_rows


def request_of(words: Sequence[str], options: Request) -> Request:
    """Return the request for the words after ``tacbench view``.

    Args:
        words: Numbers or names of textures, TOML files, ``blocks``, ``holder``, ``jig``, ``coupon``; empty for the
            complete set.
        options: All other options.

    Raises:
        InputError: A word is unknown.
    """
    textures: list[Texture] = []
    parts: list[str] = []
    for word in words:
        if word in PARTS:
            parts.append(word)
        else:
            textures += find_textures((word,), options.preset, others=PARTS)
    if not words:
        return replace(options, textures=("all",), parts=None)
    if textures:
        parts.append("blocks")
    return replace(options, textures=tuple(textures) or ("all",), parts=tuple(parts))


def write_view(request: Request, path: Path | str, progress: Callable[[str], None] = lambda message: None) -> Scene:
    """Write an HTML page with the parts of a request in 3D.

    Args:
        request: The options. The formats are ignored.
        path: The HTML file.
        progress: Receives the name of each part before it is built.

    Returns:
        The scene on the page.

    Raises:
        InputError: An option is not allowed, or the file cannot be written.
        MissingToolError: The request names a fixture, and the CAD packages are missing or do not load.
    """
    scene = scene_of(request, progress)
    write_page(scene, Path(path))
    return scene


def scene_of(request: Request, progress: Callable[[str], None] = lambda message: None) -> Scene:
    """Build the meshes of a request's parts and place them; same arguments as for :func:`write_view`."""
    work = plan(replace(request, formats=("stl",)))
    if work.needs_kernel:
        progress("loading the CAD kernel")
        reason = why_not_importable(work.needs_kernel)
        if reason is not None:
            message = f"the CAD kernel does not load ({reason}); tacbench doctor shows the repair"
            if request.parts is not None:
                raise MissingToolError(message)
            work = work.without_kernel(message)
    # Each holder forms a set with its blocks and its jig. This includes the holder of a jig that is shown alone.
    holders: list[Any] = []
    for source in work.sources:
        holder = getattr(source.thing, "holder", None)
        if holder is not None and holder not in holders:
            holders.append(holder)
    things = []
    for i, source in enumerate(work.sources):
        progress(source.part.name)
        things.append(_thing(source, i, holders))
    if not things:
        raise InputError("parts", None, "nothing can be shown: " + "; ".join(left.reason for left in work.left_out))
    return Scene(things=tuple(things), left_out=tuple((left.what, left.reason) for left in work.left_out))


def _thing(source: FileSource, number: int, holders: Sequence[Any]) -> Thing:
    """Return a part of the scene in its place of use; a block is in the holder that it fits."""
    part, thing = source.part, source.thing
    if part.block is not None:
        silhouettes = [holder.block.silhouette for holder in holders]
        if part.block.silhouette not in silhouettes:
            return block_thing(part, np.eye(4), None, 0)
        held = silhouettes.index(part.block.silhouette)
        places = holders[held].block_placements()
        slot = number % len(places)
        return block_thing(part, places[slot].matrix, held, slot)
    mesh, from_print = part.mesh[0], getattr(thing, "from_print", None)
    holder = getattr(thing, "holder", None)
    facts: Facts = tuple(row for row in report_rows(str(thing)).items() if row[0] != "name")
    placed = mesh if from_print is None else mesh.transformed(from_print)
    return Thing(
        name=part.name,
        kind=part.kind,
        title=part.title,
        mesh=placed,
        to_world=np.eye(4),
        set_number=None if holder is None else holders.index(holder),
        facts=facts,
    )
