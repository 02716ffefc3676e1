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
from dataclasses import dataclass, field, replace
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
    """A figure of leglab over one of a peer, or over what is asked."""

    name: str  #: For files
    title: str  #: What over what
    part: str  #: Script that measures it
    value: Callable[[Any], float]  #: Of the script's results
    better: Literal["low", "high"]  #: Whether it is better low or high
    asked: float | None = None  #: What it must reach
    #: Whether it depends on the machine, and is compared on the same one only.
    absolute: bool = False

    def met(self, value: float) -> bool | None:
        """Whether a value reaches what is asked; None where nothing is."""
        if self.asked is None:
            return None
        return value <= self.asked if self.better == "low" else value >= self.asked


def _row(rows: Mapping[str, Any], beginning: str) -> Any:
    """The row of a peer, whose name ends with its version."""
    return next(row for name, row in rows.items() if name.startswith(beginning))


def _of_bare(beginning: str) -> Callable[[Any], float]:
    return lambda found: _row(found["all_cores"], beginning)["of_bare"]


def _batch_over(peer: str) -> Callable[[Any], float]:
    return lambda found: (
        _of_bare("`make_batch(64)`, residual on `st")(found) / _of_bare(peer)(found)
    )


def _peer(ours: str, peer: str, figure: str) -> Callable[[Any], float]:
    def value(found: Any) -> float:
        rows = _row(found, "plant of Eq. 23")
        return _row(rows, peer)[figure] / rows[ours][figure]

    return value


def _solver(found: Any, name: str, **wanted: float) -> Any:
    rows = found["air and LuGre friction"]
    return next(
        r for r in rows if r["solver"] == name and all(r.get(k) == v for k, v in wanted.items())
    )


def _naive_error(found: Any) -> float:
    ours = _solver(found, "leglab", h_ms=0.25)
    return _solver(found, "naive explicit", h_ms=0.01)["x_rms_mm"] / ours["x_rms_mm"]


def _stiff_time(found: Any) -> float:
    ours = _solver(found, "leglab", h_ms=1.0, substeps=2)
    return _solver(found, "LSODA 1e-10")["us_a_ms"] / ours["us_a_ms"]


def _replays(found: Any) -> float:
    ours, sysid = (
        found["replays"][name]["best_per_s"]
        for name in ("leglab diagnose", "mujoco.sysid, windows in one call")
    )
    return ours / sysid


def _ways(found: Any) -> list[Any]:
    return [case["ways"] for name, case in found.items() if name != "books"]


def _efficiency(case: int, over: str = "") -> Callable[[Any], float]:
    def value(found: Any) -> float:
        ways = _ways(found)[case]
        return ways[_TWO]["efficiency"] / (ways[over]["efficiency"] if over else 1.0)

    return value


def _thousand(found: Any) -> float:
    short = next(case for name, case in found.items() if name != "books")
    return 1000 * short["ways"][_TWO]["wall"] / short["runs"]


