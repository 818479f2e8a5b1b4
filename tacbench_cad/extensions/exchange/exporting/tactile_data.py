"""Export for TacTip toolchains: ``processed_images/`` and ``targets_images.csv``.

``tactile_learning`` reads the images in ``processed_images/`` that ``targets_images.csv`` lists. It reads the range of
the labels and the processing of the images from JSON files in the same folder.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.lab.rig import Frame, is_image
from tacbench_cad.lab.runs import Row, Run, RunInfo, cell, cells, columns, encoded, schema
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked, refusing, replacing, write_json
from tacbench_cad.util.packages import require

#: The folder in which the toolchains look for images.
PROCESSED_FOLDER = "processed_images"
#: The table in which they look for the presses.
TARGETS_IMAGES_FILE = "targets_images.csv"


#: The columns of a press's pose, in mm and degrees, and of its shear.
POSE_COLUMNS = ("pose_x", "pose_y", "pose_z", "pose_Rx", "pose_Ry", "pose_Rz")
SHEAR_COLUMNS = ("shear_x", "shear_y", "shear_z", "shear_Rx", "shear_Ry", "shear_Rz")
#: The columns that the toolchains know, which come first in the table.
TOOLCHAIN_COLUMNS = ("sensor_image", "object_label", *POSE_COLUMNS, *SHEAR_COLUMNS)


@dataclass(frozen=True, kw_only=True)
class Processing:
    """The processing of every image.

    Args:
        bbox: The lowest x and y and the highest x and y of the cropped image, in pixels; None for the largest centred
            square.
        size: The width and height after scaling, in pixels.
        grey: Whether to convert the image to grey (BT.601).
    """

    bbox: tuple[int, int, int, int] | None = None
    size: tuple[int, int] = (128, 128)
    grey: bool = True

    def __post_init__(self) -> None:
        if self.bbox is not None:
            x0, y0, x1, y1 = self.bbox
            if not (0 <= x0 < x1 and 0 <= y0 < y1):
                raise InputError("bbox", list(self.bbox), "must be X0,Y0,X1,Y1 with X0 < X1 and Y0 < Y1, from 0")
        if not all(1 <= side <= 10_000 for side in self.size):
            raise InputError("size", list(self.size), "must be from 1x1 to 10000x10000 pixels")

    def bbox_for(self, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
        """Return the crop of images of a certain shape.

        Raises:
            InputError: The crop is larger than the image.
        """
        height, width = shape[:2]
        if self.bbox is None:
            side = min(height, width)
            x, y = (width - side) // 2, (height - side) // 2
            return (x, y, x + side, y + side)
        if self.bbox[2] > width or self.bbox[3] > height:
            raise InputError("bbox", list(self.bbox), f"must lie within the image of {width} x {height} pixels")
        return self.bbox

    def __call__(self, image: Frame) -> Frame:
        """Return the processed image, uint8."""
        import cv2
        import numpy as np

        x0, y0, x1, y1 = self.bbox_for(image.shape)
        processed = image[y0:y1, x0:x1]
        if self.grey and processed.ndim == 3:
            processed = np.asarray(cv2.cvtColor(processed, cv2.COLOR_BGR2GRAY))
        shrinks = self.size[0] * self.size[1] < processed.shape[0] * processed.shape[1]
        interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(processed, self.size, interpolation=interpolation))


def export_tactile_data(
    folder: Path,
    out: Path | None = None,
    processing: Processing | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Write the files that ``tactile_learning`` reads.

    The table is written after the images, so it never lists a missing image. Existing files are overwritten.

    Args:
        folder: A run folder.
        out: The output folder; None for the run folder itself, which the toolchains use.
        processing: The processing of every image; the default if None.
        progress: A function that is called with the number of images written so far and the number of all images.

    Returns:
        The number of images of presses.

    Raises:
        InputError: The folder is not a run folder or has no images, or the result cannot be written.
        CheckFailedError: An image is missing, damaged or changed.
        MissingToolError: OpenCV is not installed.
    """
    require("the export of images", "cv2")
    run, target, processing = Run.open(folder), out or folder, processing or Processing()
    shape = run.info.frame_shape
    names = [row.sensor_image for row in run.rows]
    if not names:
        raise InputError("run", str(folder), "has no press yet")
    other = next((name for name in names if not name.endswith(schema.IMAGE_SUFFIXES)), None)
    if other is not None:
        raise InputError("run", str(folder), f"has {other}, but tactile-data is for sensors whose frames are images")
    with locked(target):
        images = target / PROCESSED_FOLDER
        with refusing(target):
            images.mkdir(exist_ok=True)
        for reference in run.references[:1]:
            shape = _process(run, reference, images, processing)
        for done, row in enumerate(run.rows, start=1):
            shape = _process(run, row, images, processing)
            if progress is not None:
                progress(done, len(names))
        assert shape is not None
        _parameters(run, target, processing, shape)
        with replacing(target / TARGETS_IMAGES_FILE) as path, path.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            header = [name for name in run.targets.header if name in columns(Row)]
            writer.writerow(dict.fromkeys([*TOOLCHAIN_COLUMNS, *header]))
            for row in run.rows:
                values = dict(zip(header, cells(row, header), strict=True))
                writer.writerow((_toolchain_values(run.info) | values).values())
    return len(names)


