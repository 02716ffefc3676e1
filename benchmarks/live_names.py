"""Gain of naming a fault before learning it.

Walking leg, specimens of tolerance 0.1, one fault each, of all cylinders or of one; its size is
drawn up to beyond the bank's largest, its time within a stride, the machine, the phase of the
motion and the noise by the seed. `bsnn_arx_bank` stands beside `bsnn_arx`, and beside itself with
the fault's kind left out of its bank. `frozen`, which learns nothing from the change on, is
what errors are measured against. The seeds are of no run that a setting was chosen by.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.specimens import KINDS, changed_at, drawn_size, specimen, window_rms
from leglab import RunSettings
from leglab.base.errors import LeglabError
from leglab.causes.fault_names import ALL, UNKNOWN, FaultEvent
from leglab.causes.table import CAUSES, kind_of
from leglab.runs.clock import adaptation
from leglab.runs.loop import Loop
from leglab.runs.metrics import sliding_rms
from leglab.runs.preparation import Preparation

FIRST_SEED = 30_000
DURATION, CHANGE, STRIDE = 18.0, 10.0, 1.2  # s
WINDOWS = ((0.0, 0.3), (0.3, 0.6), (0.6, 1.2), (1.2, 2.4), (2.4, 4.8), (4.8, 6.6))  # after, s
TOLD = (0.5, 2.0)  # s after the change
BESIDES = 1.0  # s after the change, from which on an onset is of nothing that happened

STATIC, FROZEN = "static_feedforward", "frozen"
BEFORE, BANK, WITHOUT = "bsnn_arx", "bsnn_arx_bank", "kind left out"
# Asked of the medians, by window; and of t90, median and worst [s].
ASKED = {(0.3, 0.6): 0.25, (1.2, 2.4): 0.14}
ASKED_T90 = (0.45, 2.5)
# What comes and goes: from and to [s]. Both are changes that are to be named.
COMES, GOES = 12.0, 20.0
# Machines of a user, by their differences from the knee bench.
_BORE = {"bore": 0.032, "rod": 0.02, "dead_volume_a": 11.6e-6, "dead_volume_b": 6.7e-6}
MACHINES: dict[str, dict[str, Any]] = {
    "knee bench at 210 bar and 55 °C": {"supply_pressure": 210e5, "oil_temperature": 55.0},
    "knee bench with a valve of 90 Hz": {"bandwidth_hz": 90.0},
    "knee bench with twice the bore": {**_BORE, "rated_flow": 5e-4},
}
# Under other conditions, and on machines of a user: label to settings of a run.
ELSEWHERE: dict[str, dict[str, Any]] = {
    "12-bit encoders with 15 times the noise": {
        "sensors": {"encoder_counts": 4096, "position_noise": 3e-4}
    },
    "squat": {"reference": "squat"},
    "squat on the ground": {"model": "leg_rail", "reference": "squat"},
    "another fault 5 s before": {},
    **{label: {"model": "knee_bench", "parameters": own} for label, own in MACHINES.items()},
}
# Where nothing breaks: scenario, settings, duration [s].
PEACE: dict[str, tuple[dict[str, Any], float]] = {
    "nominal walking": ({}, 90.0),
    "random strides": ({"reference": "random_stride"}, 30.0),
    "cold start": ({"scenario": "cold_start"}, 30.0),
    **{label: (ELSEWHERE[label], 10.0) for label in MACHINES},
}
# Faults and sizes that are tried there, of all cylinders; the other fault, of the knee alone.
TRIED = (("seal_wear", 6.0), ("friction_rise", 2.5), ("valve_null_shift", 0.035))
TRIED += (("supply_drop", 115.0), ("spring_fatigue", 0.4))
CARRIED = (("payload", 6.0), *TRIED)  # come and go
OTHER = ("valve_null_shift", "knee", 0.03, 5.0)


def cases(seeds: range) -> Iterator[tuple[int, str, str, float, float]]:
    """Seed, fault, element, size and time of the change [s] of every case."""
    joints = Preparation(RunSettings(scenario="nominal")).nominal.joints
    for seed in seeds:
        for number, (cause, side) in enumerate(KINDS):
            rng = np.random.default_rng([seed, number])
            for alone in (False, True):
                share, time, place = rng.random(3).tolist()
                if alone and not cause.per_joint:
                    continue
                size = drawn_size(cause, side, share)
                element = joints[int(place * len(joints))] if alone else ALL
                yield seed, cause.name, element, size, round(CHANGE + STRIDE * time, 3)


def judged(case: tuple[int, str, str, float, float]) -> dict[str, Any] | None:
    """Figures of one case by controller; None where the joint has no part that could break."""
    seed, fault, element, size, change = case
    found: dict[str, Any] = dict(zip(("seed", "fault", "element", "size"), case, strict=False))
    plans = {
        STATIC: (STATIC, {}),
        FROZEN: (FROZEN, {"stop_time": change}),
        BEFORE: (BEFORE, {}),
        BANK: (BANK, {}),
        WITHOUT: (BANK, {"left_out": list(kind_of(fault))}),
    }
    base = calibrated = twin = None
    for label, (controller, config) in plans.items():
        settings = specimen(
            seed, scenario="nominal", controller=controller, controller_config=config
        )
        preparation = Preparation(settings)
        joint = None if element == ALL else element
        scenario = changed_at(change, fault, DURATION, severity=size, element=joint)
        try:
            loop = Loop(settings, preparation=preparation, scenario=scenario)
        except LeglabError:
            return None
        history = loop.run()
        assert not history.failure, (case, history.failure)
        after = history.time - change
        error = [window_rms(history.error, after, *window) for window in WINDOWS]
        sliding = sliding_rms(history.time, history.error, 2.0)[after >= 0.0]
        if label == STATIC:
            calibrated = sliding
            continue
        if label == FROZEN:
            base, twin = np.array(error), history.error
            found["before_mrad"] = 1e3 * window_rms(history.error, after, -2.4, 0.0)
            found["frozen_mrad"] = [1e3 * value for value in error]
            continue
        clock = adaptation(
            scenario, STRIDE, history.time, history.error, loop.simulation.joints, twin=twin
        )
        row: dict[str, Any] = {
            "ratio": (np.array(error) / base).tolist(),
            "t90": clock.t90_s,
            "clocked": clock.level_rad is not None,
            "worst": float((sliding / calibrated).max()),
        }
        if controller == BANK:
            row |= _told(loop.controller.events, fault, element, change)  # type: ignore[union-attr]
        found[label] = row
    return found


def _told(
    events: list[FaultEvent], fault: str, element: str, change: float, pace: float = 1.0
) -> dict[str, Any]:
    """Names by time: confidence, and whether fault and element were right."""
    names = [name for event in events for name in event.names if name.time >= change]
    told: dict[str, Any] = {
        "early": sum(e.names[0].time < change for e in events),
        "late": [e.names[-1].fault for e in events if e.names[-1].onset > change + pace * BESIDES],
    }
    for limit in TOLD:
        said = [name for name in names if name.time <= change + pace * limit]
        last = said[-1] if said else None
        known = last is not None and last.fault != UNKNOWN
        told[f"{limit:g}"] = {
            "said": known,
            "unknown": last is not None and not known,
            "fault": bool(known and last and last.fault == fault),
            "among": bool(last and fault in (last.fault, *(r.fault for r in last.rivals))),
            "element": bool(known and last and last.element == element),
            "confidence": last.confidence if known and last else None,
        }
    right = names and names[-1].fault == fault and names[-1].size is not None
    told["size"] = [names[-1].size, names[-1].low, names[-1].high] if right else None
    return told


def peace(task: tuple[str, int]) -> tuple[str, int, list[str]]:
    """Names that are said while nothing breaks."""
    label, seed = task
    settings, duration = PEACE[label]
    run = {"scenario": "nominal", "reference": "walking_stride", **settings}
    loop = Loop(specimen(seed, controller=BANK, duration=duration, **run))
    history = loop.run()
    assert not history.failure, history.failure
    events = loop.controller.events  # type: ignore[union-attr]
    return label, seed, [f"{e.names[-1].fault} {e.names[-1].element}" for e in events]


def back_again(task: tuple[str, float, float, int]) -> dict[str, Any]:
    """Names of a fault that comes and is repaired, as of a payload up and down."""
    fault, size, healthy, seed = task
    duration = GOES + 8.0
    comes = changed_at(COMES, fault, duration, severity=size)
    whole = changed_at(GOES, fault, duration, severity=healthy)
    goes = [
        sound if broken.kind == "set" else replace(broken, start=GOES, value=1.0 / broken.value)
        for broken, sound in zip(comes.changes, whole.changes, strict=True)
    ]
    run = specimen(seed, scenario="nominal", controller=BANK)
    loop = Loop(run, scenario=replace(comes, changes=(*comes.changes, *goes)))
    history = loop.run()
    assert not history.failure, history.failure
    found: dict[str, Any] = {"fault": fault, "seed": seed}
    found |= {"comes": None, "goes": None, "besides": []}
    for event in loop.controller.events:  # type: ignore[union-attr]
        name = event.names[-1]
        later = name.onset > 0.5 * (COMES + GOES)
        right = name.fault == fault if not later else name.undoes is not None
        if event.withdrawn is None and right and name.onset > COMES - 0.5:
            when, start = ("goes", GOES) if later else ("comes", COMES)
            found[when] = [name.time - start, name.size]
        else:
            found["besides"].append(f"{name.fault} {name.element}")
    return found


def elsewhere(task: tuple[str, str, float, int]) -> dict[str, Any]:
    """Errors and names under another condition."""
    label, fault, size, seed = task
    rng = np.random.default_rng([seed, list(ELSEWHERE).index(label)])
    # All times are those of walking, at the pace of the motion.
    run = {"scenario": "nominal", "reference": "walking_stride", **ELSEWHERE[label]}
    pace = Loop(specimen(seed, **run)).reference.period / STRIDE
    change, duration = round(pace * (CHANGE + STRIDE * rng.random()), 3), pace * DURATION
    scenario = changed_at(change, fault, duration, severity=size)
    if label == "another fault 5 s before":
        name, element, other, earlier = OTHER
        first = changed_at(change, name, duration, severity=other, element=element)
        change += earlier
        scenario = changed_at(change, fault, duration, severity=size)
        scenario = replace(scenario, changes=first.changes + scenario.changes)
    found: dict[str, Any] = {"label": label, "fault": fault, "seed": seed}
    base = None
    for controller in (FROZEN, BEFORE, BANK):
        config = {"stop_time": change} if controller == FROZEN else {}
        settings = specimen(seed, **run, controller=controller, controller_config=config)
        told = replace(scenario, reference=settings.reference or scenario.reference)
        loop = Loop(settings, scenario=told)
        history = loop.run()
        assert not history.failure, (task, history.failure)
        after = (history.time - change) / pace
        windows = [w for w in WINDOWS if change + pace * w[1] <= duration]
        error = np.array([window_rms(history.error, after, *window) for window in windows])
        if controller == FROZEN:
            base = error
            found["frozen_mrad"] = (1e3 * error).tolist()
            continue
        found[controller] = {"ratio": (error / base).tolist()}
        if controller == BANK:
            events = loop.controller.events  # type: ignore[union-attr]
            found[BANK] |= _told(events, fault, ALL, change, pace)
    return found


def measure_elsewhere(options: argparse.Namespace) -> dict[str, Any]:
    """Measures faults that come and go, and the conditions that are asked for."""
    seeds = range(FIRST_SEED, FIRST_SEED + options.specimens)
    tasks = [(label, *fault, seed) for label in ELSEWHERE for fault in TRIED for seed in seeds]
    Loop(RunSettings(scenario="nominal", controller=BANK))
    keep = {"folder": options.keep, "jobs": options.jobs}
    healthy = {fault: CAUSES[fault].healthy_magnitude() for fault, _ in CARRIED}
    back = [(*fault, healthy[fault[0]], seed) for fault in CARRIED for seed in seeds]
    return {
        "back": results.resumed(back_again, back, **keep),
        "elsewhere": results.resumed(elsewhere, tasks, **keep),
    }


def tables_elsewhere(kept: dict[str, Any]) -> str:
    """Names of faults that come and go; then errors and names under other conditions."""
    parts = []
    for fault, size in CARRIED:
        own = [x for x in kept["back"] if x["fault"] == fault]
        row = [f"{fault} {size:g}", str(len(own))]
        for when in ("comes", "goes"):
            told = [x[when] for x in own if x[when]]
            row += [
                str(len(told)),
                ", ".join(f"{x[0]:.2f}" for x in told),
                ", ".join("" if x[1] is None else results.number(x[1], 2) for x in told),
            ]
        row.append(", ".join(sorted({w for x in own for w in x["besides"]})) or "none")
        parts.append(row)
    head = ["comes and goes", "cases", "named", "after, s", "size", "its end told", "after, s"]
    text = results.table([*head, "size then", "other things said"], parts)
    head = ["condition", "fault", "cases", "frozen, mrad", "`bsnn_arx` .3-.6", "1.2-2.4"]
    head += [
        "`bsnn_arx_bank` .3-.6",
        "1.2-2.4",
        "fault right by 0.5 s",
        "by 2 s",
        "among those told",
        "not among them",
    ]
    rows = []
    for label in ELSEWHERE:
        for fault, _ in TRIED:
            own = [x for x in kept["elsewhere"] if x["label"] == label and x["fault"] == fault]
            if not own:
                continue
            row = [label, fault, str(len(own))]
            row += [results.number(float(np.median([x["frozen_mrad"][1] for x in own])), 2)]
            for name in (BEFORE, BANK):
                for window in (1, 3):  # a run that ends earlier has not all windows
                    ratios = [x[name]["ratio"][window:][:1] for x in own]
                    there = [ratio[0] for ratio in ratios if ratio]
                    row += [results.number(float(np.median(there)), 2) if there else ""]
            for limit in TOLD:
                row += [str(sum(x[BANK][f"{limit:g}"]["fault"] for x in own))]
            last = [x[BANK][f"{TOLD[-1]:g}"] for x in own]
            row += [str(sum(x["among"] for x in last))]
            row += [str(sum(x["said"] and not x["among"] for x in last))]
            rows.append(row)
    return text + "\n" + results.table(head, rows)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All cases, and the runs in which nothing breaks."""
    if options.elsewhere:
        return measure_elsewhere(options)
    seeds = range(FIRST_SEED, FIRST_SEED + options.specimens)
    # The bank is made here once; the other processes read it.
    Loop(RunSettings(scenario="nominal", controller=BANK))
    Loop(RunSettings(scenario="nominal", controller=BANK, reference="random_stride"))
    made = results.resumed(judged, list(cases(seeds)), folder=options.keep, jobs=options.jobs)
    found = [case for case in made if case is not None]
    found.sort(key=lambda x: (x["seed"], x["fault"], x["element"], x["size"]))
    quiet = [(label, seed) for label in PEACE for seed in seeds]
    said = sorted(results.resumed(peace, quiet, folder=options.keep, jobs=options.jobs))
    return {"cases": found, "peace": [list(x) for x in said]}


