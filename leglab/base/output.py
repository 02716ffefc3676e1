"""Atomic output: a file or folder appears complete or not at all, written by one process at a time.

Output is written under a unique hidden name and renamed to its final name at the end. Leftovers of
a killed process are removed when the same path is written again.
"""

import errno
import fcntl
import json
import os
import shutil
import socket
import stat
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import Any, BinaryIO

from leglab.base.errors import FileError, LeglabError

_LOCK = ".leglab.lock"
_WORKPLACE = ".leglab-work."
# Error numbers of flock on file systems without locks, such as those of some clusters.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF)
_PATIENCE = 50  # attempts to read the owner of a lock, one second in total


def write_atomically(path: str | Path, write: Callable[[BinaryIO], object]) -> None:
    """Writes a file completely or leaves it unchanged; if several processes write, the last wins.

    Args:
        path: The file. A symbolic link is kept; its target is replaced.
        write: Function that writes the content to the binary stream in its argument.

    Raises:
        FileError: The folder does not exist or is not writable, the disk is full, or the path is
            not a regular file.
    """
    path = Path(path)
    with _replaced(path) as partial, _told(path), partial.open("wb") as stream:
        write(stream)


def write_json(path: Path, content: Any, *, indent: int = 2, ascii_only: bool = True) -> None:
    """Writes content as JSON by `write_atomically`."""
    text = json.dumps(content, indent=indent, ensure_ascii=ascii_only, allow_nan=False) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yields a temporary file for a program to write, which is renamed to `path` at the end.

    Args:
        path: The file; its folder is created. A symbolic link is kept; its target is replaced.

    Yields:
        Path of an empty file with the same suffix.

    Raises:
        FileError: Another process is writing the file, or it cannot be written or replaced.
    """
    with _told(path):
        real = regular_file(path)
    with _folder(real.parent, path), _claimed(_lock_of(real), path) as alone:
        if alone:
            remove(real.parent.glob(f".{escape(real.name)}.*.partial{escape(real.suffix)}"))
        with _replaced(path, real.suffix) as partial:
            yield partial


def check_folder(folder: Path, *, mark: str, overwrite: bool = False) -> None:
    """Tests that an output folder does not exist, or holds earlier results that may be replaced.

    Args:
        folder: Output folder.
        mark: Name of a file that identifies a folder with earlier results.
        overwrite: Whether earlier results may be replaced.

    Raises:
        FileError: The folder exists and may not be replaced, holds other content, or is or
            contains the working folder.
    """
    with _told(folder):
        if not os.path.lexists(folder):
            return
        if not overwrite:
            text = f"output folder {str(folder)!r} exists; remove it or give --overwrite"
            raise FileError(text, given=folder)
        if not folder.is_dir() or (any(folder.iterdir()) and not (folder / mark).exists()):
            raise FileError(f"{str(folder)!r} holds no {mark}: it is left as it is", given=folder)
        if Path.cwd().is_relative_to(os.path.realpath(folder)):
            text = f"{str(folder)!r} is or holds the working folder: give another one"
            raise FileError(text, given=folder)


def check_apart(folder: Path, inputs: Iterable[Path]) -> None:
    """Tests that no input file lies in the output folder, which replacing would delete.

    Raises:
        FileError: An input lies in the folder; the message names it.
    """
    real = os.path.realpath(folder)
    for path in inputs:
        if Path(os.path.realpath(path)).is_relative_to(real):
            text = f"{path} lies in the output folder {str(folder)!r}: give another one"
            raise FileError(text, given=path)


@contextmanager
def new_folder(
    folder: Path, *, mark: str, made: Sequence[str], overwrite: bool = False
) -> Iterator[Path]:
    """Yields a temporary folder for results, which is renamed to `folder` at the end.

    Args:
        folder: Output folder; parents are created. A symbolic link is kept.
        mark: Name of a file that identifies a folder with earlier results.
        made: Names of all files and folders that results may consist of; anything else in the
            folder belongs to the user and is kept.
        overwrite: Whether earlier results may be replaced; they are kept until the end.

    Yields:
        Path of an empty folder with the same parent.

    Raises:
        FileError: As `check_folder`, or another process is writing the folder, or it cannot be
            written.
    """
    real = Path(os.path.realpath(folder))
    check_folder(folder, mark=mark, overwrite=overwrite)
    with _folder(real.parent, folder), _claimed(_lock_of(real), folder) as alone:
        earlier = real.with_name(f".{real.name}.earlier")
        with _told(folder):
            if alone:
                remove(real.parent.glob(f".{escape(real.name)}.*.partial"))
                _recover(real, earlier)
            check_folder(folder, mark=mark, overwrite=overwrite)
            name = tempfile.mkdtemp(dir=real.parent, prefix=f".{real.name}.", suffix=".partial")
            os.chmod(name, 0o777 & ~_umask())
        try:
            yield Path(name)
            check_folder(folder, mark=mark, overwrite=overwrite)
            with _told(folder):
                _carry_over(real, Path(name), {mark, *made})
                _exchange(Path(name), real, earlier)
        finally:
            remove([Path(name)])


@contextmanager
def claimed_folder(folder: Path) -> Iterator[Path]:
    """Locks a folder whose files are replaced one by one, so that no other process writes to it.

    Args:
        folder: Output folder; it is created, and removed again if it stays empty.

    Yields:
        An empty temporary folder inside it, in which files are made before they are moved.

    Raises:
        FileError: Another process is writing to the folder, or it cannot be written to.
    """
    with _folder(folder, folder), _claimed(folder / _LOCK, folder) as alone:
        with _told(folder):
            if alone:
                remove(folder.glob(f"{_WORKPLACE}*"))
                remove(path for path in folder.glob(".*.partial") if path.is_file())
            workplace = Path(tempfile.mkdtemp(dir=folder, prefix=_WORKPLACE))
        try:
            yield workplace
        finally:
            remove([workplace])


def writer_elsewhere(folder: Path) -> str:
    """Returns the process on another machine that writes a folder ("process 123 on HOST") or ""."""
    with suppress(OSError), (folder / _LOCK).open() as lock:
        owner = lock.read().strip()
        if owner and not owner.endswith(f" on {socket.gethostname()}"):
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return owner
    return ""


def has_locks(path: Path) -> bool:
    """Tests whether the file system of a file supports POSIX locks."""
    with suppress(FileNotFoundError), path.open() as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError as error:
            return error.errno not in _NO_LOCKS
    return True


@contextmanager
def piece(name: str, missing: dict[str, str]) -> Iterator[None]:
    """Records in `missing` why a part of a result could not be made, instead of raising.

    Thus a page or file that fails after hours of computing does not lose their other results.
    """
    try:
        yield
    except Exception as error:
        reason = (
            str(error) if isinstance(error, LeglabError) else f"{type(error).__name__}: {error}"
        )
        missing[name] = " ".join(reason.split()).removeprefix(f"{name}: ")


def cannot_write(path: Path, error: OSError) -> FileError:
    """Returns the error for a file or folder that cannot be written, with the system's reason."""
    return FileError(f"{path}: cannot be written: {error.strerror or error}", given=path)


