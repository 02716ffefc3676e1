"""Whole recordings simulated in one go, in closed loop.

Driven by the measured commands alone, a machine without a spring drifts away for whatever small
reason. So a position loop corrects each command; how far the simulation still strays, and how much
correction it needs, is what the model lacks.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.moments import STATE
from leglab.diagnosis.replay.replay import Course
from leglab.diagnosis.replay.residual import Problem
from leglab.machine.plugin import headless


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """A simulation of a whole recording; arrays over its samples, (samples,)."""

    time: np.ndarray  #: Of the recording [s]
    #: Positions by joint [rad or m], smoothed, as the hypothesis corrects them.
    measured: dict[str, np.ndarray]
    simulated: dict[str, np.ndarray]  #: NaN from where the simulation blew up
    correction: dict[str, np.ndarray]  #: What the loop added to the commands, by actuator

    def deviation(self, joint: str) -> float:
        """RMS of simulated less measured; infinite where the simulation blew up."""
        error = self.simulated[joint] - self.measured[joint]
        return float(rms(error)) if np.isfinite(error).all() else float("inf")


def follow(
    problem: Problem,
    hypothesis: Hypothesis,
    recording: int,
    *,
    loop: float = 1.0,
    after: float = -np.inf,
) -> Followed | None:
    """Simulates a recording, by its number, to its end or first gap; None without a first window.

    That is the first to start `after` a time [s]. The hypothesis holds throughout. `loop` is the
    share of an error that the loop takes off in the length of a window: all of it, in 0.3 s softer
    than the loops that legs and axes are run with; 0 for none.
    """
    change = problem.library.change(hypothesis, problem.machine)
    course = problem.replay.course(change, recording, after)
    if course is None:
        return None
    gains = _gains(problem, course, loop)
    machine, model = problem.machine, change.variant.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, course.state, STATE)
    places = [int(model.joint(joint).qposadr[0]) for joint in machine.joints]
    measured = np.stack([course.positions[joint] for joint in machine.joints], 1)
    count, width = measured.shape
    simulated = np.full((count, width), np.nan)
    correction = np.zeros((count, len(machine.actuators)))
    simulated[0] = data.qpos[places]
    error = measured[0] - simulated[0]
    steps = problem.replay.substeps
    with headless(model):
        for k in range(count - 1):
            last, error = error, measured[k] - simulated[k]
            correction[k] = gains[0] @ error + gains[1] @ ((error - last) / course.period)
            for control in course.controls[k * steps : (k + 1) * steps]:
                data.ctrl[:] = control + correction[k]
                mujoco.mj_step(model, data)
            simulated[k + 1] = data.qpos[places]
            if not np.isfinite(simulated[k + 1]).all():
                simulated[k + 1 :] = np.nan
                break
    correction[-1] = correction[-2]
    return Followed(
        time=course.time,
        measured=dict(zip(machine.joints, measured.T, strict=True)),
        simulated=dict(zip(machine.joints, simulated.T, strict=True)),
        correction=dict(zip(machine.actuators, correction.T, strict=True)),
    )


def _gains(problem: Problem, course: Course, loop: float) -> np.ndarray:
    """Command by error, and by its rate, of each actuator's own joint, (2, actuators, joints).

    With r the motion that a constant command adds within a window T, a loop of gain `loop`/r has
    the rate `loop`/T where commands set a speed, and moves go with the first power p of time.
    Where they set a force, p = 2, the square of the rate is 2 `loop`/T^2: a lead of 2 T (p - 1)
    damps it well.
    """
    machine = problem.machine
    gains = np.zeros((2, len(machine.actuators), len(machine.joints)))
    for i, actuator in enumerate(machine.actuators):
        for joint in machine.driven[actuator][:1]:
            j = machine.joints.index(joint)
            half, whole = course.moves[:, i, j].tolist()
            if loop > 0.0 and half * whole > 0.0:
                power = float(np.clip(np.log2(whole / half), 1.0, 2.0))
                lead = 2.0 * problem.replay.window * (power - 1.0)
                gains[:, i, j] = loop / whole * np.array([1.0, lead])
    return gains
