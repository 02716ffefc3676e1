"""Registry of models by name: models that ship with leglab, and models of plug-ins."""

from dataclasses import dataclass
from pathlib import Path

import leglab.models
from leglab.base.errors import FileError
from leglab.base.input import no_file
from leglab.base.registry import Registry


@dataclass(frozen=True, kw_only=True)
class _Model:
    path: Path
    summary: str


MODELS: Registry[_Model] = Registry("model")


def register_model(name: str, path: str | Path, *, summary: str | None = None) -> None:
    """Registers an MJCF file under a name.

    Args:
        name: Name that users give.
        path: The file.
        summary: One line for listings; None for the first sentence of the file's first comment.

    Raises:
        LeglabError: There is no such file, or another file already has the name.
    """
    path = Path(path).resolve()
    if not path.is_file():
        raise FileError(f"model {name!r}: there is no file {str(path)!r}", given=path)
    entry = _Model(path=path, summary=_first_sentence(path) if summary is None else summary)
    MODELS.add(name, entry, path)


def model_names() -> tuple[str, ...]:
    """Returns the names of all models."""
    return MODELS.names()


def model_summary(name: str) -> str:
    """Returns the one-line description of a model."""
    return MODELS.get(name).summary


# Suffixes of model files that MuJoCo's parser cannot read, with the remedy for the message.
_NO_TEXT = {
    ".mjb": "a compiled model cannot be edited; allowed: the .xml that it was compiled from",
    ".xacro": "write the URDF that it stands for: xacro MODEL.xacro > MODEL.urdf",
}


def model_path(model: str | Path) -> Path:
    """Returns the path of a model's file.

    Args:
        model: A name from `model_names()` or the path of an MJCF file.

    Raises:
        LeglabError: There is no such model.
    """
    name, path = str(model), Path(model)
    if name in MODELS.names():
        return MODELS.get(name).path
    if path.is_file():
        if way_out := _NO_TEXT.get(path.suffix.lower()):
            raise FileError(f"model {name!r} is no MJCF or URDF; {way_out}", given=path)
        return path
    if path.suffix == ".xml":
        raise FileError(f"model file {name!r}: {no_file(path)}", given=path)
    return MODELS.get(name).path  # raises, and lists the names


def is_shipped(model: str | Path) -> bool:
    """Tests whether `model` is the name of a model that ships with leglab."""
    names = MODELS.names()
    return str(model) in names and MODELS.get(str(model)).path.parent in _shipped()


def _first_sentence(path: Path) -> str:
    text = path.read_text(encoding="utf-8", errors="replace")
    comment = " ".join(text.partition("<!--")[2].partition("-->")[0].split())
    return comment.partition(". ")[0].rstrip(".")


def _shipped() -> tuple[Path, ...]:
    return tuple(Path(folder).resolve() for folder in leglab.models.__path__)


def _register_shipped() -> None:
    for path in sorted(_shipped()[0].glob("*.xml")):
        register_model(path.stem, path)


MODELS.add_loader(_register_shipped)
MODELS.add_plugins(register_model)
