"""Patched models against the fits that they were written from."""

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.model import Machine


def reloaded_error(problem, hypothesis, path):
    """Largest difference of replays by the patched file and by the fit, in noise levels.

    The patched file speaks for itself: nothing of the fit is added to it.
    """
    machine = Machine(path, timestep=problem.machine.timestep)
    own = problem.library.change(hypothesis, problem.machine)
    bare = problem.library.change(Hypothesis(), machine)
    noise = problem.sensor_noise.min(axis=0)[:, None]
    patched = problem.replay.on(machine).error(bare).values
    return float((np.abs(patched - problem.replay.error(own).values) / noise).max())
