"""Recordings of the two rigs from plain Python: knows neither MuJoCo nor leglab's effects.

Time stepping at 20 us: forces explicit, dry friction as the impulse that brakes at most to rest
(Moreau 1988), a flank of the gear play as a damped spring. A PD loop at 1 kHz follows a reference
by the drive's own fine encoder; its command is recorded with what a coarser encoder shows.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leglab.base.recording import Recording
from rigs.kept import kept

_H = 2e-5  # s
_PERIOD = 1e-3  # s
_FINE = 0.05  # noise of the drive's encoder, of that of the recorded one
_FOLDER = Path(__file__).parent


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A machine with one joint as its maker knows it; SI units, N m and rad on a hinge."""

    model: Path  #: MJCF of the same machine
    joint: str  #: Name of the joint
    load: float  #: Inertia of the moved body
    motor: float  #: Inertia of the motor, reflected
    pull: float  #: Gravity at a right angle, m g l
    viscous: float  #: Damping
    coulomb: float  #: Dry friction
    limit: float  #: Largest motor force
    reach: float  #: Size of the references
    gains: tuple[float, float]  #: Of the PD loop
    noise: float  #: RMS of the encoder's noise


SLIDE_AXIS = Rig(
    model=_FOLDER / "slide_axis.xml",
    joint="axis",
    load=2.0,
    motor=0.4,
    pull=0.0,
    viscous=6.0,
    coulomb=0.4,
    limit=80.0,
    reach=0.12,
    gains=(600.0, 50.0),
    noise=2e-5,
)
PENDULUM = Rig(
    model=_FOLDER / "pendulum.xml",
    joint="hinge",
    load=0.10,
    motor=0.02,
    pull=1.0 * 9.81 * 0.3,
    viscous=0.08,
    coulomb=0.0,
    limit=12.0,
    reach=1.0,
    gains=(12.0, 0.8),
    noise=1e-4,
)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Effects that the machine has and its model lacks."""

    forward: float = 0.0  #: Viscous friction that is added for v > 0
    backward: float = 0.0  #: The same for v < 0
    offset: float = 0.0  #: Constant force
    gear_loss: float = 0.0  #: Friction per motor force, in the bearing of the gear
    play: float = 0.0  #: Total backlash
    #: Stiffness and damping of the gear or coupling between motor and load; 0 = rigid.
    soft: tuple[float, float] = (0.0, 0.0)
    viscous_factor: float = 1.0  #: Of the damping, a tolerance of good machines
    #: Force that is a sine of the position: amplitude, period, phase.
    ripple: tuple[float, float, float] = (0.0, 1.0, 0.0)
    second: float = 0.0  #: Amplitude of its second harmonic, of the first


def _reference(kind: str, t: float, reach: float) -> float:
    if kind == "multisine":
        tones = ((0.31, 0.5, 0.2), (0.83, 0.3, 1.7), (1.9, 0.15, 4.1), (3.7, 0.05, 0.9))
        return reach * sum(a * math.sin(2 * math.pi * f * t + p) for f, a, p in tones)
    if kind == "slow":
        return reach * math.sin(2 * math.pi * 0.25 * t)
    if kind == "fast":
        return reach * (
            0.5 * math.sin(2 * math.pi * 1.1 * t) + 0.2 * math.sin(2 * math.pi * 2.3 * t)
        )
    if kind == "turns":  # round and round, some fifty rad
        return reach * (6.0 * t + 1.2 * math.sin(2 * math.pi * 0.7 * t))
    if kind == "back":
        return reach * (1.3 * math.sin(2 * math.pi * 0.9 * t) - 4.0 * t)
    if kind == "rests":  # every other two seconds, the rest moves as "fast"
        calm = min(max(abs((t % 4.0) - 3.0) - 1.0, 0.0), 1.0)
        return calm * _reference("fast", t, reach)
    if kind == "stairs":
        level = (0.0, 0.6, -0.3, 0.9, 0.2, -0.8, -0.1, 0.5)[int(t) % 8]
        before = (0.5, 0.0, 0.6, -0.3, 0.9, 0.2, -0.8, -0.1)[int(t) % 8]
        share = min((t % 1.0) / 0.5, 1.0)
        return reach * (before + (level - before) * share * share * (3 - 2 * share))
    raise ValueError(kind)


@kept
def record(
    rig: Rig,
    kind: str,
    truth: Truth,
    *,
    seed: int,
    seconds: float = 8.0,
    stamps: np.ndarray | None = None,
) -> Recording:
    """Position and command over one reference, see `_reference`.

    `stamps` are the times at which the loop wakes up, measures and commands; every 1 ms without.
    """
    rng = np.random.default_rng(seed)
    if stamps is None:
        stamps = _PERIOD * np.arange(round(seconds / _PERIOD))
    intervals = np.append(np.diff(stamps), _PERIOD)
    stepping = [(max(1, round(dt / _H)), dt) for dt in intervals.tolist()]
    kp, kd = rig.gains
    q = theta = _reference(kind, 0.0, rig.reach)
    v = w = 0.0
    half = 0.5 * truth.play
    stiffness, damping = 2e7 * rig.motor, 8e3 * rig.motor  # stiff greased teeth
    viscous = rig.viscous * truth.viscous_factor
    size, period, phase = truth.ripple
    positions, commands = [], []
    last, speed, passed = q, 0.0, _PERIOD
    for k, (steps, sample) in enumerate(stepping):
        now, h = float(stamps[k]), sample / steps
        measured = q + _FINE * rng.normal(0.0, rig.noise)
        speed += 0.2 * ((measured - last) / passed - speed) if k else 0.0
        last, passed = measured, sample
        goal = _reference(kind, now, rig.reach)
        ahead = _reference(kind, now + sample, rig.reach)
        force = kp * (goal - measured) + kd * ((ahead - goal) / sample - speed)
        force = min(max(force, -rig.limit), rig.limit)
        positions.append(q + rng.normal(0.0, rig.noise))
        commands.append(force)
        for _ in range(steps):
            side = truth.forward if v > 0 else truth.backward
            acting = truth.offset - (viscous + side) * v - rig.pull * math.sin(q)
            turn = 2.0 * math.pi * q / period
            acting += size * (math.sin(turn + phase) + truth.second * math.sin(2.0 * turn + 1.1))
            dry = rig.coulomb + truth.gear_loss * abs(force)
            if truth.play > 0 or truth.soft[0] > 0:
                gap, closing = theta - q, w - v
                drive = 0.0
                if truth.soft[0] > 0:
                    drive = truth.soft[0] * gap + truth.soft[1] * closing
                elif gap > half:
                    drive = max(0.0, stiffness * (gap - half) + damping * closing)
                elif gap < -half:
                    drive = min(0.0, stiffness * (gap + half) + damping * closing)
                w += h * (force - drive) / rig.motor
                theta += h * w
                mass = rig.load
                v += h * (acting + drive) / mass
            else:
                mass = rig.load + rig.motor
                v += h * (acting + force) / mass
            brake = h * dry / mass
            v = math.copysign(max(abs(v) - brake, 0.0), v)
            q += h * v
    columns = {f"{rig.joint}_position": np.array(positions), "drive_command": np.array(commands)}
    return Recording(time=stamps, columns=columns)
