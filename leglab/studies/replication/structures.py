"""Structures of the deployed identifier for the measured benchmarks.

Each is the first of its grid in `selection`, which looks at the training part alone
(`python benchmarks/real_data.py --select` shows the ranking).
"""

from typing import Any

SILVERBOX: dict[str, Any] = {
    "na": 4,
    "nb": 5,
    "nk": 0,
    "splines": 10,
    "output_lags": (1, 2),
    "reach": 0.85,
    "outside": "quadratic",
    "output_error_after": 2000,
}

ACTUATOR: dict[str, Any] = {
    "na": 6,
    "nb": 6,
    "nk": 1,
    "splines": 12,
    "input_lags": (1, 2, 3),
    "initial_gain": 30.0,
}
