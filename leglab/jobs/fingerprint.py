"""Digest of the code, by which kept results are known to be of it."""

import hashlib
import importlib
from functools import cache
from pathlib import Path

from leglab.base import plugins

# Some lie elsewhere than below the first: the source checkout has links.
_PACKAGES = ("leglab", "leglab.controllers", "leglab.scenarios", "leglab.models", "leglab._native")


def fingerprint() -> str:
    """Digest of all code and data that a result may depend on, plug-ins included."""
    return own_fingerprint() + plugins.code_digest()


@cache
def own_fingerprint() -> str:
    """Digest of all code and data of leglab."""
    packages = [importlib.import_module(name) for name in _PACKAGES]
    folders = {Path(folder) for package in packages for folder in package.__path__}
    files = {
        file.resolve()
        for folder in folders
        for file in folder.rglob("*")
        if file.suffix in (".py", ".xml", ".toml", ".obj", ".so")
    }
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.read_bytes())
    return digest.hexdigest()