_PAPER, _DEPLOYED = "leglab, paper's BSNN-ARX, single calls", "leglab, deployed, single calls"
_TWO, _DASK = "two processes", "Dask, two workers"
_STEP, _LOOP = (
    "time of a step of the leg over that with MuJoCo's motors",
    "speed of the closed loop",
)
_BATCH = "steps of the batched environment over"
_SHORT, _LONG = "1 s of the knee bench", "40 s of the leg"
_SAMPLE, _FREE = "time of a sample", "free-run error on the paper's plant"
# By benchmark: name, title, value, better, asked; "absolute" where it depends on the machine.
_TABLE: dict[str, tuple[tuple[Any, ...], ...]] = {
    "speed": (
        ("cylinder_over_bare_loop",
         "time of a cylinder's update over a straight-line C++ loop of its arithmetic",
         lambda found: found["cylinder_ns"] / found["straight_line_ns"], "low", None),
    ),
    "leg_speed": (
        *((f"leg_over_motors_{label.replace(' ', '_').replace(',', '')}", f"{_STEP}, {label}",
           lambda found, label=label: found["step_us"][label]["ratio"], "low", 2.0)
          for label in ("as shipped", "without shapes", "as shipped, at rest")),
        *((f"real_time_{name}", f"closed loop of the leg over real time, {name}",
           lambda found, name=name: found["loop"][name]["best"], "high", asked, "absolute")
          for name, asked in (("pd", 50.0), ("bsnn_arx", 30.0))),
        ("loop_bsnn_arx_over_pd", f"{_LOOP}, six adaptive joints over pd",
         lambda found: found["loop"]["bsnn_arx"]["of_pd"], "high", None),
        ("loop_bank_over_pd", f"{_LOOP}, six adaptive joints with bank and monitor over pd",
         lambda found: found["loop"]["bsnn_arx_bank"]["of_pd"], "high", 0.6),
    ),
    "environment_speed": (
        ("batch_of_bare_valve", f"{_BATCH} bare stepping on all cores, valves",
         _of_bare("`make_batch(64)`, valve"), "high", 0.6),
        ("batch_of_bare_residual",
         f"{_BATCH} bare stepping on all cores, residual on static_feedforward",
         _of_bare("`make_batch(64)`, residual on `st"), "high", 0.6),
        ("batch_of_bare_bsnn_arx", f"{_BATCH} bare stepping on all cores, residual on bsnn_arx",
         _of_bare("`make_batch(64)`, residual on `bs"), "high", None),
        ("batch_over_gymnasium", f"{_BATCH} those of Gymnasium's AsyncVectorEnv",
         _batch_over("Gymnasium's"), "high", None),
        ("batch_over_dm_control", f"{_BATCH} those of dm_control in processes",
         _batch_over("dm_control"), "high", None),
    ),
    "identification_peers": (
        ("padasip_rls_time_over_ours",
         f"{_SAMPLE}, padasip's RLS over leglab's paper's model by single calls",
         _peer(_PAPER, "padasip", "nanoseconds"), "high", 5.0),
        *((f"{name}_time_over_ours",
           f"{_SAMPLE}, {what} over leglab's deployed model by single calls",
           _peer(_DEPLOYED, peer, "nanoseconds"), "high", None)
          for name, what, peer in (
              ("numpy_rls", "RLS in NumPy", "NumPy"),
              ("river", "river's linear regression", "river"),
              ("sysidentpy", "SysIdentPy's FROLS", "SysIdentPy"))),
        *((f"{name}_error_over_ours", f"{_FREE}, {what} over leglab's deployed model",
           _peer(_DEPLOYED, peer, "free_run"), "high", None)
          for name, what, peer in (
              ("padasip_rls", "padasip's RLS", "padasip"),
              ("scipy", "SciPy's least squares", "SciPy"),
              ("river", "river's linear regression", "river"),
              ("sysidentpy", "SysIdentPy's FROLS", "SysIdentPy"))),
    ),
    "bsnn_arx_speed": (
        ("identifier_over_bare_loop",
         f"{_SAMPLE} of the identifier over a bare C++ loop of its arithmetic",
         lambda found: found["core_double"] / found["bare"], "low", None),
        ("six_joints_over_one", "time of an update of six joints over that of one",
         lambda found: found["update of six joints"] / found["update"], "low", None),
        ("power_splines", f"power with which the {_SAMPLE} grows with splines, local rule",
         lambda found: found["power"]["splines"], "low", 1.0),
        ("power_rls", f"power with which the {_SAMPLE} grows with linear parameters, RLS",
         lambda found: found["power"]["rls"], "low", 2.0),
    ),
    "integration_accuracy": (
        ("lsoda_time_over_ours",
         "time of a millisecond, SciPy's LSODA over leglab's scheme at 1 ms",
         _stiff_time, "high", None),
        ("naive_error_over_ours",
         "error of position, explicit Euler at 0.01 ms over leglab's scheme at 0.25 ms",
         _naive_error, "high", None),
    ),
    "diagnosis_rollouts": (
        ("replays_over_sysid",
         "replays a second of the diagnosis over mujoco.sysid's, windows in one call",
         _replays, "high", None),
    ),
    "sweeps": (
        *((f"sweep_efficiency_{name}",
           f"CPU time inside runs over all of a sweep by two processes, {what}",
           _efficiency(i), "high", 0.9)
          for i, (name, what) in enumerate((("short", _SHORT), ("long", _LONG)))),
        *((f"dask_over_processes_{name}", f"CPU time of a sweep by Dask over processes, {what}",
           _efficiency(i, _DASK), "low", 1.05)
          for i, (name, what) in enumerate((("short", _SHORT), ("long", _LONG)))),
        ("thousand_runs_s", "wall time of a thousand one-second runs by two processes, s",
         _thousand, "low", 90.0, "absolute"),
    ),
}  # fmt: skip
RATIOS = tuple(
    Ratio(
        name=name, title=title, part=part, value=value, better=better, asked=asked,
        absolute=bool(more),
    )
    for part, rows in _TABLE.items()
    for name, title, value, better, asked, *more in rows
)  # fmt: skip


def machine() -> dict[str, Any]:
    """Machine that the benchmark runs on, as JSON can hold it."""
    names = [
        line.partition(":")[2].strip()
        for line in _text(Path("/proc/cpuinfo")).splitlines()
        if line.startswith("model name")
    ]
    installed = (p for p in PACKAGES if importlib.util.find_spec(p.replace("-", "_")))
    known = {package: metadata.version(package) for package in installed}
    return {
        "processor": names[0] if names else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "versions": known,
    }


def _text(path: Path) -> str:
    return path.read_text() if path.is_file() else ""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Result of one call of a part."""

    part: str  #: Its name
    #: As `benchmarks/results.py` keeps it; empty where it failed.
    record: dict[str, Any] = field(default_factory=dict)
    tables: str = ""  #: What it printed, Markdown
    problem: str = ""  #: Why it failed, one line


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
        return Measured(part=part.name, problem=problem)
    file.with_suffix(".md").write_text(done.stdout)
    found = _kept(part.name, file)
    if found is None:
        return Measured(part=part.name, problem="it wrote no results")
    return found


def stored(parts: Sequence[Benchmark]) -> list[Measured]:
    """Results of the parts in docs/data, with their tables."""
    tables, found = kept_tables(), []
    for part in parts:
        kept = _kept(part.name, part.file) if part.file.is_file() else None
        if kept is None:
            problem = "docs/data keeps no results of it"
            found.append(Measured(part=part.name, problem=problem))
        else:
            found.append(replace(kept, tables=tables.get(part.name, "")))
    return found


def kept_tables() -> dict[str, str]:
    """Tables that pages show of docs/data, by benchmark; Markdown."""
    return {name: "\n".join(pages.values()) for name, pages in shown().items()}


@dataclass(frozen=True, kw_only=True)
class Value:
    """A ratio as it was measured."""

    ratio: Ratio  #: Which one
    values: tuple[float, ...]  #: Of each call

    @property
    def median(self) -> float:
        """The middle one."""
        return statistics.median(self.values)


def values(found: Sequence[Measured]) -> list[Value]:
    """All ratios that can be drawn from results of parts; those of old scripts may lack some."""
    known = []
    for ratio in RATIOS:
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
