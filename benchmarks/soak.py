"""Days of walking with faults and repairs: `python -m benchmarks soak [--minutes 1440]`.

A specimen of the leg walks under `bsnn_arx_bank`. Every half minute something breaks, drawn with
its element and size from the bank's faults, or what is broken is repaired; nothing is kept of a run
but what stands in the table. The noise of sensors repeats after a minute. The command fails where
memory grows, a number is not finite, an error of the repaired machine leaves its band, or too few
faults get their name. A fault that raises no alarm, and with which the error stays as it was, has
nothing to be named by: it is listed and does not count.
"""

import argparse
import ctypes
import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.specimens import KINDS, drawn_size, specimen
from leglab.base.scenario import Scenario, get_scenario
from leglab.causes.fault_names import ALL
from leglab.machine.plugin import headless
from leglab.runs.loop import Loop

STATE, STRIDE = 30.0, 1.2  # how long the machine stays as it is, and a stride [s]
STRIDES = 4  # at the end of a state, over which its error is taken
# Of what must hold: growth of memory from the second minute on [MB], error after a repair over that
# before the first fault, share of faults whose name stands at the end of their state.
MOST_GROWTH, MOST_ERROR, LEAST_NAMED = 8.0, 2.0, 0.7
SEEN = 1.25  # error with a fault over that before the first one, from which on it counts


