"""Hidden plugin states at the starts of windows: what no sensor sees follows from what it saw."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from leglab.diagnosis.change import Measured
from leglab.diagnosis.machine import CYLINDER, FRICTION, Machine, Variant
from leglab.diagnosis.paths import play

# A bristle forgets over some tenths of a millimetre; this much history is enough.
_BRISTLE_HISTORY = 0.5  # s

# Fills hidden states into `state`, shape (windows, npluginstate), for one instance.
Rule = Callable[[Machine, Measured, Variant, str, np.ndarray], None]
_RULES: dict[str, Rule] = {}


def reconstructs(plugin: str) -> Callable[[Rule], Rule]:
    """Registers how the hidden states of a plugin's instances follow from measured series."""

    def add(rule: Rule) -> Rule:
        _RULES[plugin] = rule
        return rule

    return add


def reconstruct(machine: Machine, measured: Measured, variant: Variant, state: np.ndarray) -> None:
    """Fills the hidden states of all plugin instances in place.

    Args:
        machine: The unmodified machine.
        measured: Series of one recording.
        variant: Compiled model.
        state: Parameters and states at window starts, shape (windows, npluginstate).
    """
    for element, (_, table) in variant.elements.items():
        if table.plugin in _RULES:
            _RULES[table.plugin](machine, measured, variant, element, state)


def bristle(
    velocity: np.ndarray, level: np.ndarray, sigma: float, period: float, samples: np.ndarray
) -> np.ndarray:
    """LuGre bristle at samples, shape (windows,), by its exact solution between samples.

    z' = v - sigma |v| z / g with v and g held over a sample (Canudas de Wit et al. 1995).

    Args:
        velocity: Of sliding, shape (n,).
        level: Steady friction g, shape (n,).
        sigma: Bristle stiffness.
        period: s.
        samples: Where it is wanted.
    """
    if sigma <= 0.0:
        return np.zeros(samples.size)
    decay = sigma * np.abs(velocity) / level * period
    gain = np.sign(velocity) * level / sigma * -np.expm1(-decay)
    history = np.arange(-round(_BRISTLE_HISTORY / period), 0)
    index = samples[:, None] + history
    before = index < 0
    index = index.clip(0)
    passed = np.where(before, 0.0, decay[index])
    # Everything that fades after sample j, exclusive of j itself.
    later = np.cumsum(passed[:, ::-1], axis=1)[:, ::-1] - passed
    return np.sum(np.where(before, 0.0, gain[index]) * np.exp(-later), axis=1)


def spool(command: np.ndarray, frequency: float, damping: float, period: float) -> np.ndarray:
    """Spool position and velocity, shape (n, 2), that follow a held command from rest.

    Args:
        command: Shape (n,).
        frequency: rad/s.
        damping: Damping ratio.
        period: s.
    """
    w, z = frequency, damping
    transition = expm(np.array([[0.0, 1.0], [-w * w, -2.0 * z * w]]) * period)
    drive = (np.eye(2) - transition) @ np.array([1.0, 0.0])
    # x[k+1] = A x[k] + b u[k] as two filters with the characteristic polynomial of A.
    trace, determinant = np.trace(transition), np.linalg.det(transition)
    first = command[0]
    out = []
    for row in (0, 1):
        other = 1 - row
        cross = transition[row, other] * drive[other] - transition[other, other] * drive[row]
        numerator = [0.0, drive[row], cross]
        out.append(lfilter(numerator, [1.0, -trace, determinant], command - first))
    return np.stack([out[0] + first, out[1]], axis=1)


@reconstructs(CYLINDER)
def _cylinder(
    machine: Machine, measured: Measured, variant: Variant, element: str, state: np.ndarray
) -> None:
    start, table = variant.elements[element]

    def get(name: str) -> float:
        return float(state[0, start + table.entry(name).offset])

    def put(name: str, values: np.ndarray) -> None:
        state[:, start + table.entry(name).offset] = values

    samples = measured.samples
    command = np.clip(measured.command[element], -1.0, 1.0)
    behind = play(command, get("hysteresis"))
    target = np.clip(behind + get("null_bias"), -1.0, 1.0)
    moved = spool(target, 2.0 * np.pi * get("bandwidth_hz"), get("damping_ratio"), measured.period)
    put("play_output", behind[np.maximum(samples - 1, 0)])
    put("spool_position", np.clip(moved[samples, 0], -1.0, 1.0))
    put("spool_velocity", moved[samples, 1])

    velocity = measured.piston_velocity[element]
    joint = machine.driven[element][0]
    pressures = sum(measured.pressure.get(f"{joint}_pressure_{c}", 0.0) for c in "ab")
    seal = get("pressure_coefficient") * np.maximum(pressures, 0.0)
    share = np.exp(-((velocity / get("stribeck_velocity")) ** 2))
    level = get("coulomb") + seal + (get("static") - get("coulomb")) * share
    level = np.maximum(level, 1e-9)
    sigma = get("sigma_0")
    if sigma <= 0.0:
        return
    put("bristle", bristle(velocity, level, sigma, measured.period, samples))


@reconstructs(FRICTION)
def _joint_friction(
    machine: Machine, measured: Measured, variant: Variant, element: str, state: np.ndarray
) -> None:
    start, table = variant.elements[element]

    def get(name: str) -> float:
        return float(state[0, start + table.entry(name).offset])

    joint = variant.joint_of[element]
    velocity = measured.velocity[joint]
    share = np.exp(-((velocity / get("stribeck_velocity")) ** 2))
    level = get("coulomb") + (get("static") - get("coulomb")) * share
    side = 1.0 + np.sign(velocity) * get("direction_asymmetry")
    level = np.maximum(level * get("wear") * side, 1e-9)
    values = bristle(velocity, level, get("sigma_0"), measured.period, measured.samples)
    state[:, start + table.entry("bristle").offset] = values
