"""Settings that make no sense and calls that do not fit: one clear line, nothing changed."""

from dataclasses import replace

import numpy as np
import pytest

from leglab.base.errors import LeglabError
from leglab.identification import (
    Basis,
    Bsnn,
    BsnnArx,
    BsnnArxSettings,
    ChangeDetection,
    Guard,
    Hammerstein,
    Lags,
    Rls,
    Signal,
    SplineNarxSettings,
)

PAPER = BsnnArxSettings.paper_mode()
TWO = (Signal(name="u"), Signal(name="y"))

BAD_SETTINGS = [
    (lambda: Basis(knots=(0.0, 1.0, 1.0)), "above 1"),
    (lambda: Basis(knots=(0.0, np.nan, 1.0)), "finite"),
    (lambda: Basis(knots=(0.0, 1.0), kind="paper"), "at least 6"),
    (lambda: Basis(knots=(0.0, 1.0, 3.0), middle_piece="printed"), "equidistant"),
    (lambda: Basis.uniform(1.0, 0.0, 8), "above 1"),
    (lambda: Basis.uniform(0.0, 1.0, 2), "at least 3|\\[3"),
    (lambda: Basis.uniform(0.0, 1.0, 8, outside="linaer"), "did you mean 'linear'"),
    (lambda: Rls(initial_gain=-1.0), "initial_gain is -1"),
    (lambda: Rls(forgetting="fortescue"), "choose one of"),
    (lambda: Rls(forgetting_factor=1.1), r"\[0.5, 1\]"),
    (lambda: Rls(gain_bound=1.0), "gain_bound"),
    (lambda: ChangeDetection(ratio=0.5), "ratio"),
    (lambda: ChangeDetection(slow_window=10), "slow_window"),
    (lambda: Guard(stuck_samples=-1), "stuck_samples"),
    (lambda: replace(PAPER, na=-1), "na is -1"),
    (lambda: replace(PAPER, nb=0), "nb is 0"),
    (lambda: replace(PAPER, nk=1.5), "nk is 1.5"),
    (lambda: replace(PAPER, scalar="float16"), "float16"),
    (lambda: replace(PAPER, guard=Guard(input_limits=((-1, 1), (0, 1)))), "2 inputs"),
    (lambda: replace(PAPER.network, learning_constant=(0.1, 0.2)), "2 learning constants"),
    (lambda: Bsnn(basis=()), "inputs is 0"),
    (lambda: Signal(name="u", lower=1.0, upper=1.0), "'u' upper"),
    (lambda: SplineNarxSettings(features=()), "empty"),
    (lambda: SplineNarxSettings(features=(Lags(signal="v"),)), "unknown signal 'v'"),
    (lambda: SplineNarxSettings(features=(Lags(signal="y", first=0),)), "lag 0"),
    (lambda: SplineNarxSettings(inputs=TWO, features=(Lags(signal="u"),)), "must differ"),
    (lambda: Hammerstein(signal="u", basis=PAPER.network.basis[0], learning_constant=3), "2"),
    (lambda: BsnnArx(PAPER, joints=0), "joints is 0"),
]


@pytest.mark.parametrize(("make", "message"), BAD_SETTINGS)
def test_senseless_settings_are_refused(make, message):
    with pytest.raises(LeglabError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


GOOD = np.linspace(0, 0.5, 20)
BAD_CALLS = [
    (lambda m: m.run(GOOD, GOOD[:-1]), "u has 20 samples and y 19"),
    (lambda m: m.run(GOOD[:, None], GOOD), r"u has shape \(20, 1\): must be \(N\)"),
    (lambda m: m.run(GOOD, np.where(GOOD > 0.3, np.nan, GOOD)), "y is nan at index 12"),
    (lambda m: m.run(np.where(GOOD > 0.4, np.inf, GOOD), GOOD), "u is inf at index"),
    (lambda m: m.run("no numbers", GOOD), "u is not an array"),
    (lambda m: m.run(GOOD, GOOD, missing="drop"), "missing is 'drop'"),
    (lambda m: m.update("a", 1.0), "u is not an array of numbers"),
    (lambda m: m.update([0.1, 0.2], 1.0), r"u has shape \(2,\): must be \(\)"),
    (lambda m: m.update(0.1, "b"), "y is not an array of numbers"),
    (lambda m: m.predict(np.nan), "u is nan"),
    (lambda m: m.free_run(GOOD, [0.1]), "y_initial has 1 samples"),
    (lambda m: m.free_run([np.nan]), "u is nan"),
    (lambda m: setattr(m, "parameters", np.zeros(3)), "parameters has shape"),
    (lambda m: setattr(m, "parameters", np.full(15, np.nan)), "parameters is nan"),
    (lambda m: m.project_poles(-1.0), "radius"),
]


@pytest.mark.parametrize(("call", "message"), BAD_CALLS)
def test_bad_calls_leave_the_identifier_untouched(call, message):
    m = BsnnArx(PAPER)
    m.run(*np.random.default_rng(0).uniform(0, 0.8, (2, 300)))
    state = m._bank.state()
    with pytest.raises(LeglabError, match=message):
        call(m)
    assert m._bank.state() == state
