"""The fixtures of the small run."""

from helpers.run_fixtures import complete_run, filled, make_info, noise, run_folder

__all__ = ["complete_run", "filled", "make_info", "noise", "run_folder"]
