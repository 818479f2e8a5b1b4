"""Drivers of the devices of a rig: stages, force gauges and sensors, each with a small interface."""
