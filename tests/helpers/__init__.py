"""Helpers that the tests share: parts, studies, fake devices and readers to compare with."""
