"""A user's own stage or sensor by ``module:name``: any Python that the working folder or the environment has.

The name stands for something that is called with the options of the file as keyword arguments and gives the device.
``tests/lab/rig/example_stage.py`` is a whole one.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tacbench_cad.util.errors import InputError, TacbenchError, nearest


def is_plugin(driver: str) -> bool:
    """Whether a driver's name is a ``module:name``."""
    return ":" in driver


def load(driver: str, folder: Path | None = None) -> Any:
    """What ``module:name`` stands for.

    Args:
        driver: ``my_arm:Arm``; the module may have dots.
        folder: Where a module that is not installed lies; None for the working folder.

    Raises:
        InputError: No such module, it fails when imported, or it has no such name.
    """
    module_name, _, name = driver.partition(":")
    if not (name.isidentifier() and all(part.isidentifier() for part in module_name.split("."))):
        raise InputError("driver", driver, "must be module:name, such as my_arm:Arm")
    own = str(folder or Path.cwd())
    sys.path.insert(0, own)
    try:
        module = importlib.import_module(module_name)
    except TacbenchError:
        raise
    except Exception as error:
        raise InputError("driver", driver, f"{module_name} cannot be imported: {_text(error)}") from error
    finally:
        sys.path.remove(own)
    if not hasattr(module, name):
        known = [one for one in vars(module) if not one.startswith("_")]
        raise InputError("driver", driver, f"{module_name} has no {name}; {nearest(name, known)}")
    return getattr(module, name)


def made(driver: str, options: Mapping[str, Any], needed: Iterable[str], folder: Path | None = None) -> Any:
    """The device that a ``module:name`` makes.

    Args:
        driver: See :func:`load`.
        options: Its keyword arguments.
        needed: Attributes that it must have.
        folder: See :func:`load`.

    Raises:
        InputError: It cannot be loaded, refuses the options, or lacks an attribute.
        RigError: As it raises itself.
    """
    maker = load(driver, folder)
    if not callable(maker):
        raise InputError("driver", driver, "cannot be called; name a class or a function")
    try:
        device = maker(**options)
    except TacbenchError:
        raise
    except Exception as error:
        raise InputError("driver", driver, f"cannot be opened: {_text(error)}") from error
    missing = [one for one in needed if not hasattr(device, one)]
    if missing:
        raise InputError("driver", driver, f"lacks {', '.join(missing)}")
    return device


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0]
