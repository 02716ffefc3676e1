"""Compiled parts: the MuJoCo plugin library and the nanobind modules."""

from importlib.util import find_spec
from pathlib import Path

if find_spec(f"{__name__}.hydraulics") is None:
    _SOURCE = Path(__file__).parents[2]
    raise ImportError(
        f"{_SOURCE} is leglab's source without its compiled parts, and it hides an installed "
        "leglab while you stand in it: work in another folder, or use the environment of the "
        "clone (make demo, then source .venv/bin/activate)"
    )
