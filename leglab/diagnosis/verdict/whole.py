"""Whole recording for the page of a diagnosis: measured, and simulated by both models."""

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.replay.following import follow
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.result import WholeRecording


def whole_recording(problem: Problem, final: Hypothesis) -> WholeRecording | None:
    """Simulates the judged recording with the largest errors by both models, see `follow`.

    The joint is shown whose deviation is largest in noise levels of its sensor. Returns None if no
    window begins after the onsets of the final effects, or if no joint is driven.
    """
    owner, levels = problem.replay.recording, problem.noise_levels(Hypothesis())
    judged = np.unique(owner[problem.judged]).tolist()
    recording = max(judged, key=lambda i: float(levels[owner == i].mean()))
    onset = max((float(times[recording]) for times in final.onsets.values()), default=-np.inf)
    before, after = (follow(problem, h, recording, after=onset) for h in (Hypothesis(), final))
    machine = problem.machine
    driven = [(joints[0], actuator) for actuator, joints in machine.driven.items() if joints]
    if before is None or after is None or not driven:
        return None
    sigma = problem.sensor_noise[recording].tolist()
    noise = {c.joint: s for c, s in zip(problem.channels, sigma, strict=True) if not c.chamber}
    joint, actuator = max(driven, key=lambda pair: before.deviation(pair[0]) / noise[pair[0]])
    spread = float(np.std(problem.series[recording].columns[f"{actuator}_command"])) or 1.0
    measured = before.measured[joint]
    return WholeRecording(
        recording=problem.series[recording].name,
        joint=joint,
        unit=machine.unit(joint),
        actuator=actuator,
        time=before.time,
        measured=measured,
        before=before.simulated[joint],
        # `after.measured` is corrected for a faulty sensor, `measured` is as recorded.
        after=measured + after.simulated[joint] - after.measured[joint],
        correction_before=before.correction[actuator] / spread,
        correction_after=after.correction[actuator] / spread,
    )
