"""What was asked of adaptation and live names, beside what the kept results show.

`python benchmarks/adaptation_goals.py` prints the table; every figure is from a file of docs/data,
which the command in its row makes.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import live_names
import numpy as np
import pressures
import results
from adaptation_data import ADAPTIVE, mrad, read

BANK, WITHOUT = live_names.BANK, live_names.WITHOUT
HEAD = ("what", "asked", "reached", "on", "made by")


@dataclass(frozen=True, kw_only=True)
class Goal:
    """A line of the table.

    Attributes:
        what: Is measured.
        asked: Of it.
        reached: What the results show.
        on: How many runs.
    """

    what: str
    asked: str
    reached: str
    on: str


def _number(value: float) -> str:
    return results.number(float(value), 2) if np.isfinite(value) else "never"


def _percent(values: list[bool]) -> str:
    return f"{100 * np.mean(values):.0f} %"


def _clock(cases: list[dict[str, Any]], label: str) -> str:
    """Median and worst time to nine tenths, and how many never get there."""
    median, worst, never = live_names._t90(cases, label)
    return f"{median} / {worst} s, never in {never}"


def names(kept: dict[str, Any]) -> Iterator[Goal]:
    """Of `live_names.py`."""
    cases = kept["cases"]
    on = f"{len(cases)} faults"
    for (start, end), asked in live_names.ASKED.items():
        window = live_names.WINDOWS.index((start, end))
        ratio = np.median([case[BANK]["ratio"][window] for case in cases])
        what = f"error over that of `frozen`, {start:g} to {end:g} s after the change, median"
        yield Goal(what=what, asked=f"{asked:g}", reached=_number(ratio), on=on)
    median, worst = live_names.ASKED_T90
    yield Goal(
        what="90 % undone after, median / worst",
        asked=f"{median:g} / {worst:g} s",
        reached=_clock(cases, BANK),
        on=on,
    )
    ratios = [
        np.array([case[WITHOUT]["ratio"]]) / np.array([case[ADAPTIVE]["ratio"]]) for case in cases
    ]
    later = np.exp(np.log(np.concatenate(ratios)).mean(axis=0))[1:]
    yield Goal(
        what="the fault's kind left out of the bank: error over that of `bsnn_arx` from 0.3 s on, "
        "smallest and largest window, geometric mean",
        asked="1",
        reached=f"{_number(later.min())} to {_number(later.max())}",
        on=on,
    )
    over = np.array([case[WITHOUT]["worst"] for case in cases])
    yield Goal(
        what="the same: worst 2 s over `static_feedforward`, runs above 1.1",
        asked="0",
        reached=f"{int((over > 1.1).sum())} (largest {_number(over.max())})",
        on=on,
    )
    for limit, kind, place in ((0.5, 88, 95), (2.0, 95, 99)):
        told = [case[BANK][f"{limit:g}"] for case in cases]
        said = [t for t in told if t["said"]]
        hurt = [
            c[BANK][f"{limit:g}"]["fault"]
            for c in cases
            if c["frozen_mrad"][3] > 2 * c["before_mrad"]
        ]
        yield Goal(
            what=f"named within {limit:g} s: kind, of all (of those that double the error); "
            "cylinder, of the named",
            asked=f"{kind} %; {place} %",
            reached=f"{_percent([t['fault'] for t in told])} ({_percent(hurt)}); "
            f"{_percent([t['element'] for t in said])}",
            on=on,
        )
    sure = [
        t["fault"] and t["element"]
        for case in cases
        for t in [case[BANK]["2"]]
        if t["said"] and t["confidence"] >= 0.9
    ]
    yield Goal(
        what="claims at 0.9 that are right",
        asked="87 to 97 %",
        reached=_percent(sure),
        on=f"{len(sure)} claims",
    )
    minutes = {label: duration / 60 for label, (_, duration) in live_names.PEACE.items()}
    alarms = sum(len(said) for _, _, said in kept["peace"])
    yield Goal(
        what="false alarms while nothing breaks: walking, random strides, cold start",
        asked="0",
        reached=str(alarms),
        on=f"{sum(minutes[label] for label, _, _ in kept['peace']):.0f} min",
    )


def payload(kept: dict[str, Any]) -> Iterator[Goal]:
    """Of `live_names.py --elsewhere`."""
    own = [case for case in kept["back"] if case["fault"] == "payload"]
    yield Goal(
        what="a payload that is picked up and put down: named, its end told",
        asked="all",
        reached=", ".join(
            str(sum(case[when] is not None for case in own)) for when in ("comes", "goes")
        ),
        on=f"{len(own)} runs",
    )


def with_pressures(cases: list[dict[str, Any]]) -> Iterator[Goal]:
    """Of `pressures.py`."""
    on = f"{len(cases)} faults"
    median, worst = pressures.ASKED_T90
    for name in (pressures.OWN, BANK):
        yield Goal(
            what=f"pressures measured, `{name}`: 90 % undone after, median / worst",
            asked=f"{median:g} / {worst:g} s",
            reached=_clock(cases, name),
            on=on,
        )
    for name in (pressures.OWN, BANK):
        peer = pressures._of(cases, name, pressures.PEER)
        lower = sum(value < 1 for value in peer.values())
        yield Goal(
            what=f"end error of `{name}` below that of `adaptive_backstepping`; largest ratio",
            asked="19 of 22; 1.3",
            reached=f"{lower} of {len(peer)}; {_number(max(peer.values()))}",
            on=on,
        )
    travel = [
        case[name]["travel"] / case["pd"]["travel"]
        for case in cases
        for name in (pressures.OWN, BANK)
    ]
    yield Goal(
        what="valve travel over that of `pd`, largest",
        asked="1.5",
        reached=_number(max(travel)),
        on=on,
    )


def against_oracle() -> Iterator[Goal]:
    """Of `adaptation_claims.py`."""
    _, rigs = read()
    cells = rigs["leg, walking"]
    ratios = {}
    for (name, severity, controller), runs in cells.items():
        oracle = cells.get((name, severity, "oracle"), [])
        if controller == ADAPTIVE and oracle and name != "nominal":
            ratios[name, severity] = np.mean(mrad(runs, "end")) / np.mean(mrad(oracle, "end"))
    values = np.array(list(ratios.values()))
    yield Goal(
        what="end error of `bsnn_arx` over the aligned oracle's: faults above 1.25, largest",
        asked="0",
        reached=f"{int((values > 1.25).sum())} of {len(values)}, {_number(values.max())}",
        on="10 specimens",
    )


def speed(kept: dict[str, Any]) -> Iterator[Goal]:
    """Of `leg_speed.py`."""
    yield Goal(
        what="speed of the closed loop with bank and monitor over that of `pd`",
        asked="0.6",
        reached=_number(kept["loop"][BANK]["of_pd"]),
        on="20 s",
    )


def main() -> None:
    """Prints the table."""
    parts: tuple[tuple[str, Callable[..., Iterator[Goal]]], ...] = (
        ("live_names", names),
        ("live_names_elsewhere", payload),
        ("pressures", with_pressures),
        ("adaptation_results", lambda _: against_oracle()),
        ("leg_speed", speed),
    )
    rows = []
    for stem, goals in parts:
        record = json.loads((results.DATA / f"{stem}.json").read_text())
        for goal in goals(record["results"]):
            script = record["command"].split()[1].removeprefix("benchmarks/")
            rows.append([goal.what, goal.asked, goal.reached, goal.on, f"`{script}`"])
    print(results.table(list(HEAD), rows).rstrip())


if __name__ == "__main__":
    main()
