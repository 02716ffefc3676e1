"""How fast and how right leglab is: scripts that measure, and what they share."""

from importlib.util import find_spec

if find_spec("joblib") is None:
    raise ImportError(
        "benchmarks needs the environment of the clone: make .venv/installed, then "
        "source .venv/bin/activate"
    )