@contextmanager
def _told(place: Path) -> Iterator[None]:
    """Converts an operating system error into the `FileError` that `place` cannot be written."""
    try:
        yield
    except OSError as error:
        if not error.strerror:
            raise
        raise cannot_write(place, error) from error


@contextmanager
def _replaced(path: Path, suffix: str = "") -> Iterator[Path]:
    """Yields an empty file next to the target of `path`; at the end it replaces the target."""
    with _told(path):
        real = regular_file(path)
        handle, name = tempfile.mkstemp(
            dir=real.parent, prefix=f".{real.name}.", suffix=f".partial{suffix}"
        )
        os.close(handle)
    try:
        yield Path(name)
        with _told(path):
            os.chmod(name, 0o666 & ~_umask())
            os.replace(name, real)
    finally:
        remove([Path(name)])


@contextmanager
def _folder(folder: Path, place: Path) -> Iterator[None]:
    """Creates a folder with its parents; at the end removes the created folders that are empty."""
    made: list[Path] = []
    with _told(place):
        above = folder
        while not above.exists():
            made.append(above)
            above = above.parent
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):
            for empty in made:
                empty.rmdir()


@contextmanager
def _claimed(lock: Path, place: Path) -> Iterator[bool]:
    """Holds a lock file, released by the system when the process ends; yields whether it is locked.

    On a file system without locks it yields False; output is still written atomically.
    """
    with _told(place):
        handle, alone = _acquire(lock, place)
    try:
        yield alone
    finally:
        if alone:  # Removed while still locked: a process that has opened it notices the removal.
            lock.unlink(missing_ok=True)
        os.close(handle)


def _lock_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock")


def _acquire(lock: Path, place: Path) -> tuple[int, bool]:
    patience = _PATIENCE
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.read(handle, 200).decode(errors="replace").strip()
            os.close(handle)
            if not owner and patience > 0:  # The owner has not written its process number yet.
                patience -= 1
                time.sleep(0.02)
                continue
            raise FileError(
                f"{place}: {owner or 'another process'} is writing it; wait for its end or give "
                "another place",
                given=place,
            ) from error
        except OSError as error:
            if error.errno in _NO_LOCKS:
                return handle, False
            os.close(handle)
            raise
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.stat(lock)):
                os.ftruncate(handle, 0)
                os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
                return handle, True
        os.close(handle)  # The previous owner removed the file between open and flock.


def regular_file(path: Path) -> Path:
    """Returns the path of a file with links resolved; refuses anything but a regular file.

    Raises:
        FileError: The path is a folder, a device, a pipe or a socket.
        OSError: The file status cannot be read.
    """
    real = Path(os.path.realpath(path))
    try:
        mode = real.stat().st_mode
    except FileNotFoundError:
        return real
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "no regular file"
        raise FileError(f"{path}: cannot be written: it is {what}", given=path)
    return real


def _carry_over(folder: Path, new: Path, made: Collection[str]) -> None:
    """Hard-links or copies the user's files, which are all but `made`, into the new folder."""

    def put(source: str, target: str) -> None:
        try:
            os.link(source, target, follow_symlinks=False)
        except OSError:  # no hard links on this file system
            shutil.copy2(source, target, follow_symlinks=False)

    for path in folder.iterdir() if folder.exists() else ():
        target = new / path.name
        if path.name in made or target.exists():
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.copytree(path, target, symlinks=True, copy_function=put)
        else:
            put(str(path), str(target))


def _exchange(new: Path, folder: Path, earlier: Path) -> None:
    """Replaces an earlier folder by a new one; `_recover` repairs an interrupted exchange."""
    if folder.exists():
        folder.rename(earlier)
    try:
        new.rename(folder)
    except OSError:
        if earlier.exists():
            earlier.rename(folder)
        raise
    remove([earlier])


def _recover(folder: Path, earlier: Path) -> None:
    """Restores the earlier folder if a process was killed before it moved in the new one."""
    if not earlier.exists():
        return
    if folder.exists():
        remove([earlier])
    else:
        earlier.rename(folder)


def remove(paths: Iterable[Path]) -> None:
    """Removes files and folders, ignoring errors; removes links, not their targets."""
    for path in list(paths):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()


def _umask() -> int:
    """Returns the process umask, so that output gets the permissions of other new files."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
