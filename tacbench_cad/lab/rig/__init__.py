"""Devices: stages, force gauges and sensors, each behind a small interface."""
