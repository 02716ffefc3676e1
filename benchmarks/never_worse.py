"""Purpose of the slow map beside the learned one.

Walking leg, specimens of tolerance 0.1, one fault each of all cylinders, of the benchmarks'
largest size and of one drawn below it. `bsnn_arx` stands beside itself without the slow map. Over
any two seconds from 7 s on its error is compared with that of `static_feedforward`, and after the
change with that of `frozen`.
"""

import argparse
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.adaptation_faults import SAFE_FROM
from benchmarks.live_names import t90_cells
from benchmarks.specimens import KINDS, drawn_size, first_change, run_specimen
from leglab.base.scale import rms
from leglab.causes.table import CAUSES
from leglab.runs.clock import adaptation
from leglab.runs.metrics import sliding_rms

FAULTS = tuple(dict.fromkeys(cause.name for cause, _ in KINDS))
FIRST_SEED = 6000  # of no run that a setting was chosen by
WINDOWS = ((0.0, 0.3), (0.3, 0.6), (0.6, 1.2), (1.2, 2.4), (2.4, 4.8), (4.8, 7.2))  # after, s
WITHOUT, WITH = "without", "with"
LABELS = {WITHOUT: {"settle_time": 0.0}, WITH: {}}


def judged(case: tuple[str, float, int]) -> dict[str, Any]:
    """Figures of one fault, by label."""
    fault, size, seed = case

    def run(controller: str, **config: float) -> Any:
        made = run_specimen(
            seed, scenario=fault, severity=size, controller=controller, controller_config=config
        )
        assert not made.history.failure, (case, made.history.failure)
        return made

    static = run("static_feedforward").history
    first = run("bsnn_arx", **LABELS[WITHOUT])
    change = first_change(first)
    frozen = run("frozen", stop_time=change).history
    found: dict[str, Any] = {"fault": fault, "size": size, "seed": seed}
    for label, config in LABELS.items():
        made = run("bsnn_arx", **config) if config != LABELS[WITHOUT] else first
        history = made.history
        worst, calibrated = (sliding_rms(h.time, h.error, 2.0) for h in (history, static))
        counted = history.time >= SAFE_FROM
        after = history.time - change
        clock = adaptation(
            made.scenario, 1.2, history.time, history.error, made.joints, twin=frozen.error
        )
        parts = [(after >= start) & (after < end) for start, end in WINDOWS]
        found[label] = {
            "worst": float((worst / calibrated)[counted].max()),
            "ratio": [rms(history.error[p]) / rms(frozen.error[p]) for p in parts],
            "t90": clock.t90_s,
            "clocked": clock.level_rad is not None,
        }
    return found


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All cases."""
    cases = []
    for seed in range(FIRST_SEED, FIRST_SEED + options.specimens):
        for number, fault in enumerate(FAULTS):
            rng = np.random.default_rng([seed, number])
            cause = CAUSES[fault]
            side = cause.sides[int(rng.integers(len(cause.sides)))]
            for share in (1.0, rng.random()):
                cases.append((fault, float(drawn_size(cause, side, share)), seed))
    return [judged(case) for case in cases]


def tables(found: list[dict[str, Any]]) -> str:
    """All faults together, then one by one."""
    spans = [f"{start:g}-{end:g} s" for start, end in WINDOWS]
    head = ["slow map", "runs", "worst 2 s over static", *spans, "t90, s", "never", "of"]
    rows = []
    for label in LABELS:
        ratio = np.array([case[label]["ratio"] for case in found])
        for name, values in (
            ("geometric mean", np.exp(np.log(ratio).mean(axis=0))),
            ("95 %", np.percentile(ratio, 95, axis=0)),
        ):
            row = [f"{label}, {name}", str(len(found)), _worst(found, label)]
            row += [results.number(x, 2) for x in values]
            median, _, never = t90_cells(found, label)
            rows.append(row + ([median, *never.split(" of ")] if name != "95 %" else ["", "", ""]))
    text = results.table(head, rows)
    head = ["fault", "runs"]
    for label in LABELS:
        head += [f"worst, {label}", f"0.3-0.6 s, {label}", f"1.2-2.4 s, {label}", f"t90, {label}"]
    rows = []
    for fault in FAULTS:
        own = [case for case in found if case["fault"] == fault]
        row = [fault, str(len(own))]
        for label in LABELS:
            mean = np.exp(np.log([case[label]["ratio"] for case in own]).mean(axis=0))
            row += [_worst(own, label), *(results.number(mean[k], 2) for k in (1, 3))]
            row += t90_cells(own, label)[:1]
        rows.append(row)
    return text + "\n" + results.table(head, rows)


def _worst(found: list[dict[str, Any]], label: str) -> str:
    return results.number(max(case[label]["worst"] for case in found), 2)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--specimens", type=int, default=2, help="how many")
