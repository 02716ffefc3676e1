"""The ratios that are drawn from benchmarks which measure leglab and its peers in one process.

They run one after the other, each in a process of its own.
"""

import importlib.util
import json
import os
import platform
import shlex
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from benchmarks import results
from benchmarks.registry import BENCHMARKS, ROOT, Benchmark, shown
from leglab.base.errors import LeglabError, SettingsError
from leglab.base.input import read_json
from leglab.jobs.engine import Progress

PACKAGES = (
    "leglab", "mujoco", "numpy", "scipy", "padasip", "river", "sysidentpy", "dm-control",
    "gymnasium", "distributed",
)  # fmt: skip
_RECORD = (*results.RECORD, "results")


# What the suite runs: all that measures leglab beside peers in one process, in turns.
PARTS = tuple(one for one in BENCHMARKS.values() if one.quick is not None)


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """A figure of leglab over one of a peer, or over what is asked.

    Attributes:
        name: For files.
        title: What over what.
        part: Script that measures it.
        value: Of the script's results.
        better: Whether it is better low or high.
        asked: What it must reach.
        absolute: Whether it depends on the machine, and is compared on the same one only.
    """

    name: str
    title: str
    part: str
    value: Callable[[Any], float]
    better: Literal["low", "high"]
    asked: float | None = None
    absolute: bool = False

    def met(self, value: float) -> bool | None:
        """Whether a value reaches what is asked; None where nothing is."""
        if self.asked is None:
            return None
        return value <= self.asked if self.better == "low" else value >= self.asked


def _row(rows: Mapping[str, Any], beginning: str) -> Any:
    """The row of a peer, whose name ends with its version."""
    return next(row for name, row in rows.items() if name.startswith(beginning))


def _loop(over: str) -> Callable[[Any], float]:
    return lambda found: found["loop"][over]["of_pd"]


def _of_bare(beginning: str) -> Callable[[Any], float]:
    return lambda found: _row(found["all_cores"], beginning)["of_bare"]


def _plant(found: Any) -> Any:
    return _row(found, "plant of Eq. 23")


def _peer(ours: str, peer: str, figure: str) -> Callable[[Any], float]:
    def value(found: Any) -> float:
        rows = _plant(found)
        return _row(rows, peer)[figure] / rows[ours][figure]

    return value


def _solver(found: Any, name: str, **wanted: float) -> Any:
    rows = found["air and LuGre friction"]
    return next(
        r for r in rows if r["solver"] == name and all(r.get(k) == v for k, v in wanted.items())
    )


def _ways(found: Any) -> list[Any]:
    return [case["ways"] for name, case in found.items() if name != "books"]


def _step(label: str, found: Any) -> float:
    return found["step_us"][label]["ratio"]


def _real_time(name: str, found: Any) -> float:
    return found["loop"][name]["best"]


def _batch_over(peer: str, found: Any) -> float:
    return _of_bare("`make_batch(64)`, residual on `st")(found) / _of_bare(peer)(found)


def _power(name: str, found: Any) -> float:
    return found["power"][name]


def _efficiency(case: int, found: Any) -> float:
    return _ways(found)[case][_TWO]["efficiency"]


def _dask_over_processes(case: int, found: Any) -> float:
    ways = _ways(found)[case]
    return ways[_TWO]["efficiency"] / ways[_DASK]["efficiency"]


_PAPER, _DEPLOYED = "leglab, paper's BSNN-ARX, single calls", "leglab, deployed, single calls"
_TWO, _DASK = "two processes", "Dask, two workers"
# A million runs times this many seconds: a thousand short ones.
_THOUSAND = 1000

