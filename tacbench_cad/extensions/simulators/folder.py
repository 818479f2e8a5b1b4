"""The folder of a texture. It is written completely or not at all, and never contains files of another texture."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.extensions.simulators import SIMULATOR_TARGETS, SimulatorTarget
from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.geometry import block_spec
from tacbench_cad.spec import Block, SampleGrid
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.files import TEMPORARY_PREFIX, locked, refusing, sha256
from tacbench_cad.util.untrusted import read_document

#: The description of the folder for programs: the block, and the files and the note of each target.
RECORD = "texture.json"
#: The description of the folder for people.
README = "README.md"
#: The keys that identify a block. All other keys of its description follow from these.
IDENTITY = (
    *("texture", "unit", "waves", "spline", "preset", "scale", "size_mm", "height_mm", "mm_per_unit", "domain"),
    *("sampling", "key_mm", "label", "copy"),
)
_NEW, _OLD = f"{TEMPORARY_PREFIX}new-", f"{TEMPORARY_PREFIX}old-"


@dataclass(frozen=True, kw_only=True)
class Exported:
    """The result of an export: one folder.

    Args:
        texture: The name of the texture.
        folder: The folder.
        files: The files written by this export: their paths relative to the folder, and their sizes in bytes.
    """

    texture: str
    folder: Path
    files: dict[str, int]


def export_to_simulators(blocks: Iterable[Block], targets: Sequence[str], out: Path) -> list[Exported]:
    """Export blocks to simulators. Each texture gets the folder ``out/NAME``.

    If a folder already contains the same block, the targets are added or replaced, and all other files are kept. All
    folders are checked before the first file is written.

    Args:
        blocks: The blocks, each with a different texture.
        targets: Names of :data:`tacbench_cad.extensions.simulators.SIMULATOR_TARGETS`.
        out: The parent of the textures' folders. It is created if it does not exist.

    Returns:
        One item for each texture, in the order of the blocks.

    Raises:
        InputError: A target is unknown, a block cannot be exported, a folder contains another texture or other files,
            or a folder cannot be written.
    """
    if not targets:
        one_of("to", "", SIMULATOR_TARGETS)
    chosen = [SIMULATOR_TARGETS[one_of("to", name, SIMULATOR_TARGETS)] for name in dict.fromkeys(targets)]
    assets = [SimulatorAsset(block) for block in blocks]
    with locked(out):
        _recover(out)
        for asset in assets:
            _record_of(out / asset.name, asset)
        return [_write(asset, chosen, out) for asset in assets]


def _recover(out: Path) -> None:
    """Clean up after an export that did not end: restore folders that were moved aside, remove unfinished folders."""
    for old in out.glob(f"{_OLD}*"):
        folder = out / old.name.removeprefix(_OLD)
        if folder.exists():
            shutil.rmtree(old, ignore_errors=True)
        else:
            old.rename(folder)
    for new in out.glob(f"{_NEW}*"):
        shutil.rmtree(new, ignore_errors=True)


def _described(block: Block) -> dict[str, Any]:
    """Return the description of a block as it is written to the record."""
    plain: dict[str, Any] = json.loads(json.dumps(block_spec(block)))
    return plain


def _record_of(folder: Path, asset: SimulatorAsset) -> dict[str, Any]:
    """Return the record of the targets that the folder already contains.

    Raises:
        InputError: The path is not a folder, or the folder contains other files or another texture.
    """
    if not folder.exists():
        return {}
    if not folder.is_dir():
        raise InputError("out", str(folder), "is a file; move it or choose another --out")
    record = folder / RECORD
    if not record.exists():
        if any(folder.iterdir()):
            raise InputError("out", str(folder), f"contains files but no {RECORD}; empty it or choose another --out")
        return {}
    try:
        document = read_document(record, "out", "json")
        block, targets = document["block"], document["targets"]
        what = f"{block['texture']}, preset {block['preset']}, scale {block['scale']:g}"
        known = {name: targets[name] for name in SIMULATOR_TARGETS if name in targets}
        for target in known.values():
            _ = [*target["files"]], target["note"] + ""
    except (InputError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            "out", str(record), f"is not a record of export-simulator ({error}); remove the folder"
        ) from None
    own = _described(asset.block)
    differs = [key for key in IDENTITY if block.get(key) != own.get(key)]
    if differs:
        raise InputError(
            "out",
            str(folder),
            f"contains another texture ({what}; different: {', '.join(differs)}); remove it or choose another --out",
        )
    return known


def _write(asset: SimulatorAsset, targets: Sequence[SimulatorTarget], out: Path) -> Exported:
    folder = out / asset.name
    new, old = out / f"{_NEW}{asset.name}", out / f"{_OLD}{asset.name}"
    record = _record_of(folder, asset)
    with refusing(out):
        try:
            new.mkdir()
            files = _fill(asset, targets, record, folder, new)
            if folder.exists():
                folder.rename(old)
            new.rename(folder)
        finally:
            _recover(out)
    return Exported(texture=asset.name, folder=folder, files=files)


def _fill(
    asset: SimulatorAsset, targets: Sequence[SimulatorTarget], record: dict[str, Any], folder: Path, new: Path
) -> dict[str, int]:
    """Write the targets into the new folder, and copy the files of other targets and of the user from the old one."""
    replaced = {README, RECORD}
    for target in targets:
        replaced.update(record.pop(target.name, {}).get("files", {}))
    kept = {file for target in record.values() for file in target["files"]}
    for path in sorted(folder.rglob("*")) if folder.exists() else ():
        place = path.relative_to(folder).as_posix()
        if path.is_file() and (place not in replaced or place in kept):
            (new / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, new / place)
    written: dict[str, int] = {}
    for target in targets:
        result = target.write(asset, new)
        hashes = {file: sha256(new / file) for file in result.files}
        record[target.name] = {"version": __version__, "files": hashes, "note": result.note}
        written.update({file: (new / file).stat().st_size for file in result.files})
    ordered = {name: record[name] for name in SIMULATOR_TARGETS if name in record}
    document = {"tacbench_cad": __version__, "block": _described(asset.block), "targets": ordered}
    (new / RECORD).write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    sections = [(SIMULATOR_TARGETS[name].title, target["note"]) for name, target in ordered.items()]
    (new / README).write_text(_readme(asset, sections), encoding="utf-8")
    return written


def _readme(asset: SimulatorAsset, sections: Iterable[tuple[str, str]]) -> str:
    """Return the text of README.md.

    Args:
        asset: The block.
        sections: The title and the note of each target.
    """
    block = asset.block
    x, y = block.size_mm
    ux, uy, uz = block.mm_per_unit
    (u0, u1), (v0, v1) = block.domain
    lines = [
        f"# {asset.name}",
        "",
        f"A tactile texture block, preset {block.preset}, scale {block.scale:g}, by tacbench-cad {__version__}.",
        "",
        f"- Formula: z = {block.texture.equation}, for u from {u0:g} to {u1:g} and v from {v0:g} to {v1:g}.",
        f"- Scale: one unit of u, v and z is {ux:.6g}, {uy:.6g} and {uz:.6g} mm.",
        f"- Block: {x:g} x {y:g} x {block.height_mm:g} mm. The relief is {block.relief_mm:.4g} mm high, and the base "
        f"below it {block.base_mm:.4g} mm.",
        "- Block frame: the origin is at the lower corner of the underside, x and y run along the sides, and z points "
        f"up. The underside is at z = 0, the highest point at {block.height_mm:g} mm.",
        "- Every file uses the block frame. The units and the up axis depend on the format and are named below.",
        f"- Height in mm at (x, y) in mm: {block.datum_mm:.9g} + {uz:.6g} * formula({u0:g} + x / {ux:.9g}, "
        f"{v0:g} + y / {uy:.9g}).",
    ]
    if isinstance(block.sampling, SampleGrid):
        lines.append(
            f"- This preset joins {block.sampling.nx} x {block.sampling.ny} samples by straight lines, as the "
            f"published files do.{' These are too few samples for the finest waves.' if block.grid_aliases else ''} "
            "The errors below are the differences between that surface and the formula."
        )
    for title, note in sections:
        lines += ["", f"## {title}", "", note.rstrip("\n")]
    lines += ["", "`texture.json` has the same information for programs, and the SHA-256 checksum of each file."]
    return "\n".join(lines) + "\n"