def tables(kept: dict[str, Any]) -> str:
    """Errors, t90, names and false alarms."""
    if "back" in kept:
        return tables_elsewhere(kept)
    found = kept["cases"]
    parts = [
        _errors(found),
        _clocks(found),
        _by_fault(found),
        _names(found),
        _peace(kept["peace"], found),
    ]
    return "\n".join(parts)


def _errors(found: list[dict[str, Any]]) -> str:
    head = ["error over that of `frozen`, s after the change"]
    head += [f"{a:g}-{b:g}" for a, b in WINDOWS]
    rows = []
    for label in (BEFORE, BANK, WITHOUT):
        ratio = np.array([case[label]["ratio"] for case in found])
        rows.append([f"`{label}`, median", *(results.number(x, 2) for x in np.median(ratio, 0))])
        worst = np.percentile(ratio, 95, axis=0)
        rows.append([f"`{label}`, 95 %", *(results.number(x, 2) for x in worst)])
    floor = np.array([np.array(x["before_mrad"]) / np.array(x["frozen_mrad"]) for x in found])
    rows.append(["before the change, median", *(results.number(x, 2) for x in np.median(floor, 0))])
    asked = [f"{ASKED[w]:g}" if w in ASKED else "" for w in WINDOWS]
    rows.append(["asked of the median", *asked])
    return results.table(head, rows)


