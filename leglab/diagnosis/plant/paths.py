"""Faults of command and sensor paths, as functions of samples and as elements of a model.

Replays simulate the model without command and sensor paths. Paths in a model file are therefore
removed from the replayed model and applied to the recorded samples, like hypothetical faults.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping

import mujoco
import numpy as np
from scipy.signal import lfilter

from leglab._native import hydraulics as native
from leglab.machine import sensors

COMMAND_PATH = "leglab.command_path"
SIDES = ("positive", "negative")  # signs of a command
# Sinc interpolation: samples on each side, and shape parameter of the Kaiser window. Noise
# is unchanged up to about 0.9 of the Nyquist frequency; bins average out higher frequencies.
_TAPS, _KAISER = 16, 6.0

# Converts sent commands (n,), given the sampling period [s], to commands at the actuator (n,).
CommandPath = Callable[[np.ndarray, float], np.ndarray]
# Removes a sensor fault from measured samples (n,), given the sampling period [s].
Correction = Callable[[np.ndarray, float], np.ndarray]
# Corrections of a column in order, each with the factor by which it multiplies noise.
Corrections = list[tuple[Correction, float]]


def take_out(spec: mujoco.MjSpec) -> tuple[dict[str, list[CommandPath]], dict[str, Corrections]]:
    """Makes the command and sensor paths in a specification neutral, in place.

    Returns the removed command paths, in order by actuator, and sensor corrections, by column.
    """
    commands: defaultdict[str, list[CommandPath]] = defaultdict(list)
    for actuator in spec.actuators:
        if float(actuator.delay) > 0.0:
            commands[actuator.name] += command_path({"delay": actuator.delay})
            actuator.delay, actuator.nsample = 0.0, 0
    for plugin in spec.plugins:
        if plugin.plugin_name == COMMAND_PATH:
            config = dict(plugin.config)
            commands[config["actuator"]] += command_path(config)
            # Parameters whose effect does not depend on the command alone stay in the model.
            kept = ("actuator", "actuator_gain", "servo_dead_band", "max_delay")
            plugin.config = {k: v for k, v in config.items() if k in kept}
    corrections: defaultdict[str, Corrections] = defaultdict(list)
    for joint in spec.joints:
        for sensor in (*sensors.CHAMBERS, "position"):
            offset, scale = numerics(joint.name, sensor)
            undone = undo(number_of(spec, offset, 0.0), number_of(spec, scale, 1.0))
            corrections[f"{joint.name}_{sensor}"] += undone
        shown = spec.sensor(sensors.delayed_sensor(joint.name))
        if shown is not None and float(shown.delay) > 0.0:
            corrections[f"{joint.name}_position"].append((undo_delay(float(shown.delay)), 1.0))
            shown.delay, shown.nsample = 0.0, 0
    return dict(commands), {column: undone for column, undone in corrections.items() if undone}


def numerics(joint: str, sensor: str) -> tuple[str, str]:
    """Returns the names of the custom numerics of a sensor's offset and scale."""
    place = {"joint": joint, "chamber": sensor}
    if sensor == "position":
        return sensors.ENCODER_OFFSET.format(**place), sensors.ENCODER_SCALE.format(**place)
    return sensors.PRESSURE_OFFSET.format(**place), sensors.PRESSURE_SCALE.format(**place)


def set_number(spec: mujoco.MjSpec, name: str, value: float) -> None:
    """Sets or adds a custom numeric of a specification."""
    numeric = spec.numeric(name)
    if numeric is None:
        spec.add_numeric(name=name, data=[value], size=1)
    else:
        numeric.data = [value]


def number_of(spec: mujoco.MjSpec, name: str, otherwise: float) -> float:
    """Returns the value of a custom numeric of a specification; `otherwise` if it has none."""
    numeric = spec.numeric(name)
    return otherwise if numeric is None else float(numeric.data[0])


