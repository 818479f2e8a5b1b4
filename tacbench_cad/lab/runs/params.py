"""The JSON files that TacTip toolchains (tactile_data, tactile_learning) expect in the same folder as the targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tacbench_cad.lab.runs.info import FRAME_TEXT, RunInfo
from tacbench_cad.lab.runs.schema import POSE_COLUMNS, SHEAR_COLUMNS

#: The file that describes the presses.
COLLECT_FILE = "collect_params.json"
#: The file that describes the rig.
ENVIRONMENT_FILE = "env_params.json"
#: The file that describes the recorded images.
SENSOR_FILE = "sensor_image_params.json"
#: The file that describes the exported images.
PROCESSED_FILE = "processed_image_params.json"


def collect_params(info: RunInfo) -> dict[str, Any]:
    """Return the contents of ``collect_params.json``: the objects and the limits of the poses.

    Models scale their labels with these limits. For an imported run they are unknown, so they are null.
    """
    protocol, label = info.protocol, info.printed.object_label
    lowest = highest = shear = pose = None
    if protocol is not None:
        x, y = protocol.grid.x_mm, protocol.grid.y_mm
        lowest, highest = [x[0], y[0], -protocol.depth_limit_mm, 0.0, 0.0, 0.0], [x[-1], y[-1], 0.0, 0.0, 0.0, 0.0]
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
        "seed": protocol.seed if protocol else None,
    }


def environment_params(info: RunInfo) -> dict[str, Any]:
    """Return the contents of ``env_params.json``: the robot, the block, and the work frame in the stage's frame."""
    driver, frame = info.stage.get("settings", {}).get("driver", "stage" if info.stage else None), info.frame
    return {
        "robot": "sim" if info.stage.get("simulated") else driver and str(driver),
        "stim_name": info.printed.name,
        "speed": info.stage.get("settings", {}).get("approach_mm_s"),
        "work_frame": frame and [*frame.origin_mm, 0.0, 0.0, 90.0 * frame.quarter_turns],
        "tcp_pose": frame and [0.0] * 6,
        "work_frame_meaning": frame and FRAME_TEXT,
        "simulated": list(info.simulated),
    }


def sensor_params(info: RunInfo) -> dict[str, Any]:
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


#: The files of a run, with the functions that return their contents.
PARAMETERS: Mapping[str, Callable[[RunInfo], dict[str, Any]]] = {
    COLLECT_FILE: collect_params,
    ENVIRONMENT_FILE: environment_params,
    SENSOR_FILE: sensor_params,
}
