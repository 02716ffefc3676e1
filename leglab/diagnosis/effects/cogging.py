"""Force on a joint that is periodic in the joint's position."""

import math

import numpy as np

from leglab.base.scale import deviation
from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, Values, register_effect
from leglab.diagnosis.effects.joints import JointEffect, SizedRow
from leglab.diagnosis.effects.spring import insert_spring
from leglab.diagnosis.plant.model import Change, ForceLeft, Machine

# Limits on the number of cycles over the recorded positions; fewer cycles resemble a spring.
_FEWEST_CYCLES = 0.8
_MOST_CYCLES = 200
# Spacing of the frequencies to search, in cycles over the recorded positions.
_SPACING = 0.2
# Limit at which forces are clipped, in median deviations: stick-slip and impacts are no cogging.
_CLIP = 6.0


def _period(machine: Machine, joint: str) -> EffectParameter:
    """Returns the period; its nominal value is short, as steps grow with the distance from it."""
    travel = joints.travel(machine, joint)
    return EffectParameter(
        "period",
        machine.unit(joint),
        nominal=0.02 * travel,
        lower=0.002 * travel,
        upper=4.0 * math.pi * travel,
        trials=(0.021 * travel,),
        role="shape",
    )


@register_effect
class Cogging(JointEffect):
    """A force that repeats with the position of the joint."""

    name = "cogging"
    physics = (
        "A sin(x) + B cos(x) and a second harmonic, x = 2 pi q/P: cogging of motors, eccentric "
        "gears, screws."
    )
    source = "Hanselman 2003: cogging to 10 % of a motor's torque; gear eccentricity ISO 1328"
    excitation = "slow motion over at least one period in both directions"
    contains = ("force_offset", "spring_stiffness", "spring_hardening", "spring_offset")
    rows = (
        SizedRow("sine", "{force}", (0.03,), lower=-2.0, upper=2.0),
        SizedRow("cosine", "{force}", (0.03,), lower=-2.0, upper=2.0),
        _period,
        EffectParameter("second_sine", "1", lower=-1.0, upper=1.0, trials=(0.3,), role="shape"),
        EffectParameter("second_cosine", "1", lower=-1.0, upper=1.0, trials=(0.3,), role="shape"),
    )

    def guess(self, left: ForceLeft) -> Values | None:
        """Returns the wave at the highest peak of the residual force's spectrum over position."""
        return wave(left)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a spring-damper with only the ripple."""
        if size := math.hypot(values["sine"], values["cosine"]):
            ripple = {
                "ripple_period": values["period"],
                "ripple_sine": values["sine"],
                "ripple_cosine": values["cosine"],
                "ripple_sine_2": size * values["second_sine"],
                "ripple_cosine_2": size * values["second_cosine"],
            }
            insert_spring(change, element, "cogging", ripple)


def wave(left: ForceLeft) -> Values | None:
    """Returns the wave at the highest peak of the force's spectrum over position, None if at rest.

    The spectrum is a least-squares fit at uneven positions (Lomb 1976). Friction, inertia and a
    cubic polynomial of the position are first projected out of the force.
    """
    q, v, a = left.position, left.velocity, left.acceleration
    reach = float(np.ptp(np.quantile(q, [0.01, 0.99])))
    # At most one cycle per 50 samples: a shorter wave cannot be estimated.
    grid = np.arange(_FEWEST_CYCLES, min(_MOST_CYCLES, 0.02 * q.size), _SPACING)
    if not (reach > 0.0 and grid.size):
        return None
    y, speed = (q - q.mean()) / reach, max(float(np.abs(v).mean()), 1e-12)
    sliding = np.tanh(v / (0.02 * speed))
    other = np.stack([np.ones(q.size), y, y**2, y**3, v, sliding, np.abs(v), a], axis=1)
    other /= np.linalg.norm(other, axis=0).clip(1e-12)
    basis = np.linalg.svd(other, full_matrices=False)[0]

    def without(columns: np.ndarray) -> np.ndarray:
        return columns - basis @ (basis.T @ columns)

    rest = without(left.force)
    for _ in range(2):
        limit = _CLIP * deviation(rest)
        rest = without(np.clip(rest, -limit, limit))

    def fitted(cycles: float, harmonics: int = 1) -> tuple[float, np.ndarray]:
        angle = 2.0 * math.pi * cycles / reach * q
        turns = [f(n * angle) for n in range(1, harmonics + 1) for f in (np.sin, np.cos)]
        columns = without(np.stack(turns, axis=1))
        inner = columns.T @ columns + 1e-9 * q.size * np.eye(2 * harmonics)
        amplitudes = np.linalg.solve(inner, columns.T @ rest)
        return float(amplitudes @ (columns.T @ rest)), amplitudes

    top = max(grid.tolist(), key=lambda cycles: fitted(cycles)[0])
    near = np.linspace(top - _SPACING, top + _SPACING, 21).tolist()
    cycles = max(near, key=lambda cycles: fitted(cycles, 2)[0])
    gain, found = fitted(cycles, 2)
    sine, cosine, *second = found.tolist()
    size = max(math.hypot(sine, cosine), 1e-300)
    second_sine, second_cosine = np.clip(np.array(second) / size, -1.0, 1.0).tolist()
    # A sine of about one cycle resembles the cubic that is projected out, so its amplitude is
    # ill-determined. It is limited to the amplitude of the force that the sine explains.
    shown = min(1.0, math.sqrt(2.0 * max(gain, 0.0) / q.size) / size)
    return {
        "sine": shown * sine,
        "cosine": shown * cosine,
        "period": reach / cycles,
        "second_sine": second_sine,
        "second_cosine": second_cosine,
    }
