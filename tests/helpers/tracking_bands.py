"""Runs the regression matrix: `python -m tests.helpers.tracking_bands` compares with the bands.

`--review PAGE.html` writes a page with each figure before and now, by which a change of behaviour
is looked at; `--write` makes the present figures the new bands, where it is wanted.
"""

import argparse
import json
import platform
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.results import commit
from benchmarks.suite.sections import Group, tables_page
from leglab import RunSettings, run_scenario
from leglab.base.output import write_atomically
from leglab.report.page.shell import Table
from leglab.runs.preparation import scenario_of

BANDS = Path(__file__).parents[1] / "data" / "tracking_bands.toml"

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
DEFAULTS = {"scenario": "seal_wear", "controller": "bsnn_arx", "duration": DURATION}

# Parts of a run by their start and end after the change [s].
PARTS = {"before": (-2.0, 0.0), "first": (0.0, 1.0), "second": (1.0, 2.0), "end": (3.0, 5.0)}


def measure(**settings: object) -> dict[str, float]:
    """RMS tracking error over all joints [mrad] in each part of a run."""
    options = {**DEFAULTS, **settings}
    history = run_scenario(RunSettings(**options)).history
    assert not history.failure, history.failure
    after = history.time - options["duration"] / 2
    return {
        part: float(1e3 * np.sqrt(np.mean(history.error[(after >= start) & (after < end)] ** 2)))
        for part, (start, end) in PARTS.items()
    }


def settings_of(case: str) -> dict[str, object]:
    """Scenario, controller, model, reference and seed of a case, defaults filled in."""
    full = RunSettings(**{**DEFAULTS, **CASES[case]})
    reference = full.reference or scenario_of(full).reference
    found = {name: getattr(full, name) for name in ("scenario", "controller", "model", "seed")}
    return {**found, "reference": reference, "duration": full.duration}


def entries() -> dict[str, dict[str, Any]]:
    """What is committed by case: `settings`, `mrad` by part, and the `commit` that made them."""
    return tomllib.loads(BANDS.read_text())["cases"] if BANDS.exists() else {}


def read() -> dict[str, dict[str, float]]:
    """The committed figures by case and part [mrad]."""
    return {case: entry["mrad"] for case, entry in entries().items()}


def outside(case: str, have: dict[str, float]) -> dict[str, str]:
    """Parts of a case whose figure has left its band, with both figures."""
    want = read()[case]
    return {
        part: f"{have[part]:.4g} mrad, band {value:.4g} +-{WIDTH:.0%}"
        for part, value in want.items()
        if not abs(have[part] - value) <= WIDTH * value
    }


def rounded(figures: dict[str, float]) -> dict[str, float]:
    """As many digits as are committed."""
    return {part: float(f"{value:.6g}") for part, value in figures.items()}


def bands_text(measured: dict[str, dict[str, float]], commit: str) -> str:
    """The file: figures that are what they were keep the commit that made them.

    Args:
        measured: Figures by case and part [mrad]; of other cases those of the file are kept.
        commit: That made them.
    """
    known = entries()
    lines = [
        "# RMS tracking errors [mrad]. Not to be edited: "
        "`python -m tests.helpers.tracking_bands --write`.",
        f"# MuJoCo {mujoco.__version__}, NumPy {np.__version__}, {platform.machine()}, "
        f"Python {platform.python_version()}, leglab {metadata.version('leglab')}.",
    ]
    for case in CASES:
        before = known.get(case, {})
        mrad = rounded(measured[case]) if case in measured else before["mrad"]
        made = before["commit"] if before.get("mrad") == mrad else commit
        lines += ["", f'[cases."{case}"]', f"settings = {_inline(settings_of(case))}"]
        lines += [f"mrad = {_inline(mrad)}", f"commit = {json.dumps(made)}"]
    return "\n".join(lines) + "\n"


def _inline(content: dict[str, Any]) -> str:
    return f"{{ {', '.join(f'{name} = {json.dumps(value)}' for name, value in content.items())} }}"


def review_page(measured: dict[str, dict[str, float]], commit: str) -> str:
    """The page of a change of numbers: each figure before and after, the largest change first."""
    known, rows, left = entries(), [], set()
    for case, have in measured.items():
        before, settings = known.get(case, {}), settings_of(case)
        for part, value in have.items():
            old = before.get("mrad", {}).get(part)
            change = value / old - 1.0 if old else None
            out = change is None or abs(change) > WIDTH
            left |= {case} if out else set()
            told = "new" if change is None else f"{change:+.2%}"
            cells = [str(settings[n]) for n in ("scenario", "controller", "model", "seed")]
            figures = ["" if old is None else f"{old:.4g}", f"{value:.4g}", told]
            row = (case, part, *cells, before.get("commit", ""), *figures, "left" if out else "")
            rows.append((abs(change) if change is not None else float("inf"), row))
    rows.sort(key=lambda one: -one[0])
    head = ("case", "part", "scenario", "controller", "model", "seed", "made by commit")
    head += ("before, mrad", f"now ({commit}), mrad", "change", f"band of {WIDTH:.0%}")
    spans = ", ".join(f"{part}: {a:g} to {b:g} s" for part, (a, b) in PARTS.items())
    changed = [row for size, row in rows if size > 0.0005]
    same = [row for size, row in rows if not size > 0.0005]
    sections = [
        Group(
            name="changed",
            title="Changed",
            text=f"RMS tracking error over all joints, after the change of the machine {spans}.",
            tables=[Table(caption="The largest change first", head=head, rows=changed, words=7)],
        ),
        Group(
            name="same",
            title="As before",
            tables=[Table(caption="Less than 0.05 % apart", head=head, rows=same, words=7)],
        ),
    ]
    headline = f"{len(left)} of {len(measured)} cases leave their bands"
    return tables_page("bench", "Tracking bands: before and now", headline, sections)


def main() -> None:
    """Shows the difference and, if asked, writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", help="default: all")
    parser.add_argument("--write", action="store_true", help="make the present figures the bands")
    parser.add_argument("--review", type=Path, metavar="HTML", help="write a page: before and now")
    options = parser.parse_args()
    if unknown := [case for case in options.cases if case not in CASES]:
        parser.error(f"no case {unknown[0]!r}; allowed: {', '.join(map(repr, CASES))}")
    known, measured = read() if BANDS.exists() else {}, {}
    for case in options.cases or CASES:
        measured[case] = measure(**CASES[case])
        before = known.get(case, {})
        for part, value in measured[case].items():
            old = before.get(part)
            change = f"{value / old - 1:+.2%}" if old else "new"
            print(f"{case:28s}{part:8s}{old or float('nan'):10.4f} -> {value:10.4f}  {change}")
    now = commit()
    if options.review:
        page = review_page(measured, now)
        write_atomically(options.review, lambda stream: stream.write(page.encode()))
        print(f"written to {options.review}")
    if options.write:
        text = bands_text(measured, now)
        write_atomically(BANDS, lambda stream: stream.write(text.encode()))
        print(f"written to {BANDS}")


if __name__ == "__main__":
    main()
