"""Frames without contact for runs that have none, which are mostly imported runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tacbench_cad.lab.runs import IMAGE_SUFFIXES, Run, RunWriter, decoded
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.untrusted import read_bytes


def add_references(runs: Sequence[Run], path: Path) -> list[Run]:
    """Store frames without contact with the runs that have none, which are mostly imported runs.

    Args:
        runs: The runs.
        path: An image, or a folder of images.

    Returns:
        All runs, with their frames without contact.

    Raises:
        InputError: There is no image, an image cannot be read or has another size, or no run lacks such frames.
    """
    without = [run for run in runs if not run.references]
    if not without:
        raise InputError("reference", str(path), "is not needed: every run has frames without contact")
    files = sorted(file for file in path.iterdir() if file.suffix in IMAGE_SUFFIXES) if path.is_dir() else [path]
    if not files:
        raise InputError("reference", str(path), f"contains no image ({', '.join(IMAGE_SUFFIXES)})")
    frames = []
    for file in files:
        try:
            frames.append(decoded(read_bytes(file, "reference", "image")))
        except CheckFailedError as error:
            raise InputError("reference", str(file), str(error)) from None
        for run in without:
            if frames[-1].shape != run.info.frame_shape:
                shapes = f"has shape {frames[-1].shape}, but the frames of {run.folder} have {run.info.frame_shape}"
                raise InputError("reference", str(file), shapes)
    for run in without:
        fields = {column.lower() for column in run.targets.header}  # the column pose_Rx is the field pose_rx
        with RunWriter.open(run.folder, run.info, durable=False, optional=fields) as writer:
            for frame in frames:
                writer.reference(frame, None)
    return [Run.open(run.folder) for run in runs]
