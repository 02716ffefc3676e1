"""Tables of README.md and the overview, from the committed results of `adaptation_claims.py`.

`python benchmarks/adaptation_summary.py short`, `scenarios`, `controllers` or `origin`. The walking
leg, specimens drawn by the seeds unless a row says "exact machine"; RMS over joints of the true
tracking error in the last strides in mrad, means over seeds.
"""

import sys

import numpy as np
import results
from adaptation_data import ADAPTIVE, Cells, mrad, read
from adaptation_tables import times

from leglab import controller_names, scenario_names
from leglab.base.scenario import scenario_summary
from leglab.cli.catalogue import severity_text
from leglab.control import controller_summary

RIG, EXACT = "leg, walking", "leg, walking, exact machine"
SHOWN = ("static_feedforward", "frozen", ADAPTIVE, "oracle")
# The table of README.md: what a reader asks first.
FEW = ("nominal", "seal_wear", "cold_oil", "supply_drop", "friction_rise", "encoder_shift")
COMPARED = ("static_feedforward", "frozen", ADAPTIVE, "adaptive_backstepping")


def end(cells: Cells, scenario: str, controller: str) -> float:
    """Mean over seeds of the error in the last strides [mrad]; NaN where it was not run."""
    if controller == "frozen":  # the twin of the adaptive runs; where nothing changes, the same
        key = "end" if scenario == "nominal" else "twin_end"
        return float(np.mean(mrad(cells.get((scenario, None, ADAPTIVE), []), key)))
    return float(np.mean(mrad(cells.get((scenario, None, controller), []), "end")))


def text(value: float) -> str:
    """Two decimals below 10, one above; nothing where there is no result."""
    if np.isnan(value):
        return ""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"


def short(rigs: dict[str, Cells]) -> list[str]:
    """A row a scenario of `FEW`, the smallest error in bold; the exact machine last."""
    lines = [
        f"| what happens | {' | '.join(f'`{name}`' for name in COMPARED)} | 90 % undone after |",
        "|---|" + "---:|" * (len(COMPARED) + 1),
    ]
    parts = [(rigs[RIG], name, scenario_summary(name)) for name in FEW]
    parts.append((rigs[EXACT], "nominal", "nothing, on the machine exactly as its model has it"))
    for cells, name, told in parts:
        values = [end(cells, name, controller) for controller in COMPARED]
        best = np.nanmin(values)
        shown = [f"**{text(v)}**" if v == best else text(v) for v in values]
        soon = [run["t90"] for run in cells[name, None, ADAPTIVE] if run["told"]]
        lines.append(f"| {told} | {' | '.join(shown)} | {times(soon, ' s') if soon else ''} |")
    return lines


def scenarios(rigs: dict[str, Cells]) -> list[str]:
    """A row a scenario: what it does, and the error at its end."""
    lines = [
        f"| scenario | what happens | `--severity`: default | {' | '.join(SHOWN)} |",
        "|---|---|---|" + "---:|" * len(SHOWN),
    ]
    for name in scenario_names():
        values = " | ".join(text(end(rigs[RIG], name, controller)) for controller in SHOWN)
        lines.append(f"| `{name}` | {scenario_summary(name)} | {severity_text(name)} | {values} |")
    return lines


def controllers(rigs: dict[str, Cells]) -> list[str]:
    """A row a controller: what it does, and its error without and with a change."""
    lines = [
        "| controller | law | `nominal` | `seal_wear` | median of all changes |",
        "|---|---|---:|---:|---:|",
    ]
    for name in controller_names():
        changed = [end(rigs[RIG], s, name) for s in scenario_names() if s != "nominal"]
        known = [value for value in changed if not np.isnan(value)]
        median = float(np.median(known)) if known else np.nan
        values = [end(rigs[RIG], "nominal", name), end(rigs[RIG], "seal_wear", name), median]
        lines.append(f"| `{name}` | {controller_summary(name)} | {' | '.join(map(text, values))} |")
    return lines


def main() -> None:
    """Prints a table."""
    known = {"short": short, "scenarios": scenarios, "controllers": controllers}
    if len(sys.argv) != 2 or sys.argv[1] not in (*known, "origin"):
        raise SystemExit(f"usage: adaptation_summary.py {'|'.join((*known, 'origin'))}")
    record, rigs = read()
    if sys.argv[1] == "origin":
        print(results.origin_line(record))
    else:
        print("\n".join(known[sys.argv[1]](rigs)))


if __name__ == "__main__":
    main()
