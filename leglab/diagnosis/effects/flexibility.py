"""Flexibility between the drive and a joint: a soft gear, belt, coupling or shaft."""

import math

import numpy as np
from scipy.signal import bilinear, lfilter, lfilter_zi

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.backlash import Backlash, drive_torque, insert_play
from leglab.diagnosis.effects.base import EffectParameter, Values, register_effect
from leglab.diagnosis.plant.model import Change, Machine, Measured, Variant

# The element is a play with flanks; so little of it is none.
_NO_PLAY = 1e-9
# Of the joint on the spring with the motor held.
_TRIALS_HZ, _SOFTEST_HZ = (30.0, 12.0), 1.5


@register_effect
class JointFlexibility(Backlash):
    """A spring and damper between motor and joint."""

    name = "joint_flexibility"
    gradual = False
    physics = "J w' = tau - T, T = k (theta - q) + c (w - v); the joint feels T."
    source = "Spong 1987; harmonic drives and belts: 1e3 to 1e5 N m/rad"
    excitation = "torques that change quickly, fast reversals"

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Compliance of the spring, inertia of the motor, damping ratio."""
        own = joints.inertia(machine, element)
        softness = [1.0 / (own * (2.0 * math.pi * f) ** 2) for f in (*_TRIALS_HZ, _SOFTEST_HZ)]
        motor = super().parameters(machine, element)[1]
        return (
            EffectParameter(
                "compliance",
                joints.unit_of(machine, element, "{length}/({force})"),
                upper=softness[-1],
                trials=tuple(softness[:-1]),
            ),
            motor,
            EffectParameter(
                "damping_ratio", "1", nominal=0.1, lower=0.005, upper=2.0, role="shape"
            ),
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts the spring; at window starts it is twisted as the motor swings."""
        compliance, motor = values["compliance"], values["motor_inertia"]
        if compliance == 0.0:
            return
        own = joints.native(change.machine, element, "armature")
        link = max(joints.inertia(change.machine, element) - own, 1e-9)
        reduced = 1.0 / (1.0 / motor + 1.0 / link)
        damping = 2.0 * values["damping_ratio"] * math.sqrt(reduced / compliance)

        def twist(measured: Measured, variant: Variant) -> tuple[np.ndarray, np.ndarray]:
            h, velocity = measured.period, measured.velocity[element]
            acceleration = np.gradient(velocity, h)
            every, zero = np.arange(velocity.size), np.zeros(velocity.size)
            torque = drive_torque(measured, variant.model, element)(every, zero, zero)
            # J o'' + c o' + k o = tau - J q'' of the twist o, along the measured joint. Filtered is
            # the torque k o, whose gain is 1: that of o is as small as the compliance.
            excess = torque - motor * acceleration
            under = [motor * compliance, damping * compliance, 1.0]
            over, under = bilinear([1.0], under, 1.0 / h)
            start = lfilter_zi(over, under) * excess[0]
            offset = compliance * lfilter(over, under, excess, zi=start)[0]
            lag = 0.5 * variant.model.opt.timestep
            speed = velocity - lag * acceleration + np.gradient(offset, h)
            return offset[measured.samples], speed[measured.samples]

        play = {
            "width": _NO_PLAY,
            "motor_inertia": motor,
            "stiffness": 1.0 / compliance,
            "damping_ratio": values["damping_ratio"],
        }
        insert_play(change, f"{element}_flexibility", element, play, twist)
