"""How slow wear is followed and named.

Walking leg, specimens of tolerance 0.1, `bsnn_arx_bank`. A part wears on a straight line from 40 s
on, so fast that it has its size after 600 s; the run ends before. What is said is held against
the size that the scenario gives the machine. Oil that warms is no wear, and is to be told as what
it is; where nothing changes nothing is to be said.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import results
from benchmarks.specimens import specimen, window_rms
from leglab import RunSettings
from leglab.base.scenario import ParameterChange, Scenario, get_scenario
from leglab.causes.fault_names import FaultTrend
from leglab.causes.table import CAUSES
from leglab.control.feedforward.health import HealthMonitor
from leglab.machine.simulation import Simulation
from leglab.runs.loop import Loop

BANK, START, RAMP = "bsnn_arx_bank", 40.0, 600.0  # s
STRIDE = 1.2  # s

# Label: scenario, element, severity at the end of the ramp, duration of the run [s].
WEAR: dict[str, tuple[str, str | None, float, float]] = {
    "seal wear (all)": ("seal_wear", None, 10.0, 160.0),
    "seal wear (knee)": ("seal_wear", "knee", 10.0, 160.0),
    "friction (all)": ("friction_rise", None, 4.0, 160.0),
    "external leak (hip pitch)": ("external_leak", "hip_pitch", 5e-13, 160.0),
    "worn valves (all)": ("valve_wear", None, 0.06, 160.0),
    "null shift (knee)": ("valve_null_shift", "knee", 0.04, 160.0),
    "supply falls": ("supply_drop", None, 100.0, 160.0),
}
# Label: scenario, severity, duration [s]; what is no wear.
SOUND: dict[str, tuple[str, float | None, float]] = {
    "cold start at 0 °C": ("cold_start", 0.0, 120.0),
    "cold start at 20 °C": ("cold_start", 20.0, 120.0),
    "oil to 70 °C": ("hot_oil", 70.0, 160.0),
    "nominal": ("nominal", None, 160.0),
}


def followed(case: tuple[str, int]) -> dict[str, Any]:
    """Figures of one case."""
    label, seed = case
    if label in WEAR:
        scenario, element, severity, duration = WEAR[label]
    else:
        (scenario, severity, duration), element = SOUND[label], None  # type: ignore[assignment]
    ramped = scenario not in ("cold_start", "nominal")
    settings = specimen(seed, scenario="nominal", controller=BANK)
    changes = get_scenario(scenario, duration=duration, severity=severity, element=element).changes
    if ramped:
        # The ramp is cut where the run ends: the machine is then on its way, from its own values.
        span = duration - START
        machine = Loop(settings, scenario=Scenario(name="nominal", duration=1.0)).simulation
        changes = tuple(_begun(changes, machine, span))
    loop = Loop(settings, scenario=Scenario(name=scenario, duration=duration, changes=changes))
    health: HealthMonitor = loop.controller.health  # type: ignore[union-attr]
    history = loop.run()
    assert not history.failure, (case, history.failure)
    events = loop.controller.events  # type: ignore[union-attr]
    last = health.trends[-1] if health.trends else None
    found: dict[str, Any] = {
        "label": label,
        "seed": seed,
        "events": [f"{e.names[-1].fault} {e.names[-1].element}" for e in events],
        "trends": [f"{t.fault} {t.element}" for t in health.trends],
        "faults": [f"{t.fault} {t.element}" for t in health.trends if not t.condition],
    }
    if label not in WEAR or last is None:
        return found | {"last": last and last.model_dump()}
    rate = (WEAR[label][2] - _healthy(scenario)) / RAMP
    first = health.trends[0]
    at_naming = window_rms(history.error, history.time, first.time - 2 * STRIDE, first.time)
    before = window_rms(history.error, history.time, START - 10 * STRIDE, START)
    return found | _judged(last, scenario, element, rate) | {
        "named_s": first.time - START,
        "named_size": _healthy(scenario) + rate * (first.time - START),
        "error_ratio": at_naming / before,
    }  # fmt: skip


def _begun(
    changes: Sequence[ParameterChange], machine: Simulation, span: float
) -> Iterator[ParameterChange]:
    """The first seconds of ramps, from the machine's own values: not all are the scenario's."""
    for change in changes:
        whole = replace(change, start=0.0, ramp_duration=RAMP)
        for element in machine.elements:
            if change.applies_to(element) and machine.has(element, change.parameter):
                end = whole.value_at(span, machine.parameter(element, change.parameter))
                cut = replace(change, element=element, kind="set", value=end)
                yield replace(cut, start=START, ramp_duration=span)


def _judged(last: FaultTrend, scenario: str, element: str | None, rate: float) -> dict[str, Any]:
    """Last prediction beside the truth."""
    healthy = _healthy(scenario)
    size = healthy + rate * (last.seen - START)
    right = last.fault == scenario and last.element == (element or "all")
    found: dict[str, Any] = {"right": right, "size": size, "last": last.model_dump()}
    if right and last.end_of_life is not None:
        found["remaining"] = (last.end_of_life - size) / rate
    return found


def _healthy(scenario: str) -> float:
    """Severity that changes nothing."""
    return CAUSES[scenario].healthy_magnitude()


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All cases."""
    labels = options.cases.split(",") if options.cases else [*WEAR, *SOUND]
    for label in labels:
        if label not in {**WEAR, **SOUND}:
            raise SystemExit(f"--cases: {label!r} is none of {', '.join([*WEAR, *SOUND])}")
    seeds = range(options.first, options.first + options.specimens)
    Loop(RunSettings(scenario="nominal", controller=BANK))  # makes the bank once
    items = [(label, seed) for seed in seeds for label in labels]
    return results.resumed(followed, items, folder=options.keep, jobs=options.jobs)


