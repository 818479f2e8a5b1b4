"""How repeatable the prints are: the variance table, its intervals, components and tests."""
