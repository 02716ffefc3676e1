"""The pendulum with any of 22 faults, and copies of it with other inertias.

Knows neither MuJoCo nor leglab's effects: time stepping at 40 us, dry friction as the impulse that
brakes at most to rest (Moreau 1988), flanks of a play and soft couplings as damped springs. A PD
loop at 1 kHz follows a reference by the motor's own encoder.
"""

import math
from collections import defaultdict
from collections.abc import Mapping

import numpy as np

from leglab.base.recording import Recording
from rigs.kept import kept
from rigs.linkages import reference_share
from rigs.simulator import PENDULUM

_PERIOD, _SUBSTEPS = 1e-3, 25  # s, of a sample
_GRAVITY, _FINE = 9.81, 0.05  # m/s^2; noise of the motor's encoder, of that of the joint's
_CARRIED = 0.36  # m, where a payload is
_TOOTH, _PHASE, _STRIBECK = 0.37, 0.7, 0.05  # rad, rad, rad/s


@kept
def record_hinge(
    kind: str, hidden: Mapping[str, float], *, scale: float, seed: int, seconds: float = 5.0
) -> Recording:
    """Position and command over one reference, see `reference_share`.

    A copy has the lengths of the pendulum, and `scale` times its mass, inertia, damping and motor.

    Args:
        kind: Of the reference.
        hidden: Sizes of what the machine has and its model lacks [SI units]. Added forces are
            "viscous", "coulomb", "forward" (dry, for v > 0), "breakaway" (below some 0.05 rad/s),
            "loss" (dry, per motor torque), "quadratic", "stiffness", "cubic", "ripple" (a sine of
            the position) and "force". In the mechanism are "armature", "payload" [kg], "play" and
            "compliance" of the gear, on the command's way "delay", "dead" (half of the band),
            "hysteresis" (full width), "gain" (added to 1) and "lag" (time constant), and in the
            joint's encoder "offset", "scale" (added to 1) and "late".
        scale: Of the inertia.
        seed: Of the encoders' noise, which is the same at all scales.
        seconds: Length.
    """
    x, rig, rng = defaultdict(float, hidden), PENDULUM, np.random.default_rng(seed)
    noise = rng.standard_normal((2, round(seconds / _PERIOD))) * rig.noise
    load = scale * rig.load + x["payload"] * _CARRIED**2
    pull = scale * rig.pull + x["payload"] * _GRAVITY * _CARRIED
    motor, damping = scale * rig.motor + x["armature"], scale * rig.viscous + x["viscous"]
    kp, kd, limit = (scale * one for one in (*rig.gains, rig.limit))
    half, apart = 0.5 * x["play"], x["play"] > 0.0 or x["compliance"] > 0.0
    stiff, damped = 2e7 * scale * rig.motor, 8e3 * scale * rig.motor  # greased teeth
    if x["compliance"]:
        stiff = 1.0 / x["compliance"]
        damped = 0.2 * math.sqrt(stiff / (1.0 / motor + 1.0 / load))  # damping ratio 0.1
    h, late = _PERIOD / _SUBSTEPS, round(x["delay"] / _PERIOD)
    follow = 1.0 - math.exp(-h / x["lag"]) if x["lag"] else 1.0
    mass = load if apart else load + motor
    q = theta = last = rig.reach * reference_share(kind, 0.0, 0)
    v = w = speed = force = behind = 0.0
    positions, commands = [], []
    for k in range(noise.shape[1]):
        goal, ahead = (rig.reach * reference_share(kind, (k + i) * _PERIOD, 0) for i in (0, 1))
        seen = theta + _FINE * float(noise[0, k])
        speed += 0.2 * ((seen - last) / _PERIOD - speed) if k else 0.0
        last = seen
        command = kp * (goal - seen) + kd * ((ahead - goal) / _PERIOD - speed)
        positions.append(q)
        commands.append(min(max(command, -limit), limit))
        arrived = commands[max(k - late, 0)]
        arrived = math.copysign(max(abs(arrived) - x["dead"], 0.0), arrived)
        behind = min(max(behind, arrived - 0.5 * x["hysteresis"]), arrived + 0.5 * x["hysteresis"])
        arrived = (1.0 + x["gain"]) * behind
        for _ in range(_SUBSTEPS):
            force += follow * (arrived - force)
            acting = x["force"] - (damping + x["quadratic"] * abs(v)) * v - pull * math.sin(q)
            acting -= (x["stiffness"] + x["cubic"] * q * q) * q
            acting += x["ripple"] * math.sin(2.0 * math.pi * q / _TOOTH + _PHASE)
            dry = x["coulomb"] + x["loss"] * abs(force) + (x["forward"] if v > 0.0 else 0.0)
            dry += x["breakaway"] * math.exp(-((v / _STRIBECK) ** 2))
            drive, before = force, v
            if apart:
                gap = theta - q
                beyond = math.copysign(max(abs(gap) - half, 0.0), gap)
                drive = stiff * beyond + damped * (w - v) if beyond else 0.0
                if half and drive * gap < 0.0:
                    drive = 0.0  # flanks do not pull
                turned = w
                w += h * (force - drive) / motor
                theta += 0.5 * h * (turned + w)
            v += h * (acting + drive) / mass
            v = math.copysign(max(abs(v) - h * dry / mass, 0.0), v)
            q += 0.5 * h * (before + v)
            if not apart:
                theta = q
    time = _PERIOD * np.arange(len(positions))
    shown = np.interp(time - x["late"], time, positions)
    shown = (1.0 + x["scale"]) * shown + x["offset"] + noise[1]
    columns = {f"{rig.joint}_position": shown, "drive_command": np.array(commands)}
    return Recording(time=time, columns=columns)
