"""References of the blind tests: slow, multisine, steps and walking, random in their details."""

import numpy as np

from leglab.studies.blind.plant import SAMPLING_PERIOD

NAMES = ("multisine", "slow", "steps", "walk")
_MIDDLE = 0.9  # rad


def references(rng: np.random.Generator, duration: float = 12.0) -> dict[str, np.ndarray]:
    """Knee references [rad] at the sampling period, each (n,), by name."""
    time = SAMPLING_PERIOD * np.arange(round(duration / SAMPLING_PERIOD))
    frequencies = np.array([0.17, 0.25, 0.5, 0.92, 1.58, 2.3])
    amplitudes = np.array([0.12, 0.1, 0.13, 0.07, 0.035, 0.015])
    phases = rng.uniform(0.0, 2.0 * np.pi, frequencies.size)
    multisine = _MIDDLE + amplitudes @ np.sin(
        2.0 * np.pi * np.outer(frequencies, time) + phases[:, None]
    )
    period = rng.uniform(7.0, 10.0)
    slow = _MIDDLE + 0.38 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * time / period))
    steps = np.full(time.size, _MIDDLE)
    now = 0.5
    while now < duration:
        steps[time >= now] = rng.uniform(0.62, 1.27)
        now += rng.uniform(0.6, 1.2)
    beat = 2.0 * np.pi * rng.uniform(0.85, 1.05) * time
    shift = rng.uniform(0.0, 2.0 * np.pi)
    walk = 0.78 + 0.36 * np.sin(beat + shift) + 0.18 * np.sin(2.0 * beat + shift + 1.0)
    found = {"multisine": multisine, "slow": slow, "steps": steps, "walk": walk}
    # Every motion begins gently from rest.
    fade = np.minimum(time / 0.5, 1.0)
    return {
        name: values if name == "steps" else _MIDDLE + fade * (values - _MIDDLE)
        for name, values in found.items()
    }
