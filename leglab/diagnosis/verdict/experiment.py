"""Next experiment: the excitation that best discriminates two rivals."""

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.result import Proposal


def excitations(samples: int, period: float) -> dict[str, np.ndarray]:
    """Returns excitations of unit amplitude by name, each (samples,)."""
    time, tones = period * np.arange(samples), (0.7, 1.9, 4.3, 8.9)
    multisine = sum(np.sin(2.0 * np.pi * f * time + i) for i, f in enumerate(tones))
    return {
        "slow sine, 1 Hz": np.sin(2.0 * np.pi * time),
        "fast sine, 8 Hz": np.sin(2.0 * np.pi * 8.0 * time),
        "multisine, 0.7 to 9 Hz": np.asarray(multisine) / len(tones),
        "steps every 0.2 s": np.where(np.floor(time / 0.2).astype(int) % 2 == 0, 1.0, -1.0),
        "ramps through zero": 2.0 * np.abs(2.0 * ((time / 0.5) % 1.0) - 1.0) - 1.0,
    }


def propose(problem: Problem, rivals: dict[str, Hypothesis]) -> Proposal | None:
    """Chooses the T-optimal excitation (Atkinson and Fedorov 1975) between two rivals.

    Both rivals are simulated with their fitted parameters under every excitation, from a calm
    moment of the recordings. The excitation is proposed under which their predictions differ most,
    in noise levels; None if no excitation separates the rivals.
    """
    (one, first), (other, second) = rivals.items()
    replay, period = problem.replay, problem.series[0].period
    names = [f"{actuator}_command" for actuator in problem.machine.actuators]
    rows = [np.stack([s.columns[name] for name in names], axis=1) for s in problem.series]
    commands = np.concatenate(rows)
    middle = np.median(commands, axis=0)
    reach = np.ptp(np.quantile(commands, [0.02, 0.98], axis=0), axis=0) / 2.0
    # Each excitation lasts 1 s and is tried at 30 % and at 100 % of the recorded command range.
    waves = excitations(round(1.0 / period), period)
    tried = [(name, amplitude) for name in waves for amplitude in (0.3, 1.0)]
    series = [middle + amplitude * reach * waves[name][:, None] for name, amplitude in tried]
    speeds = replay.measured()[:, 0, :10]
    calm = int(np.argmin(np.abs(speeds[:, -1] - speeds[:, 0])))
    noise = np.median(problem.sensor_noise, axis=0)[:, None]
    changes = [problem.library.change(h, problem.machine) for h in (first, second)]
    answers = [replay.respond(change, calm, np.stack(series)) for change in changes]
    distance = np.nan_to_num((answers[0] - answers[1]) / noise, nan=0.0)
    separation = (np.clip(distance, -1e3, 1e3) ** 2).sum(axis=(1, 2))
    best = int(np.argmax(separation))
    if separation[best] <= 0.0:
        return None
    now = (problem.residual(first) - problem.residual(second)) ** 2
    name, amplitude = tried[best]
    return Proposal(
        name=name,
        description=f"command {name} with {amplitude:.0%} of the present range about its middle",
        rivals=(one, other),
        separation=float(separation[best]),
        separation_now=float(now.sum()),
    )
