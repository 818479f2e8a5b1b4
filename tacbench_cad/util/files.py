"""Files that are either whole or not there: a temporary name, one rename, and one process a folder."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tacbench_cad.util.door import open_input
from tacbench_cad.util.errors import CheckFailedError, InputError

#: Every temporary file begins so; a leftover of a killed run is swept by the next run that holds the folder.
TEMPORARY_PREFIX = ".tacbench-unfinished-"
#: A temporary folder of :func:`replacing_folder`; other folders with the first prefix belong to those who made them.
_FOLDER_PREFIX = f"{TEMPORARY_PREFIX}folder-"
#: The file that a running process holds locked. It may outlive a killed process; the lock on it does not.
LOCK_NAME = ".tacbench-lock"

_REASONS = {
    errno.EACCES: "is not writable",
    errno.EPERM: "is not writable",
    errno.EROFS: "is on a file system that cannot be written",
    errno.ENOSPC: "is full: no space left on its device",
    errno.EDQUOT: "is full: the disk quota is used up",
    errno.ENOTDIR: "is not a folder",
    errno.EEXIST: "is not a folder",
    errno.ENAMETOOLONG: "would hold a file with too long a name",
}


def _refusal(folder: Path, error: OSError) -> InputError:
    """The one message for a folder that cannot take a file."""
    reason = _REASONS.get(error.errno or 0, f"cannot take the file: {error.strerror or error}")
    return InputError("output folder", str(folder), f"{reason}; name a folder that can be written and has room")


@contextlib.contextmanager
def refusing(folder: Path) -> Iterator[None]:
    """Turn what the system says of a folder that cannot be written into a message for the user.

    Raises:
        InputError: An ``OSError`` came out of the body.
    """
    try:
        yield
    except OSError as error:
        raise _refusal(folder, error) from error


@contextlib.contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Write a file so that ``path`` is either untouched or whole.

    The body writes to the temporary path that it is given, in the same folder (a rename is atomic only within one
    file system). After the body the data are forced to disk and the file is renamed. If anything is raised, an
    interruption included, the temporary file is removed and ``path`` stays as it was.

    Args:
        path: Where the file shall be in the end. Its folder must exist.
        durable: Force the data to disk. Without that, a power cut may leave an empty file; a killed process does not.

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
    temporary = folder / f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}"
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
    """Write a folder so that ``path`` is either not there or whole: :func:`replacing` for a folder that is new.

    Args:
        path: Where the folder shall be in the end. It does not exist yet, or is empty.

    Yields:
        The temporary folder, beside it.

    Raises:
        InputError: ``path`` exists already, or its folder is unwritable or full.
    """
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError("output folder", str(path), "exists already; remove it or name another one")
    temporary = path.parent / f"{_FOLDER_PREFIX}{os.getpid()}-{path.name}"
    with locked(path.parent), refusing(path.parent):
        for leftover in path.parent.glob(f"{_FOLDER_PREFIX}*"):
            shutil.rmtree(leftover, ignore_errors=True)
        temporary.mkdir()
        try:
            yield temporary
            temporary.replace(path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: Path, text: str, *, durable: bool = True) -> None:
    """Write a UTF-8 file that is whole or not there; arguments and errors as of :func:`replacing`."""
    with replacing(path, durable=durable) as temporary:
        temporary.write_bytes(text.encode())


def write_json(path: Path, document: Mapping[str, Any], *, durable: bool = True) -> None:
    """Write a JSON file that is whole or not there; errors as of :func:`replacing`."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n", durable=durable)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold an output folder, making it if it is not there; a second process is refused.

    A folder that was made here and is empty in the end is removed again: a refusal leaves nothing behind.

    The lock is the operating system's (``flock``, on Windows ``msvcrt.locking``): it ends with the process, however
    that ends. Unfinished files of a killed process are removed once the folder is held.

    Args:
        folder: The folder to write in.

    Raises:
        InputError: Another process holds the folder, or it cannot be written.
    """
    try:
        created = [level for level in (folder, *folder.parents) if not level.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        handle = _take(folder / LOCK_NAME)
    except OSError as error:
        raise _refusal(folder, error) from error
    if handle is None:
        raise InputError("output folder", str(folder), "another tacbench is writing to it; wait for it to end")
    try:
        for leftover in folder.glob(f"{TEMPORARY_PREFIX}*"):
            with contextlib.suppress(OSError):
                leftover.unlink()
        yield
    finally:
        _leave(folder / LOCK_NAME, handle)
        with contextlib.suppress(OSError):  # one that holds something
            for level in created:
                level.rmdir()


def sha256(path: Path) -> str:
    """The SHA-256 of a file's bytes, as 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def existing_file(path: Path) -> Path:
    """The path itself, if it is a regular file that can be opened.

    Raises:
        InputError: There is no such file, or it is a folder, a pipe or a device, or it may not be read.
    """
    open_input(path).close()
    return path


def not_empty(path: Path) -> Path:
    """The path of a file that can be opened and holds something.

    Raises:
        InputError: As :func:`existing_file`.
        CheckFailedError: The file is empty.
    """
    if existing_file(path).stat().st_size == 0:
        raise CheckFailedError(f"{path}: the file is empty")
    return path


if sys.platform == "win32":
    import msvcrt

    def _take(path: Path) -> int | None:
        handle = os.open(path, os.O_RDWR | os.O_CREAT)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            os.close(handle)
            return None
        return handle

    def _leave(path: Path, handle: int) -> None:
        os.close(handle)
        with contextlib.suppress(OSError):
            path.unlink()

else:
    import fcntl

    def _take(path: Path) -> int | None:
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(handle)
                return None
            except BaseException:
                os.close(handle)
                raise
            # The holder before us removes the file: a lock on a removed file keeps nobody out, so take the new one.
            with contextlib.suppress(FileNotFoundError):
                if path.stat().st_ino == os.fstat(handle).st_ino:
                    return handle
            os.close(handle)

    def _leave(path: Path, handle: int) -> None:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(handle)
