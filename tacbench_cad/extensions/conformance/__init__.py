"""Checks of a driver on its device."""
