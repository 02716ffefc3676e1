"""The measured axis EMPS beside the method of those who published it.

`python benchmarks/diagnosis_emps.py`: models identified on DATA_EMPS, simulated over the whole of
DATA_EMPS_PULSES. Free runs get the measured current and the first moments' state, nothing else.
A second table tells the replays of 0.3 s, and what limits them: the best function of position and
velocity that DATA_EMPS, or the pulses themselves, could teach.
Peers are identified as Janot, Gautier and Brunot (2019) do: the inverse dynamic model by least
squares, position filtered without lag, derivatives by central differences. The recordings are
looked for in $LEGLAB_DATA and ../shared/data.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import results
from scipy.signal import butter, decimate, filtfilt

from leglab.base.recording import Recording
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.improve import improved_model
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.verdict.verdict import diagnose
from leglab.diagnosis.verdict.whole import follow

sys.path.insert(0, str(Path(__file__).parents[1]))

from rigs.measured import EMPS_HELD_OUT, EMPS_MODEL, emps

HEAD = ("model", "what is fitted", "free run, RMS mm", "in closed loop, RMS mm")
WINDOW_HEAD = ("0.3 s of the pulses", "fitted on", "RMS mm at the end", "closed")
MASS, VISCOUS, COULOMB = 95.1089, 203.5034, 20.3935  # as published, kg, N s/m, N
_BAND, _DECIMATION = 20.0, 25  # Hz; samples: the band of 20 Hz at 40 Hz
_SMALL = 1e-4  # m/s over which dry friction changes its sign
_SUBSTEPS = 10
_POWERS = 6  # of position in the function that is fitted to what is left, by direction


def motion(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity, acceleration within the band, each (n,)."""
    period = float(np.median(np.diff(recording.time)))
    numerator, denominator = butter(4, 2.0 * _BAND * period)
    position = filtfilt(numerator, denominator, recording["slide_position"])
    velocity = np.gradient(position, period)
    return position, velocity, np.gradient(velocity, period)


def regressors(velocity: np.ndarray, acceleration: np.ndarray, form: str) -> list[np.ndarray]:
    sign = np.sign(velocity)
    if form == "friction by direction":
        ahead, back = (velocity > 0).astype(float), (velocity < 0).astype(float)
        return [acceleration, velocity * ahead, velocity * back, ahead, -back]
    columns = [acceleration, velocity, sign]
    return [*columns, np.ones_like(velocity)] if form == "with an offset" else columns


def identified(recording: Recording, form: str) -> np.ndarray:
    """Inverse dynamic identification by least squares."""
    _, velocity, acceleration = motion(recording)
    columns = [*regressors(velocity, acceleration, form), recording["drive_command"]]
    inner = slice(200, -200)  # the filter's ends
    rows = [decimate(column[inner], _DECIMATION, zero_phase=True) for column in columns]
    return np.linalg.lstsq(np.stack(rows[:-1], 1), rows[-1], rcond=None)[0]


def simulated(recording: Recording, values: np.ndarray, form: str) -> np.ndarray:
    """Free run of an identified model, (n,)."""
    position, velocity, _ = motion(recording)
    step = float(np.median(np.diff(recording.time))) / _SUBSTEPS
    mass = values[0]
    q, v = float(position[0]), float(velocity[0])
    out = np.empty(recording.time.size)
    for k, force in enumerate(recording["drive_command"].tolist()):
        out[k] = q
        for _ in range(_SUBSTEPS):
            if form == "friction by direction":
                viscous, dry = (values[1], values[3]) if v > 0 else (values[2], values[4])
            else:
                viscous, dry = values[1], values[2]
            offset = values[3] if form == "with an offset" else 0.0
            # Implicit in the friction, which is stiff about rest.
            slope = dry / np.hypot(v, _SMALL)
            v = (v + step * (force - offset) / mass) / (1.0 + step * (viscous + slope) / mass)
            q += step * v
    return out


