"""Safe output files: each file is written under a temporary name and renamed, and only one process writes to a folder.

A reader therefore finds either the complete file or none.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import socket
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.untrusted import open_input

#: The prefix of every temporary file. The next process that locks the folder deletes those that a killed process left.
TEMPORARY_PREFIX = ".tacbench-unfinished-"
#: The age in s from which a temporary file is left over, also if its process cannot be looked for: on another machine.
_LEFT_AFTER_S = 24 * 3600.0
#: The prefix of the temporary folders of :func:`replacing_folder`.
_FOLDER_PREFIX = f"{TEMPORARY_PREFIX}folder-"
#: The file that a running process locks. The file may remain after a process was killed, but the lock does not.
LOCK_NAME = ".tacbench-lock"
#: The time in s for a second try, if another process removed its file between our opening and locking it.
_LOCK_WAIT_S = 0.2

#: The name of the manifest in the folder of a print set.
MANIFEST_NAME = "manifest.json"

_REASONS = {
    errno.EACCES: "is not writable",
    errno.EPERM: "is not writable",
    errno.EROFS: "is on a read-only file system",
    errno.ENOSPC: "is full: no space left on its device",
    errno.EDQUOT: "is full: the disk quota is used up",
    errno.ENOTDIR: "is not a folder",
    errno.EEXIST: "is not a folder",
    errno.ENAMETOOLONG: "cannot take a file with such a long name",
}


def _refusal(folder: Path, error: OSError) -> InputError:
    """Return the error for a folder to which a file cannot be written."""
    reason = _REASONS.get(error.errno or 0, f"cannot take the file ({error.strerror or error})")
    return InputError("output folder", str(folder), f"{reason}; choose a writable folder with enough free space")


@contextlib.contextmanager
def refusing(folder: Path) -> Iterator[None]:
    """Turn the system's errors about an output folder into messages for the user.

    Raises:
        InputError: The body raised an ``OSError``.
    """
    try:
        yield
    except OSError as error:
        raise _refusal(folder, error) from error


@contextlib.contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Write a file so that ``path`` is either unchanged or complete.

    The body writes to a temporary path in the same folder, because a rename is atomic only within one file system.
    After the body, the data are forced to disk and the file is renamed. After an error or an interruption, the
    temporary file is removed and ``path`` is unchanged.

    Args:
        path: The final path of the file. Its folder must exist.
        durable: Force the data to disk. Otherwise a power failure (but not a killed process) may leave an empty file.

    Yields:
        The temporary path, with the same suffix.

    Raises:
        InputError: The folder is missing, unwritable or full, or ``path`` is a folder.
    """
    folder = path.parent
    if path.is_dir():
        raise InputError("output file", str(path), "is a folder; move it or choose another output folder")
    if not folder.is_dir():
        raise InputError("output folder", str(folder), "is not a folder" if folder.exists() else "does not exist")
    temporary = folder / f"{TEMPORARY_PREFIX}{_own_mark()}{path.name}"
    try:
        yield temporary
        if durable:
            with temporary.open("rb+") as stream:
                os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise _refusal(folder, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Write a new folder so that ``path`` is either missing or complete; like :func:`replacing`.

    Args:
        path: The final path of the folder. It must not exist, or must be empty.

    Yields:
        A temporary folder next to ``path``.

    Raises:
        InputError: ``path`` already exists, or its parent folder is unwritable or full.
    """
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError("output folder", str(path), "already exists; remove it or choose another folder")
    temporary = path.parent / f"{_FOLDER_PREFIX}{_own_mark()}{path.name}"
    with locked(path.parent), refusing(path.parent):
        for leftover in _leftovers(path.parent, _FOLDER_PREFIX):
            shutil.rmtree(leftover, ignore_errors=True)
        temporary.mkdir()
        try:
            yield temporary
            temporary.replace(path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: Path, text: str, *, durable: bool = True) -> None:
    """Write a UTF-8 text file completely or not at all; same arguments and errors as :func:`replacing`."""
    with replacing(path, durable=durable) as temporary:
        temporary.write_bytes(text.encode())


def write_json(path: Path, document: Mapping[str, Any], *, durable: bool = True) -> None:
    """Write a JSON file completely or not at all; same errors as :func:`replacing`."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n", durable=durable)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock an output folder, so that no other process of this program writes to it. A missing folder is created.

    If the folder was created here and is still empty at the end, it is removed again.

    The operating system holds the lock, so it always ends with the process. After locking, :func:`remove_leftovers` is
    called.

    Args:
        folder: The folder to write to.

    Raises:
        InputError: Another process has locked the folder, or it is not writable.
    """
    from filelock import FileLock, Timeout

    path = folder / LOCK_NAME
    lock = FileLock(path)
    try:
        created = [level for level in (folder, *folder.parents) if not level.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=_LOCK_WAIT_S)
    except Timeout:
        allowed = "another tacbench is writing to it; wait for it to end"
        raise InputError("output folder", str(folder), allowed) from None
    except OSError as error:
        raise _refusal(folder, error) from error
    try:
        remove_leftovers(folder)
        yield
    finally:
        with contextlib.suppress(OSError):  # Windows removes no open file
            path.unlink()
        lock.release()
        with contextlib.suppress(OSError):  # the folder is not empty
            for level in created:
                level.rmdir()


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files of killed processes. Those of running processes are kept."""
    for leftover in _leftovers(folder, TEMPORARY_PREFIX):
        with contextlib.suppress(OSError):
            leftover.unlink()


def _leftovers(folder: Path, prefix: str) -> Iterator[Path]:
    """Yield the temporary files or folders of processes that have ended on this machine, and those that are old."""
    host = _own_mark().partition("-")[2]
    for path in folder.glob(f"{prefix}*"):
        process, _, rest = path.name.removeprefix(prefix).partition("-")
        is_dead = process.isdecimal() and rest.startswith(host) and not is_running(int(process))
        with contextlib.suppress(OSError):
            if is_dead or time.time() - path.stat().st_mtime > _LEFT_AFTER_S:
                yield path


def _own_mark() -> str:
    """Return the part of a temporary file's name that says which process of which machine writes it."""
    return f"{os.getpid()}-{hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]}-"


def is_running(process: int) -> bool:
    """Return whether a process of this machine is running; True if this cannot be found out."""
    if sys.platform == "win32":  # there, os.kill would end the process
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def sha256(path: Path) -> str:
    """Return the SHA-256 hash of a file as 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def existing_file(path: Path) -> Path:
    """Return the path if it is a regular file that can be opened.

    Raises:
        InputError: The file does not exist, is not a regular file, or is not readable.
    """
    open_input(path).close()
    return path


def not_empty(path: Path) -> Path:
    """Return the path if it is a file that can be opened and is not empty.

    Raises:
        InputError: Same as :func:`existing_file`.
        CheckFailedError: The file is empty.
    """
    if existing_file(path).stat().st_size == 0:
        raise CheckFailedError(f"{path}: the file is empty")
    return path
