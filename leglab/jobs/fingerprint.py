"""Digest of the code, which tells whether stored results were made by this version."""

import hashlib
import importlib
from functools import cache
from pathlib import Path

from leglab.base import plugins

# Listed one by one, since in a source checkout some are links to folders outside `leglab`.
_PACKAGES = ("leglab", "leglab.controllers", "leglab.scenarios", "leglab.models", "leglab._native")


def fingerprint() -> str:
    """Returns a digest of all code and data that a result may depend on, including plug-ins."""
    return own_fingerprint() + plugins.code_digest()


@cache
def own_fingerprint() -> str:
    """Returns a digest of all code and data of leglab, without plug-ins."""
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