def _clocks(found: list[dict[str, Any]]) -> str:
    """Time until nine tenths are undone; the worst two seconds after the change over static's."""
    head = ["controller", "t90 median, s", "worst", "never", "worst 2 s over static, median"]
    rows = []
    for label in (BEFORE, BANK, WITHOUT):
        worst = np.array([case[label]["worst"] for case in found])
        marks = (np.median(worst), np.percentile(worst, 95), worst.max())
        shown = [results.number(float(x), 2) for x in marks]
        rows.append([f"`{label}`", *t90_cells(found, label), *shown, str(int((worst > 1.1).sum()))])
    rows.append(["asked", *map(str, ASKED_T90), "0", "", "", "1.1", "0"])
    return results.table([*head, "95 %", "largest", "runs above 1.1"], rows)


def t90_cells(found: list[dict[str, Any]], label: str) -> list[str]:
    """Median and worst t90, and how many were never undone, of those that a clock can tell."""
    clocked = [case[label]["t90"] for case in found if case[label]["clocked"]]
    times = np.array([np.inf if t is None else t for t in clocked])
    if not len(times):
        return ["", "", "0"]
    done = times[np.isfinite(times)]
    middle = float(np.median(times))
    return [
        results.number(middle, 2) if np.isfinite(middle) else "never",
        results.number(float(done.max()), 2) if len(done) else "",
        f"{len(times) - len(done)} of {len(times)}",
    ]


