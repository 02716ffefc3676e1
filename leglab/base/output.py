"""Output: a file or folder is there as a whole or not at all, and one process at a time writes it.

What is being made stands under a hidden name that no other process uses, and takes its place at the
end. What a killed process left behind goes when its place is written to again.
"""

import errno
import fcntl
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
from typing import BinaryIO

from leglab.base.errors import FileError, LeglabError

_LOCK = ".leglab.lock"
_WORKPLACE = ".leglab-work."
# What flock says on file systems without locks, some of clusters among them.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF)
_PATIENCE = 50  # times that the owner of a lock is asked for, in all a second


def write_atomically(path: str | Path, write: Callable[[BinaryIO], object]) -> None:
    """Writes a file as a whole or leaves it as it was; of several processes the last one wins.

    Args:
        path: The file. A symbolic link stays one; its target is replaced.
        write: Writes the content into the binary stream that it is given.

    Raises:
        FileError: The folder does not exist or cannot be written to, the disk is full, or the
            path is no regular file.
    """
    path = Path(path)
    with _replaced(path) as partial, _told(path), partial.open("wb") as stream:
        write(stream)


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yields where a program is to write a file, which takes its place at the end.

    Args:
        path: The file; its folder is made. A symbolic link stays one; its target is replaced.

    Yields:
        An empty file with the same suffix.

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
    """Refuses a folder that exists.

    Args:
        folder: Where results shall go.
        mark: File by which a folder with earlier results is known.
        overwrite: Whether earlier results may be replaced.

    Raises:
        FileError: It exists and may not be replaced, holds something else, or is the working
            folder or one that holds it.
    """
    with _told(folder):
        if not os.path.lexists(folder):
            return
        if not overwrite:
            told = f"output folder {str(folder)!r} exists; remove it or give --overwrite"
            raise FileError(told, given=folder)
        if not folder.is_dir() or (any(folder.iterdir()) and not (folder / mark).exists()):
            raise FileError(f"{str(folder)!r} holds no {mark}: it is left as it is", given=folder)
        if Path.cwd().is_relative_to(os.path.realpath(folder)):
            told = f"{str(folder)!r} is or holds the working folder: give another one"
            raise FileError(told, given=folder)


def check_apart(folder: Path, inputs: Iterable[Path]) -> None:
    """Refuses a folder that holds what is read: with earlier results it would be replaced.

    Raises:
        FileError: Names the input.
    """
    real = os.path.realpath(folder)
    for path in inputs:
        if Path(os.path.realpath(path)).is_relative_to(real):
            told = f"{path} lies in the output folder {str(folder)!r}: give another one"
            raise FileError(told, given=path)


@contextmanager
def new_folder(
    folder: Path, *, mark: str, made: Sequence[str], overwrite: bool = False
) -> Iterator[Path]:
    """Yields where the content of a folder is to be made, which takes its place at the end.

    Args:
        folder: Where results shall go; parents are made. A symbolic link stays one.
        mark: File by which a folder with earlier results is known.
        made: Names of all files and folders that results may have there; what else the folder
            holds is the user's and stays.
        overwrite: Whether earlier results may be replaced; they stay until the end.

    Yields:
        An empty folder beside it.

    Raises:
        FileError: As `check_folder`, another process is writing the folder, or it cannot be
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
    """Keeps other processes from writing to a folder whose files are replaced one by one.

    Args:
        folder: Where results go; it is made, and goes again if it stays empty.

    Yields:
        An empty folder inside it, which goes at the end: files are made there and moved.

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
    """Process of another machine that writes to a folder now: "process 123 on HOST", or nothing."""
    with suppress(OSError), (folder / _LOCK).open() as lock:
        owner = lock.read().strip()
        if owner and not owner.endswith(f" on {socket.gethostname()}"):
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return owner
    return ""


def has_locks(path: Path) -> bool:
    """Whether the file system of a file has the locks of POSIX."""
    with suppress(FileNotFoundError), path.open() as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError as error:
            return error.errno not in _NO_LOCKS
    return True


@contextmanager
def piece(name: str, missing: dict[str, str]) -> Iterator[None]:
    """Records in `missing` why a part of a result could not be made, instead of raising.

    A search of hours is not lost with a page or a file that comes after it.
    """
    try:
        yield
    except Exception as error:
        reason = (
            str(error) if isinstance(error, LeglabError) else f"{type(error).__name__}: {error}"
        )
        missing[name] = " ".join(reason.split()).removeprefix(f"{name}: ")


def cannot_write(path: Path, error: OSError) -> FileError:
    """Returns the error of a file or folder that cannot be written, with the system's reason."""
    return FileError(f"{path}: cannot be written: {error.strerror or error}", given=path)


@contextmanager
def _told(place: Path) -> Iterator[None]:
    """Says of what the system refuses that the place cannot be written."""
    try:
        yield
    except OSError as error:
        if not error.strerror:
            raise
        raise cannot_write(place, error) from error


@contextmanager
def _replaced(path: Path, suffix: str = "") -> Iterator[Path]:
    """Yields an empty file beside a file, behind links, which takes its place at the end."""
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
    """Makes a folder with its parents; of those that it made, the empty ones go at the end."""
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
    """Holds a lock, which the system frees however the process ends; yields whether there is one.

    A file system without locks has none: what is written there is whole all the same.
    """
    with _told(place):
        handle, alone = _acquire(lock, place)
    try:
        yield alone
    finally:
        if alone:  # Removed while it is held: who opened it meanwhile sees that it is gone.
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
            if not owner and patience > 0:  # Its owner has yet to write who it is.
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
        os.close(handle)  # Its last owner removed it between the two calls.


def regular_file(path: Path) -> Path:
    """Returns the file itself, behind links; refuses what no file may replace.

    Raises:
        FileError: It is a folder, a device, a pipe or a socket.
        OSError: It cannot be looked at.
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
    """Puts what a folder holds beside results into the new one as well: linked, else copied."""

    def put(source: str, target: str) -> None:
        try:
            os.link(source, target, follow_symlinks=False)
        except OSError:  # Not on this file system.
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
    """Puts a new folder in the place of an earlier one; `_recover` mends what a kill interrupts."""
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
    """Brings back what a process had moved aside that was killed before it moved the new one in."""
    if not earlier.exists():
        return
    if folder.exists():
        remove([earlier])
    else:
        earlier.rename(folder)


def remove(paths: Iterable[Path]) -> None:
    """Removes files and folders as far as the system lets; links go, not what they lead to."""
    for path in list(paths):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()


def _umask() -> int:
    """Returns which rights new files do not get: a result is as readable as any other new file."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