def limits(problem: Problem, before: Hypothesis, after: Hypothesis) -> list[dict[str, Any]]:
    """Errors at the end of the pulses' windows, and what a function of the state could leave.

    The function is a polynomial of position and a viscous term, both by direction, fitted to the
    ends' errors under the diagnosis by least squares.
    """
    replay, names = problem.replay, [s.name for s in problem.series]
    pulses = replay.recording == names.index(EMPS_HELD_OUT)
    ends = [
        replay.error(problem.library.change(h, problem.machine)).values[:, 0, -1]
        for h in (before, after)
    ]
    change = problem.library.change(after, problem.machine)
    measured = [m for _, m, _ in replay._parts(change, None)]
    position, velocity = (
        replay.at_starts([getattr(m, name)["slide"] for m in measured])
        for name in ("position", "velocity")
    )
    columns = []
    for side in (velocity > 0, velocity <= 0):
        columns += [side * (position / np.ptp(position)) ** k for k in range(_POWERS)]
        columns.append(side * velocity)
    basis = np.stack(columns, 1)
    viscous = np.stack([np.sign(velocity), velocity], 1)

    def left(errors: np.ndarray, terms: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return errors - terms @ np.linalg.lstsq(terms[rows], errors[rows], rcond=None)[0]

    learned = left(ends[1], basis, ~pulses)
    found = [
        ("the model as it was", "", ends[0]),
        ("leglab diagnose", "DATA_EMPS", ends[1]),
        ("... and any function of position and velocity", "DATA_EMPS", learned),
        ("... and its friction anew", "the pulses", left(learned, viscous, pulses)),
        ("leglab diagnose and any such function", "the pulses", left(ends[1], basis, pulses)),
    ]
    return [
        {"model": model, "fitted": fitted, "end": float(np.sqrt(np.mean(errors[pulses] ** 2)))}
        for model, fitted, errors in found
    ]


def measure(options: argparse.Namespace) -> Any:
    recordings = emps()
    train = next(r for name, r in recordings.items() if name != EMPS_HELD_OUT)
    test = recordings[EMPS_HELD_OUT]
    rows: list[dict[str, Any]] = []

    def add(model: str, fitted: str, free: float, closed: float | None = None) -> None:
        rows.append({"model": model, "fitted": fitted, "free": free, "closed": closed})

    published = np.array([MASS, VISCOUS, COULOMB])
    for form, values in (
        ("as published", published),
        ("symmetric", identified(train, "symmetric")),
        ("with an offset", identified(train, "with an offset")),
        ("friction by direction", identified(train, "friction by direction")),
    ):
        error = simulated(test, values, form) - test["slide_position"]
        method = "parameters as published" if form == "as published" else "inverse dynamics"
        add(f"{method}: {form}" if values is not published else method,
            ", ".join(f"{v:.4g}" for v in values), float(np.sqrt(np.mean(error**2))))  # fmt: skip

    settings = DiagnosisSettings(threads=2)
    result, found = diagnose(EMPS_MODEL, recordings, held_out=(EMPS_HELD_OUT,), settings=settings)
    names = ", ".join(e.name for e in result.effects)
    with tempfile.TemporaryDirectory() as folder:
        path = improved_model(found).write(Path(folder))
        better = set_up(path, recordings, (EMPS_HELD_OUT,), settings)
        for name, problem, hypothesis in (
            ("leglab: the model as it was", found.problem, Hypothesis()),
            (f"leglab diagnose: {names}", found.problem, found.final),
            ("leglab diagnose: improved.xml", better, Hypothesis()),
        ):
            number = [s.name for s in problem.series].index(EMPS_HELD_OUT)
            errors = []
            for loop in (0.0, 1.0):
                followed = follow(problem, hypothesis, number, loop=loop)
                errors.append(followed.deviation("slide") if followed else float("nan"))
            add(name, "", *errors)
    replays = limits(found.problem, Hypothesis(), found.final)
    return {"whole": rows, "windows": replays}


def tables(kept: dict[str, Any]) -> str:
    """A row a model."""
    replays = kept["windows"]
    first = replays[0]["end"]
    windows = [
        (row["model"], row["fitted"], f"{1e3 * row['end']:.2f}",
         f"{100 * (1 - row['end'] / first):.0f} %" if i else "")
        for i, row in enumerate(replays)
    ]  # fmt: skip
    whole = results.table(
        HEAD,
        [
            (
                row["model"],
                row["fitted"],
                f"{1e3 * row['free']:.2f}",
                "" if row["closed"] is None else f"{1e3 * row['closed']:.2f}",
            )
            for row in kept["whole"]
        ],
    )
    return whole + "\n" + results.table(WINDOW_HEAD, windows)


def main() -> None:
    """Measures, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    results.main(parser, measure, tables)


if __name__ == "__main__":
    main()