def tables(found: list[dict[str, Any]]) -> str:
    """Tables of worn machines; then of sound ones."""
    head = ["wears", "specimen", "named", "after, s", "true size then", "error then, times"]
    head += ["size at the end", "true", "life left, s", "true"]
    rows = []
    for case in (x for x in found if x["label"] in WEAR):
        last = case["last"] or {}
        row = [case["label"], str(case["seed"])]
        row += [", ".join(case["trends"] + [f"at once: {e}" for e in case["events"]]) or "nothing"]
        if "size" in case:
            row += [_n(case["named_s"]), _n(case["named_size"]), _n(case["error_ratio"])]
            row += [_span(last, "size", "low", "high"), _n(case["size"])]
            row += [_span(last, "remaining", "remaining_low", "remaining_high")]
            row += [_n(case.get("remaining"))]
        rows.append([*row, *[""] * (len(head) - len(row))])
    sound = ["does not wear", "specimens", "faults said", "conditions said"]
    others = []
    for label in dict.fromkeys(x["label"] for x in found if x["label"] in SOUND):
        own = [x for x in found if x["label"] == label]
        faults = sorted({name for x in own for name in x["faults"] + x["events"]})
        told = sorted({name for x in own for name in x["trends"]} - set(faults))
        others.append([label, str(len(own)), ", ".join(faults) or "none", ", ".join(told)])
    return results.table(head, rows) + "\n" + results.table(sound, others)


def _n(value: float | None) -> str:
    return results.number(value, 3)


def _span(last: dict[str, Any], *names: str) -> str:
    """A value with both ends of its interval."""
    value, low, high = (last.get(name) for name in names)
    if value is None:
        return ""
    return f"{_n(value)} ({_n(low)} to {'no end' if high is None else _n(high)})"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--specimens", type=int, default=1, help="how many")
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--cases", default="", help="only these, separated by commas")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    parser.add_argument("--keep", type=Path, help="where finished cases are kept, to go on")
