"""What ``tacbench view`` shows: the parts of a request, built and put where they are used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.making.plan import Source
from tacbench_cad.making.request import PARTS, Request, plan
from tacbench_cad.render.viewing.page import write_page
from tacbench_cad.render.viewing.scene import Facts, Scene, Thing, block_thing
from tacbench_cad.spec.textures import catalogue
from tacbench_cad.util.errors import InputError, MissingToolError, nearest
from tacbench_cad.util.processes import why_not_importable
from tacbench_cad.util.text import report_rows


def request_of(words: Sequence[str], options: Request) -> Request:
    """What the words after ``tacbench view`` mean.

    Args:
        words: Numbers or names of textures, TOML files, ``blocks``, ``holder``, ``jig``, ``coupon``; none for the
            whole set.
        options: Everything else.

    Raises:
        InputError: A word means nothing.
    """
    textures, parts = [], []
    known = {word for one in catalogue(options.preset) for word in (str(one.number), one.name)} | {"all"}
    for word in words:
        if word in PARTS:
            parts.append(word)
        elif word.lower() in known or word.lower().endswith(".toml") or "/" in word or Path(word).exists():
            textures.append(word)
        else:
            names = [*PARTS, *(one.name for one in catalogue(options.preset))]
            raise InputError("parts", word, f"{nearest(word, names)}; 1 to 6 and TOML files are allowed too")
    if not words:
        return replace(options, textures=("all",), parts=None)
    if textures:
        parts.append("blocks")
    return replace(options, textures=tuple(textures) or ("all",), parts=tuple(parts))


def write_view(request: Request, path: Path | str, progress: Callable[[str], None] = lambda message: None) -> Scene:
    """Write one HTML page with the parts of a request in 3D.

    Args:
        request: The options; the formats do not matter.
        path: The page.
        progress: Receives what is being built.

    Returns:
        What is on the page.

    Raises:
        InputError: An option is not allowed, or the page cannot be written.
        MissingToolError: A fixture was asked for by name and the CAD packages are not there or do not load.
    """
    scene = scene_of(request, progress)
    write_page(scene, Path(path))
    return scene


def scene_of(request: Request, progress: Callable[[str], None] = lambda message: None) -> Scene:
    """Build the meshes of a request's parts and put them where they belong; arguments as of :func:`write_view`."""
    work = plan(replace(request, formats=("stl",)))
    if work.needs_kernel:
        progress("loading the CAD kernel")
        reason = why_not_importable(work.needs_kernel)
        if reason is not None:
            message = f"the CAD kernel does not load ({reason}); tacbench doctor shows the repair"
            if request.parts is not None:
                raise MissingToolError(message)
            work = work.without_kernel(message)
    # A set is a holder with its blocks and its jig: those shown, and those on which a shown jig sits.
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
        raise InputError("parts", None, "nothing can be shown: " + "; ".join(one.reason for one in work.left_out))
    return Scene(things=tuple(things), left_out=tuple((one.what, one.reason) for one in work.left_out))


def _thing(source: Source, number: int, holders: Sequence[Any]) -> Thing:
    """A part of the page: a block in the holder that takes it, a fixture where it is used."""
    part, thing = source.part, source.thing
    if part.block is not None:
        outlines = [holder.block.outline for holder in holders]
        if part.block.outline not in outlines:
            return block_thing(part, np.eye(4), None, 0)
        held = outlines.index(part.block.outline)
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
