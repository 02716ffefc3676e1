"""Tables of README.md and the overview, from the committed results of `adaptation_claims.py`.

`python benchmarks/adaptation_summary.py short`, `scenarios` or `controllers`. The walking leg;
RMS over joints of the true tracking error in mrad, means over seeds.
"""

import sys

import numpy as np
from adaptation_data import Cells, pooled, read

from leglab import controller_names, scenario_names
from leglab.base.scenario import scenario_summary
from leglab.cli.catalogue import severity_text
from leglab.control import controller_summary

RIG = "leg, walking"
SHOWN = ("static_feedforward", "frozen", "bsnn_arx", "oracle")
# The table of README.md: what a reader asks first.
FEW = ("nominal", "seal_wear", "cold_oil", "supply_drop", "friction_rise", "encoder_shift")
COMPARED = ("static_feedforward", "frozen", "bsnn_arx", "adaptive_backstepping")


def end(cells: Cells, scenario: str, controller: str) -> float:
    """Mean over seeds of the error in the last 5 s [mrad]; NaN where it was not run."""
    return float(np.mean(pooled(cells.get((scenario, None, controller), []), "end_rms_rad")))


def text(value: float) -> str:
    """Two decimals below 10, one above; nothing where there is no result."""
    if np.isnan(value):
        return ""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"


def short(cells: Cells) -> list[str]:
    """A row a scenario of `FEW`, the smallest error in bold."""
    lines = [
        f"| what happens | {' | '.join(f'`{name}`' for name in COMPARED)} |",
        "|---|" + "---:|" * len(COMPARED),
    ]
    for name in FEW:
        values = [end(cells, name, controller) for controller in COMPARED]
        best = np.nanmin(values)
        shown = [f"**{text(v)}**" if v == best else text(v) for v in values]
        lines.append(f"| {scenario_summary(name)} | {' | '.join(shown)} |")
    return lines


def scenarios(cells: Cells) -> list[str]:
    """A row a scenario: what it does, and the error at its end."""
    lines = [
        f"| scenario | what happens | `--severity`: default | {' | '.join(SHOWN)} |",
        "|---|---|---|" + "---:|" * len(SHOWN),
    ]
    for name in scenario_names():
        values = " | ".join(text(end(cells, name, controller)) for controller in SHOWN)
        lines.append(f"| `{name}` | {scenario_summary(name)} | {severity_text(name)} | {values} |")
    return lines


def controllers(cells: Cells) -> list[str]:
    """A row a controller: what it does, and its error without and with a change."""
    lines = [
        "| controller | law | `nominal` | `seal_wear` | median of all changes |",
        "|---|---|---:|---:|---:|",
    ]
    for name in controller_names():
        changed = [end(cells, s, name) for s in scenario_names() if s != "nominal"]
        known = [value for value in changed if not np.isnan(value)]
        median = float(np.median(known)) if known else np.nan
        values = [end(cells, "nominal", name), end(cells, "seal_wear", name), median]
        lines.append(f"| `{name}` | {controller_summary(name)} | {' | '.join(map(text, values))} |")
    return lines


def main() -> None:
    """Prints a table."""
    known = {"short": short, "scenarios": scenarios, "controllers": controllers}
    if len(sys.argv) != 2 or sys.argv[1] not in known:
        raise SystemExit(f"usage: adaptation_summary.py {'|'.join(known)}")
    _, rigs = read()
    print("\n".join(known[sys.argv[1]](rigs[RIG])))


if __name__ == "__main__":
    main()
