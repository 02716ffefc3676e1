"""Runs the regression matrix; `python -m tests.tracking_bands` shows how it differs from the bands.

`--write` makes the present figures the new bands: a change of behaviour that is wanted.
"""

import argparse
import platform
import tomllib
from importlib import metadata
from pathlib import Path

import mujoco
import numpy as np

from leglab import RunSettings, run_scenario

BANDS = Path(__file__).parent / "data" / "tracking_bands.toml"

# Half width of a band. Same code, same machine: same bits. Another processor or library rounds
# otherwise, and what is learned differs in its last digits; half the learning gain differs more.
WIDTH = 0.02

# name: settings. Change at half time.
CASES = {
    "leg walking pd": {"controller": "pd"},
    "leg walking static": {"controller": "static_feedforward"},
    "leg walking": {},
    "leg walking hot_oil": {"scenario": "hot_oil"},
    "leg squat": {"reference": "squat"},
    "leg random stride": {"reference": "random_stride", "seed": 3},
    "leg_rail squat": {"model": "leg_rail", "reference": "squat", "scenario": "supply_drop"},
    "knee_bench": {"model": "knee_bench"},
    "knee_bench valve_wear": {"model": "knee_bench", "scenario": "valve_wear"},
    "knee_bench frozen": {"model": "knee_bench", "controller": "frozen"},
    "knee_bench arx": {"model": "knee_bench", "controller": "arx"},
    "knee_bench paper": {"model": "knee_bench", "controller": "bsnn_arx_paper"},
    "knee_bench backstepping": {"model": "knee_bench", "controller": "adaptive_backstepping"},
    "leg walking adrc": {"controller": "adrc"},
    "leg walking ilc": {"controller": "ilc"},
    "leg walking pressure": {"controller": "bsnn_arx_pressure"},
}
DURATION = 10.0

# Parts of a run by their start and end after the change [s].
PARTS = {"before": (-2.0, 0.0), "first": (0.0, 1.0), "second": (1.0, 2.0), "end": (3.0, 5.0)}


def measure(**settings: object) -> dict[str, float]:
    """RMS tracking error over all joints [mrad] in each part of a run."""
    options = {"scenario": "seal_wear", "controller": "bsnn_arx", "duration": DURATION, **settings}
    history = run_scenario(RunSettings(**options)).history
    assert not history.failure, history.failure
    after = history.time - options["duration"] / 2
    return {
        part: float(1e3 * np.sqrt(np.mean(history.error[(after >= start) & (after < end)] ** 2)))
        for part, (start, end) in PARTS.items()
    }


def read() -> dict[str, dict[str, float]]:
    """The committed figures by case and part [mrad]."""
    return tomllib.loads(BANDS.read_text())["cases"]


def outside(case: str, have: dict[str, float]) -> dict[str, str]:
    """Parts of a case whose figure has left its band, with both figures."""
    want = read()[case]
    return {
        part: f"{have[part]:.4g} mrad, band {value:.4g} +-{WIDTH:.0%}"
        for part, value in want.items()
        if not abs(have[part] - value) <= WIDTH * value
    }


def main() -> None:
    """Shows the difference and, if asked, writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="make the present figures the bands")
    options = parser.parse_args()
    known = read() if BANDS.exists() else {}
    lines = [
        "# RMS tracking errors [mrad]. Not to be edited: `python -m tests.tracking_bands --write`.",
        f"# MuJoCo {mujoco.__version__}, NumPy {np.__version__}, {platform.machine()}, "
        f"Python {platform.python_version()}, leglab {metadata.version('leglab')}.",
    ]
    for case, settings in CASES.items():
        have = measure(**settings)
        row = ", ".join(f"{part} = {value:.6g}" for part, value in have.items())
        lines.append(f'cases."{case}" = {{ {row} }}')
        before = known.get(case, {})
        for part, value in have.items():
            old = before.get(part)
            change = f"{value / old - 1:+.2%}" if old else "new"
            print(f"{case:28s}{part:8s}{old or float('nan'):10.4f} -> {value:10.4f}  {change}")
    if options.write:
        BANDS.write_text("\n".join(lines) + "\n")
        print(f"written to {BANDS}")


if __name__ == "__main__":
    main()
