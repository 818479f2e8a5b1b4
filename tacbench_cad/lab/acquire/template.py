"""The file that ``tacbench acquire --init`` writes: every key, what it means, and its default."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import replacing

#: The text of the file.
TEMPLATE = """\
# A data run for `tacbench acquire`. Keys that are empty ("" or []) must be filled in: only you know them.
# Lines that begin with "# key =" show a default: take the "#" away to change it.
# Lengths in mm, forces in N, times in s. Files are found from this file's folder.

# Folder of the run folders, one a block. `--out DIR` comes first.
out = "runs"

# One block. For a whole study take this table away and [study] in.
[block]
# Number of the texture (1 to 6), or a texture file of your own.
texture = ""
# "paper" or "released": which of the two geometries was printed.
# preset = "paper"
# The block's scale; the press grid scales with it.
# scale = 1.0
# Leg of the chamfered corner, if the block was printed with a key.
# key_mm = 3.0
# The printer ("bambu-p1p", "ender-3", "form-3", or a name of your own), the filament ("pla-minus", "petg"), the copy.
printer = ""
filament = ""
# copy = 1

# [study]
# textures = [1, 2, 3, 4, 5, 6]
# preset = "paper"
# scale = 1.0
# key_mm = 3.0
# Each line: copies = 3 means 1, 2 and 3, a list names them; force_levels = [3] presses some of the forces only.
# prints = [
#     { printer = "bambu-p1p", filament = "pla-minus", copies = 6 },
#     { printer = "form-3", filament = "grey-v4", copies = [1, 2], force_levels = [1, 2, 3] },
# ]
# In place of all of these, `layouts = ["plates/bambu-p1p_pla-plus_plate01.csv"]` takes the blocks of plates, by the
# files that `tacbench plate` wrote.

[holder]
# How far the holder's top lies below the block's highest point: the sensor touches the rim beyond the block.
# rim_mm = 1.18
# The fit that the holder was printed with: "press", "slip", "loose", or the clearance on each side in mm.
# fit = "slip"
# The clearance itself, where it was measured.
# gap_mm = 0.15

# How the block is pressed: the paper's protocol, and ours where the paper is silent.
[protocol]
# "force": to a target force. "depth": to a depth below first touch, for a rig without a gauge.
# contact = "force"
# Target forces, rising, and the half width of the band around each that counts as reached.
# forces_n = [0.08045, 1.91295, 3.0137]
# bands_n = [0.00195, 0.00985, 0.0098]
# Where contact is "depth": depths below first touch, rising ...
# depths_mm = [0.35, 1.7, 2.2]
# ... and how first touch is found: "gauge", "sensor" (its readings change) or "taught" (you are asked for the heights).
# touch = "gauge"
# Readings at each position and force.
# repeats = 2
# The positions: "even" or "1mm", the two readings of the paper's text, or { x_mm = [...], y_mm = [...] } of your own.
# grid = "even"
# "paper" or "random": the order of the positions, and that of a study's blocks, shuffled from the seed.
# order = "paper"
# block_order = "paper"
# seed = 0
# A new reading without contact after so long, to see drift.
# reference_every_s = 600.0
# Readings without motion at the start and the end, so many in contact and so many free: the noise floor.
# stationary_frames = 30
# Height of travel above the highest of block and rim.
# clearance_mm = 5.0
# The sensor's summit never goes further below the block's highest point. Set it to what your sensor survives.
# depth_limit_mm = 7.0
# Force that stops the run and lifts the sensor.
# hard_limit_n = 5.0
# Longest step down. The force can pass the hard limit by what one such step adds, and no more.
# approach_step_mm = 0.1
# Shortest step of the search for the force; no shorter than your stage's own step.
# fine_step_mm = 0.001
# Most steps of that search; then the best approach is kept and its row says in_band = false.
# search_steps = 40
# Wait after a step before anything is read.
# settle_s = 0.2
# Time over which a force is averaged.
# force_window_s = 0.1
# So many presses in a row outside of their band end the run.
# misses_allowed = 5

[stage]
# "grbl" (and grblHAL), "marlin", "arduino" (the authors' firmware), "virtual-grbl", "virtual-marlin", or
# "module:name", a driver of your own.
driver = "grbl"
# A port by its stable name (`tacbench rig probe` lists them) or a pyserial URL; without it the only candidate is taken.
# port = "/dev/serial/by-id/usb-..."
# Symbols per second; without it the driver's own.
# baud = 115200
# Where the stage stands with the sensor's summit at the block's lower corner, at the height of the block's highest
# point, as [x, y, z]: `tacbench rig align` finds it and writes it here.
origin_mm = []
# Quarter turns counter-clockwise by which the block lies on the stage.
# quarter_turns = 0
# Lowest and highest x, y and z that the stage may be sent to, in its own frame, as [[0, 200], [0, 200], [-60, 0]].
limits_mm = []
# Speed at the travel height, and of every step down.
# travel_mm_s = 20.0
# approach_mm_s = 2.0
# A tray: offsets of its slots from the origin. Blocks are then put in several at a time.
# slots_mm = [[0.0, 0.0, 0.0]]
# Whether the stage is homed when it is opened, and may be homed to lift the sensor after an alarm. Homing must go
# upwards first; of Marlin with its z switch at the bed, home_lift_mm must clear the holder. Without end stops: false.
# home = true
# Longest silence that is waited through.
# timeout_s = 10.0
# What only one driver knows: steps_per_mm of "arduino", home_lift_mm of "marlin" (5.0), speed of the virtual ones,
# your own driver's arguments.
# options = { speed = 1.0 }

[gauge]
# "serial" (a load cell that sends a line a sample), "simulated", "none", or "module:name".
driver = "serial"
# port = "/dev/serial/by-id/usb-..."
# baud = 115200
# File that `tacbench rig calibrate-force` wrote. Without it the lines are taken for newtons.
# calibration = "gauge.json"
# timeout_s = 2.0
# What only one driver knows: columns and column of a line with several numbers, stuck_samples, latency_s.
# options = { columns = 1, column = 1 }

[sensor]
# "opencv" (a camera), "taxels" (a line of numbers a sample), "simulated", or "module:name".
driver = "opencv"
# Camera or port by its stable name.
# device = "/dev/v4l/by-id/usb-..."
# The other keys belong to the driver. A camera's exposure, in its own unit, must be given: with automatic exposure the
# brightness follows the contact.
exposure = ""
# width = 640
# height = 480
# fps = 30
# focus = 0
# gain = 0
# white_balance = 4600
# colour = true
# A frame is dark, or blurred, beyond these; 0 switches a check off, for a sensor without markers.
# dark_counts = 25
# blur_px = 3.0
# Taxels instead: so many numbers on a line; more than one sample makes each reading a short time series.
# driver = "taxels"
# device = "/dev/serial/by-id/usb-..."
# columns = 16
# samples = 1
# units = "counts"
# baud = 115200
# timeout_s = 2.0
# stuck_samples = 50
# latency_s = 0.02
"""


def write_template(path: Path) -> None:
    """Write :data:`TEMPLATE` to a new file.

    Raises:
        InputError: There is something at that path already, or it cannot be written.
    """
    if path.exists() or path.is_symlink():
        raise InputError("init", str(path), "is there already; name a new file")
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(TEMPLATE, encoding="utf-8")
