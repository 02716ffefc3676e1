"""What stands before the onset of an effect."""

import numpy as np

from leglab.diagnosis.hypothesis import Hypothesis
from leglab.diagnosis.workflow import DiagnosisSettings, set_up
from tests.rigs import PENDULUM, Truth, record


def test_before_its_onset_an_effect_is_as_a_good_machine_has_it():
    """Friction of good machines scatters: before it changes it is not the model's."""
    key, offset = ("viscous_friction", "hinge"), ("force_offset", "hinge")
    logs = {k: record(PENDULUM, k, Truth(), seed=0, seconds=3.0) for k in ("multisine", "slow")}
    problem = set_up(PENDULUM.model, logs, (), DiagnosisSettings(threads=1))
    site = problem.library.sites[key]
    good = Hypothesis({key: 1.3 * site.nominal, offset: np.array([0.02])})
    onsets = np.array([1.5, np.inf])
    begun = good.changed(key, 3.0 * site.nominal, onsets)
    start, recording = problem.replay.start, problem.replay.recording
    before = start + problem.thresholds.window < onsets[recording]
    after = start >= onsets[recording]
    for hypothesis in (begun, begun.with_values(offset, good[offset])):
        found = problem.residual(hypothesis)
        throughout = good.with_values(key, 3.0 * site.nominal)
        np.testing.assert_array_equal(found[before], problem.residual(good)[before])
        np.testing.assert_array_equal(found[after], problem.residual(throughout)[after])
    # What was never there is absent before, and without an onset nothing is.
    absent = begun.without(key).changed(key, site.nominal, onsets).not_begun(key)
    assert key not in absent
    assert begun.with_onset(key, None).not_begun(key) == good.without(key)
    assert begun.not_begun(key)[key] == good[key]
