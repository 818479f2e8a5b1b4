"""Texture files and the design page: the textures to start from, the controls of a file, and the file of a state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tacbench_cad.extensions.design.model import PERIOD, RECTANGLE, Design
from tacbench_cad.spec import (
    LATER_NAMES,
    NAMED,
    PICTURES,
    VALUES,
    SplineSurface,
    built_in_name,
    texture_of_document,
    texture_path,
    unknown_texture,
    with_table,
)
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import decimal
from tacbench_cad.util.untrusted import parse_toml, read_text

_HALF_TURN = round(math.pi, 6)
_WAVES = {"family": "equation1", "A1": 1.0, "A2": 0.0, "f1": 1.0, "f2": 1.0, "phase": math.pi / 2.0}
_TRIANGLE = {"family": "series", "law": "triangle", "N": 25, "axes": "xy"}
_SQUARE = {**_TRIANGLE, "law": "square"}
#: The textures to start from: the tables ``[texture]`` and ``[[wave]]`` of a file.
STARTS: dict[str, tuple[Mapping[str, Any], tuple[Mapping[str, Any], ...]]] = {
    "texture 1": (_WAVES, ()),
    "texture 2": ({**_WAVES, "A2": 1.0}, ()),
    "texture 3": (_TRIANGLE, ()),
    "texture 4": (_SQUARE, ()),
    "texture 5": ({**_TRIANGLE, "axes": "x"}, ()),
    "texture 6": ({**_SQUARE, "axes": "x"}, ()),
    "three waves": (
        {"family": "plane-waves"},
        tuple(
            {"amplitude": 0.5, "f": f, "g": g, "phase": math.pi / 2.0}
            for f, g in ((1.0, 0.0), (-0.5, math.sqrt(0.75)), (-0.5, -math.sqrt(0.75)))
        ),
    ),
    **{name: ({"family": "sum", "of": [name], "weights": [1.0]}, ()) for name in LATER_NAMES},
}
#: The wave that the page adds to a sum of waves.
NEW_WAVE = {"amplitude": 0.3, "f": 2.0, "g": 0.0, "phase": 0.0}
#: The largest number of waves that have controls. A file may have more, which keep their values.
MAX_CONTROLLED = 12

#: The length of the longer side of a height map that does not say its size, in mm.
IMAGE_MM = 30.0

#: The controls of the keys of a texture file: label, lowest and highest value of the slider, and step.
_KEYS: dict[str, tuple[str, float, float, float]] = {
    "A1": ("Amplitude A1 along x", 0.0, 3.0, 0.01),
    "A2": ("Amplitude A2 along y", 0.0, 3.0, 0.01),
    "f1": ("Frequency f1 along x", 0.0, 12.0, 0.05),
    "f2": ("Frequency f2 along y", 0.0, 12.0, 0.05),
    "phase": ("Phase (rad)", -_HALF_TURN, _HALF_TURN, 0.01),
    "N": ("N, highest harmonic", 1, 101, 2),
    "amplitude": ("Amplitude", 0.0, 2.0, 0.01),
    "f": ("Frequency f along x", -12.0, 12.0, 0.05),
    "g": ("Frequency g along y", -12.0, 12.0, 0.05),
    "angle_deg": ("Direction (degrees)", -180.0, 180.0, 1),
    "wavelength": ("Wavelength (units)", 0.2, 20.0, 0.05),
    "wavelength_mm": ("Wavelength (mm)", 0.2, 20.0, 0.05),
    "mm_per_pixel": ("Distance of pixels (mm)", 0.005, 0.5, 0.001),
    "smooth_mm": ("Smoothing (mm)", 0.0, 2.0, 0.01),
    "turn_deg": ("Turned by (degrees)", -180.0, 180.0, 1),
}
_WORDS = {
    "law": ("Law of the amplitudes", ("triangle", "square")),
    "axes": ("Direction", ("x", "y", "xy")),
}


def start(name: str) -> Design:
    """Return the state at the beginning, with one of :data:`STARTS`.

    Raises:
        InputError: There is no such texture.
    """
    texture, wave = STARTS[one_of("texture", name, STARTS)]
    design = Design(texture=texture, wave=wave)
    if name == "three waves":  # regular hexagons need the same scale along both sides
        design = replace(design, period_mm=(2.4 * math.pi, 2.4 * math.pi))
    return design


def first_state(word: str) -> tuple[Design, str]:
    """Return the state for a word of the command line, and its name in :data:`STARTS`, which is empty for a file.

    Raises:
        InputError: The word is not the number or the name of a texture, and not a readable texture file.
    """
    names = {name.replace(" ", "-"): name for name in STARTS}
    name = names.get(built_in_name(word) or word.lower().replace(" ", "-"))
    if name is not None:
        return start(name), name
    if (path := texture_path(word)) is not None:
        return opened(read_text(path, "texture", "toml"), word, path.parent), ""
    raise unknown_texture(word, others=list(names))


def opened(text: str, name: str, folder: Path | None = None) -> Design:
    """Return the state for the text of a texture file.

    Args:
        text: The text.
        name: The name of the file, for error messages.
        folder: The folder of the file; None if it is not known.

    Raises:
        InputError: The file is not a texture file, or it names other files and its folder is not known.
    """
    return design_of(parse_toml(text, "texture", name), name, folder)


def design_of(document: Mapping[str, Any], name: str, folder: Path | None = None) -> Design:
    """Return the state for the tables of a texture file; same arguments and errors as for :func:`opened`."""
    table = document.get("texture")
    tables = table if isinstance(table, Mapping) else {}
    draft = Design(texture={key: value for key, value in tables.items() if key != "name"}, folder=folder or Path())
    if draft.files and folder is None:
        raise InputError(name, None, f'names other files: start the command with it, "tacbench design {name}"')
    draft.require_files()
    texture = texture_of_document(document, f"{name}: ", draft.folder)
    paper = VALUES["paper"]
    surface = texture.surface
    size, unit, (u, v), _ = with_table(paper, texture.block, surface)
    if surface.unit == "mm":  # the page keeps the waves of the file, and therefore also its units
        unit = tuple(document.get("block", {}).get("mm_per_unit") or unit)
        u, v = u / unit[0], v / unit[1]
    return replace(
        draft,
        name=texture.name,
        wave=tuple(document.get("wave", ())),
        size_mm=size,
        height_mm=texture.block.height_mm or paper.height_mm,
        period_mm=(PERIOD * unit[0], PERIOD * unit[1]),
        unit_mm=unit[2],
        shift=(u, v),
        outline=texture.block.outline or RECTANGLE,
    )


def of_image(folder: Path, file: str) -> Design:
    """Return the state for a height map whose longer side becomes :data:`IMAGE_MM` long.

    Args:
        folder: The folder of the file.
        file: Its name.

    Raises:
        InputError: The file is not a height map.
    """
    table: dict[str, Any] = {"name": "my-texture", "family": "image", "file": file, "mm_per_pixel": 1.0}
    if Path(file).suffix.lower() in PICTURES:
        table["height_mm"] = [0.0, 1.0]
    surface = texture_of_document({"texture": table}, folder=folder).surface
    assert isinstance(surface, SplineSurface)
    longest = max(high - low for low, high in (surface.u.ends, surface.v.ends))
    table |= {"mm_per_pixel": float(f"{IMAGE_MM / longest:.4g}"), "smooth_mm": 0.0}
    return design_of({"texture": table}, file, folder)


def controls(design: Design) -> list[dict[str, Any]]:
    """Return the controls of a state in groups, for the page."""
    groups = [("Formula", [row for key, value in design.texture.items() for row in _of_key(design, key, value)])]
    for i, wave in enumerate(design.wave[:MAX_CONTROLLED]):
        keys = dict.fromkeys(key for key in ("amplitude", *wave, "phase") if key in _KEYS)
        rows = [_slider(["wave", i, key], *_KEYS[key], wave.get(key, 0.0)) for key in keys]
        groups.append((f"Wave {i + 1}", rows))
    if design.texture.get("family") != "image":
        groups.append(("Scale of the formula", _scale(design)))
    groups.append(
        (
            "Block",
            [
                *(
                    _slider(["size_mm", i], f"Length along {axis} (mm)", 5.0, 100.0, 0.1, value)
                    for i, (axis, value) in enumerate(zip("xy", design.size_mm, strict=True))
                ),
                {"path": ["outline"], "label": "Outline", "words": _outlines(design), "value": design.outline},
                _slider(["height_mm"], "Height (mm)", 2.0, 30.0, 0.1, design.height_mm),
                _slider(["tolerance_mm"], "Tolerance (mm)", 0.001, 0.1, 0.001, design.tolerance_mm),
            ],
        )
    )
    return [{"title": title, "rows": rows} for title, rows in groups if rows]


def _outlines(design: Design) -> list[str]:
    """Return the words of the outlines, with that of the state if it has sizes."""
    return list(dict.fromkeys((RECTANGLE, "disc", "ring", *NAMED, design.outline)))


def _scale(design: Design) -> list[dict[str, Any]]:
    """Return the controls of the millimetres per unit and of the point at the corner of the block."""
    axes = list(enumerate("xy"))
    return [
        _slider(["unit_mm"], "Height of one unit (mm)", 0.05, 3.0, 0.01, design.unit_mm),
        *(
            _slider(["period_mm", i], f"Wavelength for frequency 1, {axis} (mm)", 0.5, 40.0, 0.01, design.period_mm[i])
            for i, axis in axes
        ),
        *(
            _slider(["shift", i], f"Shift along {axis} (rad)", -_HALF_TURN, _HALF_TURN, 0.01, design.shift[i])
            for i, axis in axes
        ),
    ]


def fixed_controls(design: Design) -> list[dict[str, Any]]:
    """Return the controls that do not belong to the texture: nozzle and cut."""
    return [
        _slider(["nozzle_mm"], "Nozzle (mm)", 0.1, 1.2, 0.05, design.nozzle_mm),
        _slider(["cut_at"], "Position of the cut (0 to 1)", 0.0, 1.0, 0.005, design.cut_at),
    ]


def _of_key(design: Design, key: str, value: Any) -> list[dict[str, Any]]:
    """Return the control of a key of the table ``[texture]``, or nothing for a key without a control."""
    if key in _WORDS:
        label, words = _WORDS[key]
        return [{"path": ["texture", key], "label": label, "words": list(words), "value": value}]
    if key == "weights":
        return [
            _slider(["texture", key, i], f"Weight {i + 1}", -2.0, 2.0, 0.01, weight)
            for i, weight in enumerate(value[:MAX_CONTROLLED])
        ]
    if key == "height_mm":
        return [
            _slider(["texture", key, i], f"Height of the {name} value (mm)", -2.0, 4.0, 0.01, value[i])
            for i, name in enumerate(("lowest", "highest"))
        ]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return []
    if key == "N" and design.texture.get("terms") == "count":
        return [_slider(["texture", key], "N, number of terms", 1, 51, 1, value)]
    label, low, high, step = _KEYS.get(key, (key, 0.0, 2.0 * abs(value) or 1.0, (abs(value) or 1.0) / 100.0))
    return [_slider(["texture", key], label, low, high, step, value)]


def _slider(path: list[str | int], label: str, low: float, high: float, step: float, value: float) -> dict[str, Any]:
    """Return a slider whose range contains its value."""
    return {
        "path": path,
        "label": label,
        "low": min(low, value),
        "high": max(high, value),
        "step": step,
        "value": value,
    }


def toml(design: Design) -> str:
    """Return the texture file of a state, with a comment that has the command for its files.

    Raises:
        InputError: The state is not a texture.
    """
    import tomlkit  # imported here, because it is needed only when the page shows or stores the file

    name = design.formula.name
    block = {key: value for key, value in vars(design.block_table).items() if value is not None}
    command = f"tacbench make --texture {name}.toml --parts blocks --tolerance {decimal(design.tolerance_mm)}"
    texture = {"name": name, **design.texture}
    tables = {"texture": texture, "wave": list(design.wave), "block": block}
    return f"# {command}\n{tomlkit.dumps({key: value for key, value in tables.items() if value})}"
