"""The C++ monitor against plain NumPy; in pieces as at once."""

from itertools import pairwise

import numpy as np
import pytest

from leglab._native.monitor import Bank, Moments, Monitor, chances
from leglab.causes.fault_names import ALL
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from tests.reference import monitor_oracle as oracle

JOINTS = 3
NAMES = ("information", "correlation", "power", "count")
SETTINGS = {
    "sample_period": 0.004,
    "error_ratio": 4.0,
    "alarm": 4.0,
    "correlation": 20.0,
    "slow_window": 100,
    "passing": 0.06,
    "blocks": 25,
    "most_samples": 10,
}


def samples_of(rng, parameters, count, lost=0.2):
    """Samples of a map; some joints learn nothing from some of them, and splines rest."""
    regressor = rng.standard_normal((count, *parameters.shape))
    regressor[..., 1:2] *= rng.random() < 0.5
    output = np.einsum("njp,jp->nj", regressor, parameters)
    output += 1e-3 * rng.standard_normal(output.shape)
    rest = np.stack([output, 0.0 * output, np.ones(output.shape)], axis=-1)
    samples = np.concatenate([regressor, rest], axis=-1)
    samples[rng.random(output.shape) < lost] = 0.0
    return samples


def bank_of(rng, parameters, nodes=(2, 3, 4, 5, 6, 9, 3)):
    """Curves of these numbers of sizes; the second concerns one joint, the third's sizes fall."""
    curves = []
    for i, count in enumerate(nodes):
        shifts = 0.1 * rng.standard_normal((count, JOINTS, parameters)).cumsum(axis=0)
        shifts -= shifts[0]
        if i == 1:
            shifts[:, 1:] = 0.0
        sizes = np.cumsum(rng.uniform(0.5, 2.0, count))
        sizes = -sizes if i == 2 else sizes
        # The last is the other side of the first fault.
        name = "fault_0" if i == len(nodes) - 1 else f"fault_{i}"
        curves.append(FaultCurve(fault=name, element=ALL, meaning="", sizes=sizes, shifts=shifts))
    return FaultBank(curves=tuple(curves))


def sums_of(samples):
    sums = Moments(JOINTS, samples.shape[2] - 3)
    sums.add(samples)
    return sums


