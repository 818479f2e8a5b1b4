"""Python code of the user: objects named ``module:name``, and devices whose exceptions become errors of the rig."""

from __future__ import annotations

import contextlib
import importlib
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tacbench_cad
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.util.errors import InputError, TacbenchError, nearest
from tacbench_cad.util.packages import why_not_imported

#: The folder of this project's own code.
_PACKAGE = str(Path(tacbench_cad.__file__).parent)


def is_plugin(driver: str) -> bool:
    """Return whether the name of a driver is a ``module:name``."""
    return ":" in driver


class OwnDevice(Closing):
    """A user's own device. Exceptions that are not errors of the rig become one, with a message of one line.

    Args:
        device: The device.
        name: The field and driver, for error messages: ``[stage] driver my_arm:Arm``.
        results: Functions that check and convert the results of some methods. They may raise any exception.
        closes: Whether the device is closed with this object.
    """

    def __init__(
        self, device: Any, name: str, results: Mapping[str, Callable[[Any], Any]], *, closes: bool = True
    ) -> None:
        self._device, self._name, self._results, self._closes = device, name, results, closes

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(self._device, attribute)
        if not callable(value):
            return value

        def call(*values: Any, **named: Any) -> Any:
            try:
                result = value(*values, **named)
                return self._results[attribute](result) if attribute in self._results else result
            except TacbenchError:
                raise
            except (Exception, SystemExit) as error:
                place = _place(error, type(self._device).__module__)
                raise RigError(f"{self._name}: {attribute}() failed: {_text(error)} ({place})") from error

        return call

    def stop(self) -> None:
        """See :class:`tacbench_cad.lab.rig.stage.Stage`. Never raises."""
        with contextlib.suppress(Exception, SystemExit):
            self._device.stop()

    def close(self) -> None:
        """Close the device. Never raises."""
        if self._closes:
            with contextlib.suppress(Exception, SystemExit):
                self._device.close()


def load(driver: str, *, field: str = "driver") -> Any:
    """Import the object that a ``module:name`` names.

    Args:
        driver: ``my_arm:Arm``; the module name may have dots. The working folder is searched too.
        field: The field of the driver, for error messages: ``[stage] driver``.

    Raises:
        InputError: The module does not exist, its import fails, or it does not have this name.
    """
    module_name, _, name = driver.partition(":")
    if not (name.isidentifier() and all(part.isidentifier() for part in module_name.split("."))):
        raise InputError(field, driver, "must be module:name, for example my_arm:Arm")
    own = str(Path.cwd())
    sys.path.insert(0, own)
    try:
        module = importlib.import_module(module_name)
    except TacbenchError:
        raise
    except (Exception, SystemExit) as error:
        reason = why_not_imported(error) if isinstance(error, ModuleNotFoundError) else None
        where = reason or _place(error) or f"looked for in {own} and the environment"
        raise InputError(field, driver, f"{module_name} cannot be imported: {_text(error)} ({where})") from error
    finally:
        sys.path.remove(own)
    if not hasattr(module, name):
        known = [name for name in vars(module) if not name.startswith("_")]
        where = getattr(module, "__file__", None) or module_name
        raise InputError(field, driver, f"{where} has no {name}; {nearest(name, known)}")
    return getattr(module, name)


def opened(open: Callable[[], Any], driver: str, *, module: str = "", field: str = "driver") -> Any:
    """Open a user's own device.

    Args:
        open: Opens the device.
        driver: The driver's name, for error messages.
        module: The name of the driver's module, for error messages.
        field: See :func:`load`.

    Raises:
        InputError: The driver refuses the options.
        RigError: The driver raised it.
    """
    try:
        return open()
    except TacbenchError:
        raise
    except (Exception, SystemExit) as error:
        reason = why_not_imported(error) if isinstance(error, ModuleNotFoundError) else None
        where = reason or _place(error, module) or driver
        raise InputError(field, driver, f"cannot be opened: {_text(error)} ({where})") from error


def _text(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def file_of(module: str) -> str:
    """Return the file of a module, or an empty text if it has none."""
    return getattr(sys.modules.get(module), "__file__", None) or ""


def _place(error: BaseException, module: str = "") -> str:
    """Return file and line in the user's code where an exception occurred, or the file of the module."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}, line {error.lineno}"
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith(("<frozen", _PACKAGE)) and frame.filename != importlib.__file__
    ]
    lines = [frame.lineno for frame in frames if frame.filename == frames[0].filename]
    return f"{frames[0].filename}, line {lines[-1]}" if frames else file_of(module)