RATIOS = (
    Ratio(
        name="cylinder_over_bare_loop",
        title="time of a cylinder's update over a straight-line C++ loop of its arithmetic",
        part="speed",
        value=lambda found: found["cylinder_ns"] / found["straight_line_ns"],
        better="low",
    ),
    *(
        Ratio(
            name=f"leg_over_motors_{label.replace(' ', '_').replace(',', '')}",
            title=f"time of a step of the leg over that with MuJoCo's motors, {label}",
            part="leg_speed",
            value=partial(_step, label),
            better="low",
            asked=2.0,
        )
        for label in ("as shipped", "without shapes", "as shipped, at rest")
    ),
    *(
        Ratio(
            name=f"real_time_{name}",
            title=f"closed loop of the leg over real time, {name}",
            part="leg_speed",
            value=partial(_real_time, name),
            better="high",
            asked=asked,
            absolute=True,
        )
        for name, asked in (("pd", 50.0), ("bsnn_arx", 30.0))
    ),
    Ratio(
        name="loop_bsnn_arx_over_pd",
        title="speed of the closed loop, six adaptive joints over pd",
        part="leg_speed",
        value=_loop("bsnn_arx"),
        better="high",
    ),
    Ratio(
        name="loop_bank_over_pd",
        title="speed of the closed loop, six adaptive joints with bank and monitor over pd",
        part="leg_speed",
        value=_loop("bsnn_arx_bank"),
        better="high",
        asked=0.6,
    ),
    *(
        Ratio(
            name=f"batch_of_bare_{name}",
            title=f"steps of the batched environment over bare stepping on all cores, {what}",
            part="environment_speed",
            value=_of_bare(beginning),
            better="high",
            asked=asked,
        )
        for name, what, beginning, asked in (
            ("valve", "valves", "`make_batch(64)`, valve", 0.6),
            (
                "residual",
                "residual on static_feedforward",
                "`make_batch(64)`, residual on `st",
                0.6,
            ),
            ("bsnn_arx", "residual on bsnn_arx", "`make_batch(64)`, residual on `bs", None),
        )
    ),
    *(
        Ratio(
            name=f"batch_over_{name}",
            title=f"steps of the batched environment over those of {what}",
            part="environment_speed",
            value=partial(_batch_over, peer),
            better="high",
        )
        for name, what, peer in (
            ("gymnasium", "Gymnasium's AsyncVectorEnv", "Gymnasium's"),
            ("dm_control", "dm_control in processes", "dm_control"),
        )
    ),
    *(
        Ratio(
            name=f"{name}_time_over_ours",
            title=f"time of a sample, {what} over leglab's {whose} by single calls",
            part="identification_peers",
            value=_peer(ours, peer, "nanoseconds"),
            better="high",
            asked=asked,
        )
        for name, what, peer, whose, ours, asked in (
            ("padasip_rls", "padasip's RLS", "padasip", "paper's model", _PAPER, 5.0),
            ("numpy_rls", "RLS in NumPy", "NumPy", "deployed model", _DEPLOYED, None),
            ("river", "river's linear regression", "river", "deployed model", _DEPLOYED, None),
            ("sysidentpy", "SysIdentPy's FROLS", "SysIdentPy", "deployed model", _DEPLOYED, None),
        )
    ),
    *(
        Ratio(
            name=f"{name}_error_over_ours",
            title=f"free-run error on the paper's plant, {what} over leglab's deployed model",
            part="identification_peers",
            value=_peer(_DEPLOYED, peer, "free_run"),
            better="high",
        )
        for name, what, peer in (
            ("padasip_rls", "padasip's RLS", "padasip"),
            ("scipy", "SciPy's least squares", "SciPy"),
            ("river", "river's linear regression", "river"),
            ("sysidentpy", "SysIdentPy's FROLS", "SysIdentPy"),
        )
    ),
    Ratio(
        name="identifier_over_bare_loop",
        title="time of a sample of the identifier over a bare C++ loop of its arithmetic",
        part="bsnn_arx_speed",
        value=lambda found: found["core_double"] / found["bare"],
        better="low",
    ),
    Ratio(
        name="six_joints_over_one",
        title="time of an update of six joints over that of one",
        part="bsnn_arx_speed",
        value=lambda found: found["update of six joints"] / found["update"],
        better="low",
    ),
    *(
        Ratio(
            name=f"power_{name}",
            title=f"power with which the time of a sample grows with {what}",
            part="bsnn_arx_speed",
            value=partial(_power, name),
            better="low",
            asked=asked,
        )
        for name, what, asked in (
            ("splines", "splines, local rule", 1.0),
            ("rls", "linear parameters, RLS", 2.0),
        )
    ),
    Ratio(
        name="lsoda_time_over_ours",
        title="time of a millisecond, SciPy's LSODA over leglab's scheme at 1 ms",
        part="integration_accuracy",
        value=lambda found: (
            _solver(found, "LSODA 1e-10")["us_a_ms"]
            / _solver(found, "leglab", h_ms=1.0, substeps=2)["us_a_ms"]
        ),
        better="high",
    ),
    Ratio(
        name="naive_error_over_ours",
        title="error of position, explicit Euler at 0.01 ms over leglab's scheme at 0.25 ms",
        part="integration_accuracy",
        value=lambda found: (
            _solver(found, "naive explicit", h_ms=0.01)["x_rms_mm"]
            / _solver(found, "leglab", h_ms=0.25)["x_rms_mm"]
        ),
        better="high",
    ),
    Ratio(
        name="replays_over_sysid",
        title="replays a second of the diagnosis over mujoco.sysid's, windows in one call",
        part="diagnosis_rollouts",
        value=lambda found: (
            found["replays"]["leglab diagnose"]["best_per_s"]
            / found["replays"]["mujoco.sysid, windows in one call"]["best_per_s"]
        ),
        better="high",
    ),
    *(
        Ratio(
            name=f"sweep_efficiency_{name}",
            title=f"CPU time inside runs over all of a sweep by two processes, {what}",
            part="sweeps",
            value=partial(_efficiency, i),
            better="high",
            asked=0.9,
        )
        for i, (name, what) in enumerate(
            (("short", "1 s of the knee bench"), ("long", "40 s of the leg"))
        )
    ),
    *(
        Ratio(
            name=f"dask_over_processes_{name}",
            title=f"CPU time of a sweep by Dask over processes, {what}",
            part="sweeps",
            value=partial(_dask_over_processes, i),
            better="low",
            asked=1.05,
        )
        for i, (name, what) in enumerate(
            (("short", "1 s of the knee bench"), ("long", "40 s of the leg"))
        )
    ),
    Ratio(
        name="thousand_runs_s",
        title="wall time of a thousand one-second runs by two processes, s",
        part="sweeps",
        value=lambda found: (
            _THOUSAND
            * _ways(found)[0][_TWO]["wall"]
            / next(case["runs"] for name, case in found.items() if name != "books")
        ),
        better="low",
        asked=90.0,
        absolute=True,
    ),
)