@pytest.mark.parametrize("parameters", [1, 6, 7])
def test_sums_are_those_of_numpy_and_the_same_bits_however_divided(parameters):
    rng = np.random.default_rng(1)
    base = rng.standard_normal((JOINTS, parameters))
    samples = samples_of(rng, rng.standard_normal(base.shape), 23)
    samples[..., 0] = samples[..., -1]  # a constant, as some maps have
    right, whole = oracle.Moments(samples), sums_of(samples)
    for cuts in ((0, 23), (0, 1, 2, 7, 23), (0, 4, 11, 20, 23)):
        parts = Moments(JOINTS, parameters)
        for start, end in pairwise(cuts):
            parts.add(samples[start:end])
        for name in NAMES:
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
            np.testing.assert_allclose(
                getattr(parts, name), getattr(right, name), rtol=1e-12, atol=1e-12
            )
            told = getattr(parts.about(base), name), getattr(right.about(base), name)
            np.testing.assert_allclose(*told, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("parameters", [5, 6])
@pytest.mark.parametrize("joint", [-1, 2])
def test_fits_are_those_of_numpy(parameters, joint):
    rng = np.random.default_rng(2)
    bank, normal = bank_of(rng, parameters), np.array([1.0, 0.3, 5.0])
    for number, curve in enumerate(bank.curves):
        size = rng.uniform(*sorted(curve.sizes[[0, -1]]))
        samples = samples_of(rng, curve.shift(size), 40)
        fit, sums = bank.fit(sums_of(samples), normal, 0.15, joint), oracle.Moments(samples)
        weights = oracle.weights(sums, normal, 0.15)
        np.testing.assert_allclose(sums_of(samples).weight(normal, 0.15), weights, rtol=1e-12)
        weights *= [joint in (-1, j) for j in range(JOINTS)]
        size, spread, cost, without = oracle.fit(bank.curves, sums, weights)
        assert fit.without == pytest.approx(without, rel=1e-12)
        assert fit.noise == pytest.approx(weights @ (sums.count * normal), rel=1e-12)
        np.testing.assert_allclose(fit.cost, cost, rtol=1e-9, atol=1e-12 * without)
        shown = [np.any(weights @ np.abs(c.shifts[-1])) for c in bank.curves]
        np.testing.assert_allclose(fit.size[shown], size[shown], rtol=1e-9)
        np.testing.assert_allclose(fit.spread[shown], spread[shown], rtol=1e-9)
        assert not shown[number] or int(np.argmin(fit.cost)) == number


def test_odds_are_those_of_numpy():
    rng = np.random.default_rng(3)
    bank = bank_of(rng, 5)
    for _ in range(5):
        cost = rng.uniform(50.0, 500.0, len(bank.curves))
        for independent, noise in ((10.0, 0.0), (10.0, 120.0), (0.0, 0.0)):
            np.testing.assert_allclose(
                chances(cost, bank.group.tolist(), 20.0, independent, noise),
                oracle.chances(bank.group, cost, 20.0, independent, noise),
                rtol=1e-12,
            )


class Stream:
    """Blocks of a learner whose machine changes twice, with the times when a case is closed."""

    def __init__(self, parameters=6, seed=4):
        self.rng = np.random.default_rng(seed)
        self.bank = bank_of(self.rng, parameters)
        self.base = self.rng.standard_normal((JOINTS, parameters))
        self.shifts = {4.0: self.bank.curves[4].shift(4.0), 9.0: self.bank.curves[2].shift(-3.0)}

    def blocks(self, end=13.0):
        time, learned = 0.0, self.base.copy()
        while time < end:
            count = int(self.rng.integers(1, 11))
            time += count * SETTINGS["sample_period"]
            true = self.base + sum(s for at, s in self.shifts.items() if time > at)
            samples = samples_of(self.rng, true, count)
            error = samples[..., -3] - np.einsum("njp,jp->nj", samples[..., :-3], learned)
            samples[..., -2] = error
            if any(at + 3.0 < time for at in self.shifts if learned is not true):
                learned = true
            yield time, samples, learned + 1e-6 * time  # no block's map is that of another


def same(sums, others):
    for name in NAMES:
        np.testing.assert_array_equal(getattr(sums, name), getattr(others, name))


def closes(time):
    return any(at + 2.0 < time < at + 2.1 for at in (4.0, 9.0))


def test_monitor_is_that_of_numpy():
    stream = Stream()
    settings = (JOINTS, 6, SETTINGS)
    core, plain = Monitor(*settings), oracle.Monitor(JOINTS, SETTINGS, 200)
    core.reset(200)
    onsets, looks = [], 0
    for time, samples, learned in stream.blocks():
        assert core.take(time, samples, learned) == plain.take(time, samples, learned)
        np.testing.assert_allclose(core.normal(), plain.watch.normal, rtol=1e-12)
        assert core.open == plain.open
        core.sum()
        if not core.open:
            continue
        if core.onset not in onsets:
            onsets.append(core.onset)
            np.testing.assert_array_equal(core.base(), plain.base)
            np.testing.assert_array_equal(core.regressors_before(), plain.before)
        assert core.onset == plain.onset
        if time > core.onset + 0.2:
            looked, right = core.look(), plain.look()
            for name in NAMES:
                own, oracles = getattr(looked, name), getattr(right, name)
                # What is left is the difference of larger sums.
                np.testing.assert_allclose(own, oracles, rtol=1e-9, atol=1e-9)
            looks += 1
        if closes(time):
            core.close(100)
            plain.close(100)
    assert onsets == pytest.approx([4.0, 9.0], abs=0.05)
    assert looks > 50


def test_changes_that_hardly_show_among_bursts_are_noticed_when_numpy_does():
    """Errors alone: they burst now and then, at times before an alarm is allowed, and grow.

    One joint is seen later than the others.
    """
    onsets = []
    for seed in range(30):
        rng = np.random.default_rng(100 + seed)
        core, plain = Monitor(JOINTS, 1, SETTINGS), oracle.Monitor(JOINTS, SETTINGS, 400)
        core.reset(400)
        growth = 1.0 + rng.uniform(1.0, 5.0, JOINTS) * (rng.random(JOINTS) < 0.5)
        time = 0.0
        while time < 12.0 and not core.open:
            count = int(rng.integers(1, 11))
            time += count * SETTINGS["sample_period"]
            samples = np.zeros((count, JOINTS, 4))
            level = 2.0 if time % 1.3 < 0.2 else 1.0
            samples[..., 2] = level * rng.standard_normal((count, JOINTS))
            samples[..., 2] *= growth if time > 6.0 else 1.0
            samples[..., 3] = 1.0
            samples[:, 1] *= time > 3.0
            if seed % 3 == 0 and 1.0 < time < 1.3:
                samples[..., 2] *= 4.0
            block = time, samples, np.zeros((JOINTS, 1))
            assert core.take(*block) == plain.take(*block)
            np.testing.assert_allclose(core.normal(), plain.watch.normal, rtol=1e-12)
        if core.open:
            assert core.onset == plain.onset
            onsets.append(core.onset)
    assert 5 < len(onsets) < 30
    assert sum(onset > 5.9 for onset in onsets) > 5


@pytest.mark.parametrize("samples", [1, 4, 13])
def test_in_pieces_all_is_as_at_once(samples):
    """One monitor sums a little after each block, as long as it takes."""
    stream = Stream(seed=5)
    once, pieces = (Monitor(JOINTS, 6, SETTINGS) for _ in range(2))
    once.reset(200)
    pieces.reset(200)
    compared = 0
    for time, block, learned in stream.blocks():
        assert once.take(time, block, learned) == pieces.take(time, block, learned)
        once.sum()
        if not once.open:
            continue
        caught_up = pieces.sum(samples)
        while not caught_up and time > once.onset + 0.2:
            caught_up = pieces.sum(samples)
        if caught_up:
            same(pieces.look(), once.look())
            compared += 1
        if closes(time):
            once.close(100)
            pieces.close(100)
    assert compared > 50


def test_samples_that_wait_longer_than_they_are_kept_are_not_lost():
    stream = Stream(seed=6)
    once, late = (Monitor(JOINTS, 6, SETTINGS) for _ in range(2))
    once.reset(200)
    late.reset(200)
    for time, block, learned in stream.blocks(end=8.0):
        once.take(time, block, learned)
        late.take(time, block, learned)
        once.sum()
    assert late.sum()
    same(late.look(), once.look())


def test_wrong_input_is_told_with_what_is_allowed():
    rng = np.random.default_rng(7)
    bank, monitor = bank_of(rng, 5), Monitor(JOINTS, 6, SETTINGS)
    base = np.zeros((JOINTS, 6))
    samples = samples_of(rng, base, 11)
    for act, told in (
        (lambda: sums_of(samples).about(base[:, 1:]), r"\(3, 5\), allowed is \(3, 6\)"),
        (lambda: Moments(JOINTS, 5).add(samples), r"\(11, 3, 9\), allowed is \(n, 3, 8\)"),
        (lambda: Moments(0, 5), "at least one joint"),
        (lambda: bank.fit(sums_of(samples), np.ones(3), 0.1), "differ in joints or parameters"),
        (lambda: bank.fit(Moments(JOINTS, 5), np.ones(2), 0.1), r"\(2\), allowed is \(3\)"),
        (lambda: chances(np.ones(3), [0, 1], 20.0, 0.0, 0.0), r"\(3\), allowed is \(2\)"),
        (lambda: chances(np.ones(2), [0, -1], 20.0, 0.0, 0.0), "from 0 on"),
        (lambda: monitor.take(1.0, samples, base), "block of 11 samples, allowed are 1 to 10"),
        (lambda: monitor.take(1.0, samples[:, :2], base), r"allowed is \(n, 3, 9\)"),
        (monitor.regressors_before, "no case is open"),
        (monitor.look, "no case is open"),
        (lambda: Bank([np.ones(2)], [np.ones((3, 1, 1))]), r"\(3, 1, 1\), allowed is \(2"),
    ):
        with pytest.raises(ValueError, match=told):
            act()
