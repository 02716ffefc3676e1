"""Closed-loop simulation of whole recordings.

Under the measured commands alone, small errors add up, so that a machine without a spring drifts
away. Therefore a position controller corrects each command. The remaining position error and the
corrections together show how wrong the model is.
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

    time: np.ndarray  #: Times of the samples [s]
    #: Smoothed positions by joint [rad or m], with the hypothesis's sensor corrections.
    measured: dict[str, np.ndarray]
    simulated: dict[str, np.ndarray]  #: Positions by joint; NaN after the simulation blew up
    correction: dict[str, np.ndarray]  #: Corrections of the commands by the controller, by actuator

    def deviation(self, joint: str) -> float:
        """Computes the RMS position error of a joint; infinite if the simulation blew up."""
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
    """Simulates the recording with this index from its first window to its end or next data gap.

    Only windows that start at `after` [s] or later count; returns None if none does. Effects act
    from the start, without onsets. `loop` is the share of a position error that the controller
    removes within a window: 1 is softer than usual controllers of legs and axes, 0 is open loop.
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
    """Computes the gains on position error and its rate, (2, actuators, joints).

    Within a window of length T, a unit command moves its joint by r, in proportion to time^p. If
    the command sets a speed (p = 1), the gain `loop`/r removes errors at the rate `loop`/T. If it
    sets a force (p = 2), the same gain yields the natural frequency sqrt(2 `loop`)/T, and a rate
    gain of 2 T (p - 1) times the gain damps the loop well.
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
