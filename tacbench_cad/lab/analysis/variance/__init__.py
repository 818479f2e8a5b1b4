"""How well it printed: the variance table, its intervals, components and tests."""
