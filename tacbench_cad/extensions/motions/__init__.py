"""Motions in contact after a press: a slide, a roll or a tilt of the sensor, during which frames are recorded."""
