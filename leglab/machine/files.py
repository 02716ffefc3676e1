"""Files of a model (MJCF, includes, assets): digest, and a copy that loads from anywhere."""

import hashlib
import os
import re
import time
from collections.abc import Mapping, Set
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import mujoco

from leglab.base.errors import LeglabError, ModelError
from leglab.machine.library import is_shipped, model_path
from leglab.machine.plugin import load_error, load_plugin

# Age of a file's time stamps [s] up to which another change of the file may leave them unchanged,
# because the clocks of file systems tick every few milliseconds.
_TICK = 0.1
_MOST = 8  # largest number of models whose content is cached
_XML = (".xml", ".mjcf", ".urdf")
# Attributes of MJCF that name a file or a folder of assets.
_NAMED = re.compile(rb"""\b(file\w*|\w*dir)(\s*=\s*["'])([^"']*)(?=["'])""")
_APART = "absolute"  # folder for copies of files that MJCF names by absolute paths


@dataclass(frozen=True, kw_only=True)
class ModelFiles:
    """Snapshot of the files of a model.

    Attributes:
        main: The MJCF file, absolute.
        content: Contents of the MJCF file, its includes and its assets, by absolute path.
        digest: Digest of all contents and relative paths, independent of the model's folder.
    """

    main: Path
    content: Mapping[Path, bytes] = field(repr=False)
    digest: str

    def write(self, folder: Path) -> Path:
        """Writes the files with their relative paths, so that the model loads from anywhere.

        Absolute paths in MJCF are replaced by relative ones. The files that they name are copied to
        every folder to which a path may be relative: folders of MJCF files and of assets.

        Args:
            folder: Folder to create.

        Returns:
            Path of the MJCF file relative to the folder.

        Raises:
            OSError: It cannot be written.
        """
        texts = [text for file, text in self.content.items() if _is_xml(file)]
        named = [match.groups() for text in texts for match in _NAMED.finditer(text)]
        apart = {Path(os.fsdecode(path)) for _, _, path in named if path.startswith(b"/")}
        near = [file for file in self.content if not _is_below(file, apart) or file == self.main]
        root = os.path.commonpath([file.parent for file in near])
        dirs = {os.fsdecode(self._renamed(path)) for what, _, path in named if b"dir" in what}
        folders = {file.parent.relative_to(root) for file in near if _is_xml(file)}
        bases = {Path(os.path.normpath(one / base)) for one in folders for base in ("", *dirs)}
        for file, content in self.content.items():
            places = {file.relative_to(root)} if file.is_relative_to(root) else set()
            if _is_below(file, apart):
                places |= {base / _APART / file.relative_to("/") for base in bases}
            if _is_xml(file):
                content = _NAMED.sub(lambda m: m[1] + m[2] + self._renamed(m[3]), content)
            for place in places:
                (folder / place).parent.mkdir(parents=True, exist_ok=True)
                (folder / place).write_bytes(content)
        return self.main.relative_to(root)

    def _renamed(self, path: bytes) -> bytes:
        """Returns a path for the copy: an absolute path of a file of the model becomes relative."""
        known = any(_is_below(file, {Path(os.fsdecode(path))}) for file in self.content)
        return _APART.encode() + path if path.startswith(b"/") and known else path


def _is_below(file: Path, places: Set[Path]) -> bool:
    """Tests whether a file is one of the given paths or lies in one of the given folders."""
    return not places.isdisjoint((file, *file.parents))


def model_files(model: str | Path) -> ModelFiles | None:
    """Reads a model's files; None for a shipped model, which leglab's version determines.

    Files that have not changed since the last call are not read again.

    Args:
        model: A name from `model_names()` or the path of an MJCF file.

    Raises:
        LeglabError: There is no such model, MuJoCo rejects it, or a file cannot be read.
    """
    if is_shipped(model):
        return None
    main = Path(os.path.abspath(model_path(model)))
    there = _remembered.get(main)
    if there and there[0] == _state(there[1].content):
        return there[1]
    before = time.time()
    try:
        content = {file: file.read_bytes() for file in _files(main)}
    except OSError as error:
        text = f"{error.filename}: {error.strerror or error}"
        raise ModelError(f"{main.name}: cannot read {text}", given=main) from error
    digest = hashlib.sha256()
    for file in sorted(content):
        name = os.path.relpath(file, main.parent).encode()
        digest.update(hashlib.sha256(name).digest() + hashlib.sha256(content[file]).digest())
    found = ModelFiles(main=main, content=content, digest=digest.hexdigest())
    state = _state(content)
    _remembered.pop(main, None)
    if state is not None and max(max(s[2:]) for s in state) < (before - _TICK) * 1e9:
        _remembered[main] = state, found
        if len(_remembered) > _MOST:
            del _remembered[next(iter(_remembered))]
    return found


def model_digest(model: str | Path) -> str:
    """Returns the digest of a model's files; empty for a model that ships with leglab.

    Raises:
        LeglabError: As `model_files`.
    """
    found = model_files(model)
    return "" if found is None else found.digest


def since(source: Path, digest: str) -> str:
    """Returns "was removed", "has changed", or "" if the model still has the digest."""
    if not source.is_file():
        return "was removed"
    try:
        same = model_digest(source) == digest
    except LeglabError:
        same = False
    return "" if same else "has changed"


def changed_meanwhile(model: str | Path) -> ModelError:
    """Returns the error for a model whose files changed while a command used them."""
    text = f"{Path(model).name}: the model's files were changed meanwhile; give the command again"
    return ModelError(text, given=model)


# Cached models with the state of their files, by MJCF file.
_remembered: dict[Path, tuple[tuple[tuple[int, ...], ...] | None, ModelFiles]] = {}


def _state(files: Mapping[Path, bytes]) -> tuple[tuple[int, ...], ...] | None:
    """Returns inode, size and times of files; None if one is missing."""
    try:
        found = [file.stat() for file in files]
    except OSError:
        return None
    return tuple((one.st_ino, one.st_size, one.st_mtime_ns, one.st_ctime_ns) for one in found)


def _files(main: Path) -> set[Path]:
    """Returns the files of a model.

    MuJoCo has two incomplete lists, which are combined: the dependencies of the text lack the
    folder of height fields, the paths of the compiled model lack the sides of cube textures.
    """
    load_plugin()
    try:
        spec = mujoco.MjSpec.from_file(str(main))
        names = mujoco.mju_getXMLDependencies(str(main))
    except (ValueError, mujoco.FatalError) as error:
        raise load_error(error, main.name) from error
    # A model that does not compile may still compile with a run's time step or parameters.
    with suppress(ValueError, mujoco.FatalError):
        names += [os.fsdecode(name) for name in spec.compile().paths.split(b"\0") if name]
    found = {Path(os.path.abspath(main.parent / name)) for name in names}
    return {main, *(file for file in found if file.is_file())}


def _is_xml(file: Path) -> bool:
    return file.suffix.lower() in _XML
