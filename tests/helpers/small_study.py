"""A study file with two presses, for tests."""

#: One block, two presses, on the virtual firmware.
STUDY = """
[block]
texture = 4
printer = "bambu-p1p"
filament = "pla-minus"
[protocol]
targets.forces_n = [1.0]
targets.bands_n = [0.05]
repeats = 1
checks.stationary_frames = 2
positions.grid = { x_mm = [5, 8], y_mm = [19] }
[stage]
driver = "virtual-grbl"
options = { speed = 50 }
[gauge]
driver = "virtual-serial"
[sensor]
driver = "simulated"
"""
