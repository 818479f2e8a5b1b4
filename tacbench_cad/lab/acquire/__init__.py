"""Pressing of blocks: one press, one block, a whole study, and the protection of sensor and block."""
