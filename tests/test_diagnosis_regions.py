"""Where errors are largest, of errors made up by hand."""

import numpy as np

from leglab.diagnosis.regions import EVERYWHERE, worst_region

RNG = np.random.default_rng(3)
POSITION = RNG.uniform(-1.0, 1.0, 4000)
VELOCITY = RNG.normal(0.0, 1.0, 4000)
NOISE = 0.1 * RNG.normal(size=4000)
STATES = {"position": (POSITION, "rad"), "velocity": (VELOCITY, "rad/s")}


def test_noise_is_everywhere_alike():
    assert worst_region(NOISE, STATES) == EVERYWHERE
    assert worst_region(np.zeros(4000), STATES) == EVERYWHERE


def test_a_peak_at_zero_velocity_is_near_zero_velocity():
    told = worst_region(NOISE + np.exp(-((VELOCITY / 0.15) ** 2)), STATES)
    assert told.startswith("near zero velocity (-0.")
    assert told.endswith(" rad/s)")


def test_an_error_at_one_end_is_told_by_its_ends():
    told = worst_region(NOISE + np.where(POSITION > 0.6, 1.0, 0.0), STATES)
    low, high = (float(x) for x in told.removeprefix("at a position of ")[:-4].split(" to "))
    assert abs(low - 0.6) < 0.05
    assert abs(high - 0.99) < 0.03


def test_what_repeats_is_told_with_its_period():
    told = worst_region(NOISE + np.sin(2.0 * np.pi * POSITION / 0.45), STATES)
    assert told.startswith("repeating every 0.4")
    assert abs(float(told.split()[2]) - 0.45) < 0.02


def test_a_smooth_slope_does_not_repeat():
    assert "repeating" not in worst_region(NOISE + POSITION**3 - POSITION, STATES)