def command_path(config: Mapping[str, str | float]) -> list[CommandPath]:
    """Returns, in order, the functions that a `leglab.command_path` applies to commands."""
    names = ("delay", "bias", "hysteresis", "dead_band", "time_constant")
    delay, bias, width, half_width, time_constant = (float(config.get(n, 0.0)) for n in names)
    gain = float(config.get("gain", 1.0))
    bands = [half_width + float(config.get(f"dead_band_{side}", 0.0)) for side in SIDES]
    gains = [float(config.get(f"gain_{side}", 1.0)) for side in SIDES]
    found: list[CommandPath] = []
    if delay:
        found.append(lambda samples, period: delayed(samples, delay, period))
    if gain != 1.0 or bias:
        found.append(lambda samples, period: gain * samples + bias)
    if width:
        found.append(lambda samples, period: play(samples, width))
    if any(bands):
        found.append(lambda samples, period: dead_band(samples, *bands))
    if gains != [1.0, 1.0]:
        found.append(lambda samples, period: samples * np.where(samples > 0.0, *gains))
    if time_constant:
        found.append(lambda samples, period: lagged(samples, time_constant, period))
    return found


def delayed(samples: np.ndarray, delay: float, period: float) -> np.ndarray:
    """Delays held samples, (n,), by a delay >= 0 [s], not necessarily a multiple of the period."""
    whole, share = divmod(delay / period, 1.0)
    padded = np.concatenate([np.full(int(whole) + 1, samples[0]), samples])
    return (1.0 - share) * padded[1 : 1 + samples.size] + share * padded[: samples.size]


def play(samples: np.ndarray, width: float) -> np.ndarray:
    """Returns the output of a play (hysteresis) of this width, (n,), that starts in its middle."""
    if width <= 0.0:
        return samples
    out = np.empty(samples.size)
    native.play(np.ascontiguousarray(samples), width, out)
    return out


def dead_band(samples: np.ndarray, positive: float, negative: float) -> np.ndarray:
    """Returns samples, (n,), reduced by the band above and below zero; 0 inside the band."""
    return np.maximum(samples - positive, 0.0) - np.maximum(-samples - negative, 0.0)


def lagged(samples: np.ndarray, time_constant: float, period: float) -> np.ndarray:
    """Returns the mean over each period of the exact first-order response to held samples, (n,)."""
    if time_constant <= 0.0:  # A fit may end a rounding error below zero.
        return samples
    decay = math.exp(-period / time_constant)
    start = np.array([decay * samples[0]])
    reached, _ = lfilter([1.0 - decay], [1.0, -decay], samples, zi=start)
    before = np.concatenate([samples[:1], reached[:-1]])
    return samples + (before - samples) * (1.0 - decay) * time_constant / period


def undo(offset: float, scale: float) -> Corrections:
    """Returns functions that subtract an offset unless 0, then divide by a scale unless 1."""
    undone: Corrections = []
    if offset != 0.0:
        undone.append((lambda samples, period: samples - offset, 1.0))
    if scale != 1.0:
        undone.append((lambda samples, period: samples / scale, 1.0 / scale))
    return undone


def undo_delay(delay: float) -> Correction:
    """Returns a function that advances samples by a delay [s], by windowed sinc (Kaiser 1974).

    Linear interpolation would average neighbours, so that a fit could use a delay to reduce noise.
    """

    def forward(samples: np.ndarray, period: float) -> np.ndarray:
        whole, share = divmod(delay / period, 1.0)
        taps = np.arange(1 - _TAPS, _TAPS + 1)
        inside = np.sqrt(np.maximum(1.0 - ((taps - share) / _TAPS) ** 2, 0.0))
        weights = np.sinc(taps - share) * np.i0(_KAISER * inside)
        padded = np.pad(samples, (_TAPS - 1, int(whole) + _TAPS), "edge")
        out = np.correlate(padded, weights / weights.sum(), "valid")
        return out[int(whole) :][: samples.size]

    return forward
