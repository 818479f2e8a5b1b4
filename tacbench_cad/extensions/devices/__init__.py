"""Drivers of devices that not every lab has: Klipper, arms, industrial cameras, hand-held gauges."""