def _process(run: Run, row: schema.Row | schema.Reference, images: Path, processing: Processing) -> tuple[int, ...]:
    image = run.read(row.path, row.image_sha256)
    if not is_image(image):
        raise CheckFailedError(f"{run.folder / row.path}: is not a uint8 image in grey or in BGR colours")
    data, _ = encoded(processing(image), run.info.simulated)
    with refusing(images):
        (images / Path(row.path).name).write_bytes(data)
    return image.shape


def _toolchain_values(info: RunInfo) -> dict[str, str]:
    """Return the texts of :data:`TOOLCHAIN_COLUMNS` that are the same in all rows: a rig never turns or shears."""
    still = dict.fromkeys(TOOLCHAIN_COLUMNS, "0.0" if info.protocol else "")
    return still | {"object_label": cell(info.printed.object_label)}


def _parameters(run: Run, target: Path, processing: Processing, shape: tuple[int, ...]) -> None:
    """Write the files that describe the presses, the rig, the recorded images and the exported images."""
    sensor = _sensor_params(run.info)
    write_json(target / "collect_params.json", _collect_params(run.info))
    write_json(target / "env_params.json", _environment_params(run.info))
    write_json(target / "sensor_image_params.json", sensor)
    width, height = processing.size
    processed = {
        **sensor,
        "bbox": list(processing.bbox_for(shape)),
        "dims": [width, height],
        "image_size": [width, height],
        "gray": processing.grey or len(shape) == 2,
    }
    write_json(target / "processed_image_params.json", processed)


def _collect_params(info: RunInfo) -> dict[str, Any]:
    """Return the contents of ``collect_params.json``: the objects and the limits of the poses.

    Models scale their labels with these limits. For an imported run they are unknown, so they are null.
    """
    protocol, label = info.protocol, info.printed.object_label
    lowest = highest = shear = pose = None
    if protocol is not None:
        x, y = protocol.positions.grid.x_mm, protocol.positions.grid.y_mm
        lowest, highest = (
            [x[0], y[0], -protocol.limits.depth_limit_mm, 0.0, 0.0, 0.0],
            [x[-1], y[-1], 0.0, 0.0, 0.0, 0.0],
        )
        shear = pose = [0.0] * 6
    return {
        "pose_label_names": list(POSE_COLUMNS),
        "pose_llims": lowest,
        "pose_ulims": highest,
        "shear_label_names": list(SHEAR_COLUMNS),
        "shear_llims": shear,
        "shear_ulims": shear,
        "object_poses": {} if label is None else {str(label): pose},
        "sample_disk": False if protocol else None,
        "sort": False if protocol else None,
        "seed": protocol.positions.seed if protocol else None,
    }


def _environment_params(info: RunInfo) -> dict[str, Any]:
    """Return the contents of ``env_params.json``: the robot, the block, and the work frame in the stage's frame."""
    driver, frame = info.stage.get("settings", {}).get("driver", "stage" if info.stage else None), info.frame
    return {
        "robot": "sim" if info.stage.get("simulated") else driver and str(driver),
        "stim_name": info.printed.name,
        "speed": info.stage.get("settings", {}).get("approach_mm_s"),
        "work_frame": frame and [*frame.origin_mm, 0.0, 0.0, 90.0 * frame.quarter_turns],
        "tcp_pose": frame and [0.0] * 6,
        "work_frame_meaning": frame and info.as_dict()["frame"]["meaning"],
        "simulated": list(info.simulated),
    }


def _sensor_params(info: RunInfo) -> dict[str, Any]:
    """Return the contents of ``sensor_image_params.json``: the sensor, and the size of its images (never cropped)."""
    shape = info.frame_shape
    height, width = shape[:2] if shape and len(shape) in (2, 3) else (None, None)
    settings = info.sensor.get("settings", {})
    return {
        "type": str(info.sensor.get("name", "sensor")) if info.protocol else info.sensor.get("name"),
        "source": settings.get("actual", {}).get("device", settings.get("requested", {}).get("device")),
        "exposure": settings.get("actual", {}).get("exposure"),
        "gray": shape is not None and len(shape) == 2,
        "bbox": None if width is None else [0, 0, width, height],
        "image_size": None if width is None else [width, height],
        "simulated": list(info.simulated),
    }