def memory() -> float:
    """Resident memory of this process [MB], without what it has freed and glibc keeps for it."""
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def fault_at(now: float, joints: tuple[str, ...], rng: np.random.Generator) -> tuple[Scenario, str]:
    """Draws a fault that begins now, and its element."""
    cause, side = KINDS[int(rng.integers(len(KINDS)))]
    share, alone, place = rng.random(3).tolist()
    size = drawn_size(cause, side, share)
    joint = joints[int(place * len(joints))] if alone < 0.5 and cause.per_joint else None
    whole = get_scenario(cause.name, duration=60.0, severity=size, element=joint)
    changes = tuple(replace(change, start=now) for change in whole.changes)
    # Of one joint that there is, a bank says "all".
    element = joint if joint and len(joints) > 1 else ALL
    return Scenario(name=cause.name, duration=now + STATE, changes=changes), element


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Walks, breaks and repairs; prints a line a minute. Ctrl-C ends it at the end of a state."""
    settings = specimen(
        options.seed,
        scenario="nominal",
        controller="bsnn_arx_bank",
        model=options.model,
        duration=60.0,
    )
    loop, rng = Loop(settings), np.random.default_rng([options.seed, 17])
    machine, simulation, period = loop.machine, loop.simulation, loop.period
    states: list[dict[str, Any]] = []
    late, first = 0.0, round((STATE - STRIDES * STRIDE) / period)
    squares, memories, skipped, heard = 0.0, [], 0, 0
    name, element = "", ""
    per_state, count = round(STATE / period), round(60.0 * options.minutes / period)
    stopped = []
    signal.signal(signal.SIGINT, lambda *_: stopped.append(True))
    with headless(simulation.model):
        for k in range(count):
            at = k % per_state
            if at == 0 and k:
                now = k * period
                events = loop.controller.events[heard:]
                told = [event.names[-1] for event in events if event.withdrawn is None]
                states.append(
                    {
                        "fault": name,
                        "element": element,
                        "rms_mrad": 1e3 * float(np.sqrt(squares / late)),
                        "named": any(
                            (t.fault, t.element, t.undoes) == (name, element, None) for t in told
                        ),
                        "noticed": bool(events),
                        "told": [f"{t.fault} of {t.element}" for t in told if t.undoes is None],
                        "undone": any(t.undoes is not None for t in told),
                    }
                )
                if stopped and len(memories) > 1:
                    break
                name, element = "", ""
                if (k // per_state) % 2:
                    try:
                        scenario, element = fault_at(now, simulation.joints, rng)
                        machine.schedule.follow(scenario, now)
                        name = scenario.name
                    except ValueError:  # a joint that has no such part
                        skipped += 1
                else:
                    machine.schedule.follow(
                        Scenario(name="nominal", duration=now + STATE, changes=()), now
                    )
            if at == 0:
                heard, squares, late = len(loop.controller.events), 0.0, 0.0
            wanted = loop.observe().reference.position
            if at >= first:
                squares += float(np.mean((simulation.position() - wanted) ** 2))
                late += 1
            loop.act()
            loop.advance()
            if k % round(1.0 / period) == 0:
                simulation.check()
            if k and k % round(60.0 / period) == 0:
                memories.append(memory())
                print(
                    f"{k * period / 60:.0f} min, {memories[-1]:.0f} MB, last state "
                    f"{states[-1]['rms_mrad']:.2f} mrad {states[-1]['fault'] or 'repaired'}",
                    file=sys.stderr,
                    flush=True,
                )
    loop.close()
    healthy = [s["rms_mrad"] for s in states if not s["fault"]]
    broken = [s for s in states if s["fault"]]
    quiet = [s for s in states[1:] if not s["fault"]]
    errors = [s["rms_mrad"] for s in broken]
    for state in broken:
        state["shown"] = state["noticed"] or state["rms_mrad"] > SEEN * healthy[0]
    return {
        "minutes": len(states) * STATE / 60.0,
        "model": options.model,
        "faults": sum(s["shown"] for s in broken),
        "named": sum(s["named"] for s in broken),
        "skipped": skipped,
        "missed": [
            f"{s['fault']} of {s['element']} ({', '.join(s['told']) or 'nothing'})"
            for s in broken
            if s["shown"] and not s["named"]
        ],
        "unseen": sorted(f"{s['fault']} of {s['element']}" for s in broken if not s["shown"]),
        "repairs_named": sum(any("unknown" not in t for t in s["told"]) for s in quiet),
        "repairs_told": sum(s["undone"] for s in quiet),
        "repairs": len(quiet),
        "first_mrad": healthy[0],
        "repaired_mrad": [float(np.median(healthy[1:])), max(healthy[1:])],
        "broken_mrad": [float(np.median(errors)), max(errors)],
        "memory_mb": [memories[1], memories[-1]],
    }


def wrong(found: dict[str, Any]) -> list[str]:
    """Requirements that do not hold."""
    first, last = found["memory_mb"]
    checks = {
        f"memory grew by {last - first:.1f} MB": last - first <= MOST_GROWTH,
        "the error after a repair left its band": found["repaired_mrad"][1]
        <= MOST_ERROR * found["first_mrad"],
        "too few faults were named": found["named"] >= LEAST_NAMED * found["faults"],
    }
    return [told for told, holds in checks.items() if not holds]


def tables(kept: dict[str, Any]) -> str:
    """A row a figure."""
    rows = [
        ("simulated", f"{kept['minutes']:g} min of `{kept['model']}`"),
        (
            "memory after two minutes, at the end",
            "{:.0f} and {:.0f} MB".format(*kept["memory_mb"]),
        ),
        ("faults with the right name at the end", f"{kept['named']} of {kept['faults']}"),
        ("without it (what was said)", ", ".join(kept["missed"]) or "none"),
        ("without an alarm or a larger error", ", ".join(kept["unseen"]) or "none"),
        ("repairs told as such", f"{kept['repairs_told']} of {kept['repairs']}"),
        ("repairs that were called a fault", f"{kept['repairs_named']} of {kept['repairs']}"),
        ("error before the first fault", f"{kept['first_mrad']:.2f} mrad"),
        (
            "after repairs: median, worst",
            "{:.2f} and {:.2f} mrad".format(*kept["repaired_mrad"]),
        ),
        ("with faults: median, worst", "{:.2f} and {:.2f} mrad".format(*kept["broken_mrad"])),
        ("does not hold", "; ".join(wrong(kept)) or "nothing"),
    ]
    return results.table(["", ""], rows)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=float, default=1440.0, help="simulated, 3 or more")
    parser.add_argument("--model", default="leg")
    parser.add_argument("--seed", type=int, default=0)
