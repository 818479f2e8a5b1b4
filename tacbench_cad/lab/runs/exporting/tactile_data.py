"""Run folders as the TacTip toolchains read them: ``processed_images/`` and ``targets_images.csv``.

``tactile_learning`` takes a folder's ``processed_images/`` with the names in ``targets_images.csv`` if there are any,
and the JSON files beside them for the range of the labels and for what was done to the images.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs import params, schema
from tacbench_cad.lab.runs.pictures import encoded
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked, refusing, replacing, write_json
from tacbench_cad.util.packages import require

#: Where the toolchains look for images.
PROCESSED_FOLDER = "processed_images"
#: Where they look for the presses.
TARGETS_IMAGES_FILE = "targets_images.csv"


@dataclass(frozen=True, kw_only=True)
class Processing:
    """What is done to every image.

    Args:
        bbox: Lowest x, y and highest x, y of the part that is kept, in pixels; None for the largest centred square.
        size: Width and height in pixels afterwards.
        grey: Make it grey (BT.601).
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
        """The part that is kept of images of a shape.

        Raises:
            InputError: It leaves the image.
        """
        height, width = shape[:2]
        if self.bbox is None:
            side = min(height, width)
            x, y = (width - side) // 2, (height - side) // 2
            return (x, y, x + side, y + side)
        if self.bbox[2] > width or self.bbox[3] > height:
            raise InputError("bbox", list(self.bbox), f"leaves the image of {width} x {height} pixels")
        return self.bbox

    def __call__(self, image: Frame) -> Frame:
        """The processed image, uint8."""
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
    """Write what ``tactile_learning`` reads.

    The images come first and the table last, so that a table never names what is not there. Run again, it writes
    everything anew.

    Args:
        folder: A run folder.
        out: Folder for the result; None for the run folder itself, where those toolchains put it.
        processing: What is done to every image.
        progress: Called with the number of images written so far and the number of all.

    Returns:
        Number of images of presses.

    Raises:
        InputError: It is no run folder, holds no images, or the result cannot be written.
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
        raise InputError("run", str(folder), f"holds {other}: tactile-data is for sensors that give images")
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
            writer.writerow(schema.COLUMNS)
            writer.writerows([values[column] for column in schema.COLUMNS] for _, values in run.targets.text.rows)
    return len(names)


def _process(run: Run, row: schema.Row | schema.Reference, images: Path, processing: Processing) -> tuple[int, ...]:
    image = run.read(row.path, row.image_sha256)
    if not is_image(image):
        raise CheckFailedError(f"{run.folder / row.path}: is no image of uint8, grey or BGR")
    data, _ = encoded(processing(image), run.info.simulated)
    with refusing(images):
        (images / Path(row.path).name).write_bytes(data)
    return image.shape


def _parameters(run: Run, target: Path, processing: Processing, shape: tuple[int, ...]) -> None:
    for name in params.PARAMETERS:
        path = run.folder / name
        try:
            document = run.parameters(name)
        except InputError:
            raise InputError("run", str(path), "is missing or damaged; put a copy of it back") from None
        if not isinstance(document, dict):
            raise InputError("run", str(path), "must be a JSON object")
        if target != run.folder:
            write_json(target / name, document)
    width, height = processing.size
    processed = {
        **params.sensor_params(run.info),
        "bbox": list(processing.bbox_for(shape)),
        "dims": [width, height],
        "image_size": [width, height],
        "gray": processing.grey or len(shape) == 2,
    }
    write_json(target / params.PROCESSED_FILE, processed)
