"""Pressing blocks: one press, one block, a whole study, and what keeps sensor and block unharmed."""