def machine() -> dict[str, Any]:
    """What the benchmark runs on; JSON can hold it."""
    names = [
        line.partition(":")[2].strip()
        for line in _text(Path("/proc/cpuinfo")).splitlines()
        if line.startswith("model name")
    ]
    known = {p: metadata.version(p) for p in PACKAGES if importlib.util.find_spec(_module(p))}
    return {
        "processor": names[0] if names else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "versions": known,
    }


def _module(package: str) -> str:
    return package.replace("-", "_")


def _text(path: Path) -> str:
    return path.read_text() if path.is_file() else ""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What one call of a part gave.

    Attributes:
        part: Its name.
        record: As `benchmarks/results.py` keeps it; empty where it failed.
        tables: What it printed, Markdown.
        problem: Why it failed, one line.
    """

    part: str
    record: dict[str, Any]
    tables: str
    problem: str = ""


def chosen_parts(names: Sequence[str] | None) -> list[Benchmark]:
    """Parts by name; None for all.

    Raises:
        LeglabError: There is no such part.
    """
    known = {part.name: part for part in PARTS}
    for name in names or ():
        if name not in known:
            raise SettingsError.unknown("part of the benchmark", name, known)
    return [part for part in PARTS if not names or part.name in names]


def measure(
    parts: Sequence[Benchmark],
    folder: Path,
    *,
    repeat: int,
    quick: bool,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[Measured]:
    """Runs the parts so many times each, in turns, unless the folder holds their results.

    Results of another commit or with other options are made anew. A part that fails stops nothing.

    Args:
        parts: What to run.
        folder: Where results are kept, a file each call; it is there.
        repeat: How many times.
        quick: Whether with few samples: for a look, not for figures to be kept.
        overwrite: Whether to repeat what is there.
        progress: Called with calls that are done, of all, and the part.

    Raises:
        KeyboardInterrupt: The user interrupts; finished calls are kept.
    """
    found, commit = [], results.commit()
    calls = [(part, number) for number in range(repeat) for part in parts]
    for done, (part, number) in enumerate(calls):
        if progress:
            progress(done, len(calls), part.name)
        file = folder / f"{part.name}-{'quick-' if quick else ''}{number}.json"
        kept = None if overwrite else _kept(part.name, file)
        if kept is None or kept.record["commit"] != commit or "+" in commit:
            kept = _call(part, shlex.split(part.quick or "") if quick else [], file)
        found.append(kept)
    if progress:
        progress(len(calls), len(calls), "")
    return found


def _kept(part: str, file: Path) -> Measured | None:
    try:
        record = read_json(file)
    except LeglabError:
        return None
    if not isinstance(record, dict) or any(name not in record for name in _RECORD):
        return None
    return Measured(part=part, record=record, tables=_text(file.with_suffix(".md")))


def _call(part: Benchmark, options: Sequence[str], file: Path) -> Measured:
    """Runs a benchmark once."""
    command = [sys.executable, *part.command.split()[1:], *options, "--write", str(file.resolve())]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        problem = lines[-1].strip() if lines else f"it ended with status {done.returncode}"
        return Measured(part=part.name, record={}, tables="", problem=problem)
    file.with_suffix(".md").write_text(done.stdout)
    found = _kept(part.name, file)
    if found is None:
        return Measured(part=part.name, record={}, tables="", problem="it wrote no results")
    return found


def stored(parts: Sequence[Benchmark]) -> list[Measured]:
    """What docs/data keeps of the parts, with their tables."""
    tables, found = kept_tables(), []
    for part in parts:
        kept = _kept(part.name, part.file) if part.file.is_file() else None
        if kept is None:
            problem = "docs/data keeps no results of it"
            found.append(Measured(part=part.name, record={}, tables="", problem=problem))
        else:
            found.append(replace(kept, tables=tables.get(part.name, "")))
    return found


def kept_tables() -> dict[str, str]:
    """Tables that pages show of docs/data, by benchmark; Markdown."""
    return {name: "\n".join(pages.values()) for name, pages in shown().items()}


@dataclass(frozen=True, kw_only=True)
class Value:
    """A ratio as it was measured.

    Attributes:
        ratio: Which one.
        values: Of each call.
    """

    ratio: Ratio
    values: tuple[float, ...]

    @property
    def median(self) -> float:
        """The middle one."""
        return statistics.median(self.values)


def values(found: Sequence[Measured], ratios: Sequence[Ratio] = RATIOS) -> list[Value]:
    """All ratios that can be drawn from results; those of old scripts may lack some.

    Args:
        found: Results of parts.
        ratios: Which ones.
    """
    known = []
    for ratio in ratios:
        each = []
        for one in found:
            if one.part == ratio.part and one.record:
                try:
                    each.append(float(ratio.value(one.record["results"])))
                except (LookupError, StopIteration, TypeError, ZeroDivisionError):
                    continue
        if each:
            known.append(Value(ratio=ratio, values=tuple(each)))
    return known


def as_json(measured: Sequence[Measured], found: Sequence[Value]) -> dict[str, Any]:
    """Content of bench.json."""
    return {
        "machine": machine(),
        "ratios": {
            v.ratio.name: {
                "title": v.ratio.title,
                "part": v.ratio.part,
                "median": v.median,
                "range": [min(v.values), max(v.values)],
                "values": list(v.values),
                "better": v.ratio.better,
                "asked": v.ratio.asked,
                "met": v.ratio.met(v.median),
            }
            for v in found
        },
        "parts": [
            {"part": m.part, "problem": m.problem} | json.loads(json.dumps(m.record))
            for m in measured
        ],
    }