def _groups(found: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    return {
        "all cylinders": [c for c in found if c["element"] == ALL],
        "one cylinder": [c for c in found if c["element"] != ALL],
        "damage x2 and more": [c for c in found if c["frozen_mrad"][3] > 2 * c["before_mrad"]],
        "together": found,
    }


def _by_fault(found: list[dict[str, Any]]) -> str:
    head = ["fault", "cases", "frozen, mrad"]
    for label in (BEFORE, BANK):
        head += [f"`{label}` .3-.6", "1.2-2.4", "t90 median", "worst", "never"]
    kinds = dict.fromkeys(case["fault"] for case in found)
    groups = {kind: [c for c in found if c["fault"] == kind] for kind in kinds}
    rows = []
    for name, group in {**groups, **_groups(found)}.items():
        frozen = np.median([case["frozen_mrad"][3] for case in group])
        row = [name, str(len(group)), results.number(float(frozen), 2)]
        for label in (BEFORE, BANK):
            ratio = np.median([case[label]["ratio"] for case in group], axis=0)
            row += [
                results.number(ratio[1], 2),
                results.number(ratio[3], 2),
                *t90_cells(group, label),
            ]
        rows.append(row)
    asked = [f"{share:g}" for share in ASKED.values()]
    rows.append(["asked", "", "", *[""] * 5, *asked, *map(str, ASKED_T90), "0"])
    return results.table(head, rows)


def _names(found: list[dict[str, Any]]) -> str:
    head = ["named", "of", "by, s", "said", "fault right, % of all", "element right", "of said"]
    head += ["among those told", "both of said", "claims of 0.9 right"]
    rows = []
    for name, group in _groups(found).items():
        for limit in TOLD:
            told = [case[BANK][f"{limit:g}"] for case in group]
            said = [t for t in told if t["said"]]
            sure = [t for t in said if t["confidence"] >= 0.9]
            row = [_percent([t[key] for t in told]) for key in ("said", "fault", "element")]
            row += [_percent([t[key] for t in said]) for key in ("fault", "among")]
            row += [_percent([t["fault"] and t["element"] for t in own]) for own in (said, sure)]
            rows.append([name, str(len(told)), f"{limit:g}", *row])
    return results.table(head, rows)


def _percent(values: list[bool]) -> str:
    return f"{100 * np.mean(values):.0f}" if values else ""


def _peace(said: list[list[Any]], found: list[dict[str, Any]]) -> str:
    rows = []
    for label, (_, duration) in PEACE.items():
        own = [names for name, _, names in said if name == label]
        alarms = [name for names in own for name in names]
        minutes = len(own) * duration / 60
        shown = ", ".join(sorted(set(alarms))) or "none"
        rows.append([label, f"{minutes:g}", str(len(alarms)), shown])
    late = [name for case in found for name in case[BANK].get("late", [])]
    minutes = len(found) * (DURATION - CHANGE - 0.5 * STRIDE - BESIDES) / 60
    shown = ", ".join(sorted(set(late))) or "none"
    rows.append(["after the one fault of a run above", f"{minutes:.0f}", str(len(late)), shown])
    return results.table(["where nothing breaks", "minutes", "false alarms", "said"], rows)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--specimens", type=int, default=20, help="how many")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    parser.add_argument("--keep", type=Path, help="where finished cases are kept, to go on")
    parser.add_argument(
        "--elsewhere",
        action="store_true",
        help="faults that come and go, and other conditions and machines instead",
    )
