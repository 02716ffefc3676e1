"""What is followed along a recording is followed anew only where its inputs changed."""

import numpy as np

from leglab.diagnosis.plant.hidden_states import HiddenStates


def test_the_same_inputs_are_followed_once_and_other_ones_anew():
    cache, calls = HiddenStates(), []

    def follow(*inputs):
        def result():
            calls.append(inputs)
            return sum(inputs)

        return cache.get("pump", inputs, result)

    one, two = np.arange(3.0), np.ones(3)
    first = follow(one, two)
    assert follow(one.copy(), two.copy()) is first
    assert len(calls) == 1
    # Every input counts, the last one as well, and one name's results are not another's.
    np.testing.assert_array_equal(follow(one, 2.0 * two), [2.0, 3.0, 4.0])
    np.testing.assert_array_equal(follow(one + 1.0, two), [2.0, 3.0, 4.0])
    other = cache.get("tank", (one, two), lambda: np.zeros(3))
    np.testing.assert_array_equal(other, 0.0)
    assert follow(one, two) is first
    assert len(calls) == 3


def test_only_the_last_few_results_stay():
    cache = HiddenStates()
    for k in range(20):
        cache.get("pump", (np.full(2, k),), lambda: np.zeros(2))
    assert len(cache.found["pump"]) < 6


def test_another_model_follows_anew():
    cache, model, other, calls = HiddenStates(), object(), object(), []

    def follow(by):
        def result():
            calls.append(by)
            return np.zeros(2)

        return cache.get("load", (np.ones(2),), result, by=by)

    first = follow(model)
    assert follow(model) is first
    assert follow(other) is not first
    assert calls == [model, other]
