"""Scans of printed blocks: reading them, fitting them to the formula, and what the printer did to each wave."""
