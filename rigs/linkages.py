"""Recordings of machines with one or two joints from Lagrange's equations.

Knows neither MuJoCo nor leglab. Runge and Kutta's fourth order at 0.2 ms; forces are functions of
position and velocity, commands are held over a sample. A PD loop at 1 kHz, or the drives' own
servos, follow a reference of their own in each joint.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leglab.base.recording import Recording
from rigs.kept import kept

_SUBSTEPS = 5  # of a sample
_PERIOD = 1e-3  # s
_GRAVITY = 9.81
_FOLDER = Path(__file__).parent

Pair = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """Effects that the machine has and its model lacks, by joint; SI units."""

    viscous: Pair = (0.0, 0.0)  #: Damping that is added
    quadratic: Pair = (0.0, 0.0)  #: Force over the square of the speed
    stiffness: Pair = (0.0, 0.0)  #: Of a spring to the zero position
    armature: Pair = (0.0, 0.0)  #: Inertia that turns with the drive
    gain: Pair = (1.0, 1.0)  #: Of the drive's force
    delay: Pair = (0.0, 0.0)  #: Of the command, a multiple of 0.2 ms
    offset: Pair = (0.0, 0.0)  #: Added to what the encoder shows
    force: Pair = (0.0, 0.0)  #: Constant
    payload: Pair = (0.0, 0.0)  #: Mass on the outer link and its distance from the link's joint
    #: Force on the first joint that is a sine of its position: amplitude, period, phase.
    ripple: tuple[float, float, float] = (0.0, 1.0, 0.0)


# Mass matrix (m11, m12, m22) and forces that inertia and weight oppose to the motion, at q, v.
Mechanism = Callable[[Pair, Pair, Pair], tuple[float, float, float, float, float]]


@dataclass(frozen=True, kw_only=True)
class Driven:
    """A machine with one or two joints as its maker knows it; SI units."""

    model: Path  #: MJCF of the same machine
    joints: tuple[str, ...]  #: Their names; one alone where the second is not there
    drives: tuple[str, ...]  #: Names of the drives of the first joints
    damping: Pair  #: Viscous, of the joints
    reach: Pair  #: Size of the references
    gains: tuple[Pair, ...]  #: Of each drive: of position and velocity
    limits: tuple[float, ...]  #: Largest force of each drive
    servo: bool = False  #: Whether gains are the drives' own and commands are positions


@dataclass(frozen=True, kw_only=True)
class Linkage(Driven):
    """One that moves as a mechanism."""

    mechanism: Mechanism  #: Inertia and weight under a payload
    noise: Pair = (1e-4, 1e-4)  #: RMS of the encoders' noise


def _arm(q: Pair, v: Pair, payload: Pair) -> tuple[float, float, float, float, float]:
    """Two links in a vertical plane, hanging down at zero; the second angle is between them."""
    upper = 0.4  # m
    m11, m12, m22 = 0.03 + 0.05 + 2.5 * 0.2**2, 0.0, 0.03
    c1 = c2 = 0.0
    g1, g2 = 2.5 * _GRAVITY * 0.2 * math.sin(q[0]), 0.0
    s, c, both = math.sin(q[1]), math.cos(q[1]), math.sin(q[0] + q[1])
    # Masses on the outer link: its own with its inertia, and a point.
    for mass, at, own in ((1.5, 0.17, 0.015), (payload[0], payload[1], 0.0)):
        m11 += own + mass * (upper**2 + at**2 + 2.0 * upper * at * c)
        m12 += own + mass * (at**2 + upper * at * c)
        m22 += own + mass * at**2
        turn = mass * upper * at * s
        c1 -= turn * (2.0 * v[0] * v[1] + v[1] ** 2)
        c2 += turn * v[0] ** 2
        g1 += mass * _GRAVITY * (upper * math.sin(q[0]) + at * both)
        g2 += mass * _GRAVITY * at * both
    return m11, m12, m22, c1 + g1, c2 + g2


def _pendulum(q: Pair, v: Pair, payload: Pair) -> tuple[float, float, float, float, float]:
    """One link, hanging down at zero; the second joint never moves."""
    m11, g1, s = 0.02, 0.0, math.sin(q[0])
    for mass, at, own in ((1.0, 0.3, 0.01), (payload[0], payload[1], 0.0)):
        m11 += own + mass * at**2
        g1 += mass * _GRAVITY * at * s
    return m11, 0.0, 1.0, g1, 0.0


def _gantry(q: Pair, v: Pair, payload: Pair) -> tuple[float, float, float, float, float]:
    """A trolley on a bridge and what swings below it; the swing has no drive."""
    m11, m12, m22, c1, g2 = 8.0, 0.0, 0.0, 0.0, 0.0
    s, c = math.sin(q[1]), math.cos(q[1])
    for mass, at, own in ((3.0, 0.6, 0.04), (payload[0], payload[1], 0.0)):
        m11 += mass
        m12 += mass * at * c
        m22 += own + mass * at**2
        c1 -= mass * at * s * v[1] ** 2
        g2 += mass * _GRAVITY * at * s
    return m11, m12, m22, c1, g2


MOTOR_ARM = Linkage(
    model=_FOLDER / "motor_arm.xml",
    joints=("shoulder", "elbow"),
    drives=("shoulder_drive", "elbow_drive"),
    mechanism=_arm,
    damping=(0.6, 0.3),
    reach=(0.9, 1.1),
    gains=((90.0, 9.0), (40.0, 3.0)),
    limits=(60.0, 25.0),
)
SERVO_ARM = replace(
    MOTOR_ARM,
    model=_FOLDER / "servo_arm.xml",
    gains=((150.0, 8.0), (60.0, 3.0)),
    limits=(math.inf, math.inf),
    servo=True,
)
SERVO_JOINT = Linkage(
    model=_FOLDER / "servo_joint.xml",
    joints=("hinge",),
    drives=("servo",),
    mechanism=_pendulum,
    damping=(0.08, 0.0),
    reach=(1.0, 0.0),
    gains=((120.0, 4.0),),
    limits=(math.inf,),
    servo=True,
)
GANTRY = Linkage(
    model=_FOLDER / "gantry.xml",
    joints=("trolley", "swing"),
    drives=("trolley_drive",),
    mechanism=_gantry,
    damping=(15.0, 0.05),
    reach=(0.4, 0.0),
    gains=((900.0, 220.0),),
    limits=(400.0,),
    noise=(2e-5, 1e-4),
)

# Frequency [Hz], share of the reach and phase of each tone.
_TONES = {
    "multisine": ((0.31, 0.45, 0.2), (0.83, 0.3, 1.7), (1.9, 0.18, 4.1), (3.7, 0.07, 0.9)),
    "fast": ((1.1, 0.5, 0.0), (2.3, 0.25, 1.0)),
    "slow": ((0.23, 0.7, 0.5), (0.41, 0.3, 2.0)),
}


def reference_share(kind: str, t: float, joint: int) -> float:
    """Share of the reach; joints move at slightly different tones, each on its own."""
    if kind == "stairs":
        levels = (0.0, 0.6, -0.3, 0.9, 0.2, -0.8, -0.1, 0.5)
        t += 0.37 * joint
        i, share = int(t), min((t % 1.0) / 0.5, 1.0)
        before, level = levels[(i + 3 * joint) % 8], levels[(i + 1 + 3 * joint) % 8]
        return before + (level - before) * share * share * (3 - 2 * share)
    stretch = 1.0 + 0.17 * joint
    return sum(
        a * math.sin(2 * math.pi * f * stretch * t + p + 2.1 * joint) for f, a, p in _TONES[kind]
    )


@kept
def record_linkage(
    rig: Linkage, kind: str, hidden: Hidden, *, seed: int, seconds: float = 6.0
) -> Recording:
    """Positions and commands over one reference: "multisine", "fast", "slow" or "stairs"."""
    rng = np.random.default_rng(seed)
    h = _PERIOD / _SUBSTEPS
    late = [round(d / h) for d in hidden.delay]
    driven = range(len(rig.drives))
    q: Pair = tuple(reference_share(kind, 0.0, j) * rig.reach[j] for j in (0, 1))
    v: Pair = (0.0, 0.0)
    positions, commands = [], []
    last, speed = q, [0.0, 0.0]
    history: list[list[float]] = []  # commands, one a sub-step

    def forces(q: Pair, v: Pair, arrived: list[float]) -> list[float]:
        out = []
        for j in (0, 1):
            drive = 0.0
            if j in driven:
                drive = arrived[j]
                if rig.servo:
                    drive = rig.gains[j][0] * (drive - q[j]) - rig.gains[j][1] * v[j]
            out.append(
                hidden.gain[j] * drive
                + hidden.force[j]
                - (rig.damping[j] + hidden.viscous[j]) * v[j]
                - hidden.quadratic[j] * abs(v[j]) * v[j]
                - hidden.stiffness[j] * q[j]
            )
        size, period, phase = hidden.ripple
        out[0] += size * math.sin(2.0 * math.pi * q[0] / period + phase)
        return out

    def rate(q: Pair, v: Pair, arrived: list[float]) -> Pair:
        m11, m12, m22, b1, b2 = rig.mechanism(q, v, hidden.payload)
        m11, m22 = m11 + hidden.armature[0], m22 + hidden.armature[1]
        f = forces(q, v, arrived)
        f1, f2 = f[0] - b1, f[1] - b2
        det = m11 * m22 - m12 * m12
        return (m22 * f1 - m12 * f2) / det, (m11 * f2 - m12 * f1) / det

    def moved(x: Pair, by: Pair, share: float) -> Pair:
        return x[0] + share * by[0], x[1] + share * by[1]

    for k in range(round(seconds / _PERIOD)):
        shown = tuple(
            q[j] + hidden.offset[j] + 0.05 * rng.normal(0.0, rig.noise[j]) for j in (0, 1)
        )
        command = []
        for j in driven:
            goal = rig.reach[j] * reference_share(kind, k * _PERIOD, j)
            if rig.servo:
                command.append(goal)
                continue
            ahead = rig.reach[j] * reference_share(kind, (k + 1) * _PERIOD, j)
            speed[j] += 0.2 * ((shown[j] - last[j]) / _PERIOD - speed[j]) if k else 0.0
            kp, kd = rig.gains[j]
            force = kp * (goal - shown[j]) + kd * ((ahead - goal) / _PERIOD - speed[j])
            command.append(min(max(force, -rig.limits[j]), rig.limits[j]))
        last = shown
        positions.append([q[j] + hidden.offset[j] + rng.normal(0.0, rig.noise[j]) for j in (0, 1)])
        commands.append(command)
        for _ in range(_SUBSTEPS):
            history.append(command)
            arrived = [history[max(len(history) - 1 - late[j], 0)][j] for j in driven]
            a1 = rate(q, v, arrived)
            v2 = moved(v, a1, 0.5 * h)
            a2 = rate(moved(q, v, 0.5 * h), v2, arrived)
            v3 = moved(v, a2, 0.5 * h)
            a3 = rate(moved(q, v2, 0.5 * h), v3, arrived)
            v4 = moved(v, a3, h)
            a4 = rate(moved(q, v3, h), v4, arrived)
            q = tuple(q[j] + h / 6.0 * (v[j] + 2.0 * v2[j] + 2.0 * v3[j] + v4[j]) for j in (0, 1))
            v = tuple(v[j] + h / 6.0 * (a1[j] + 2.0 * a2[j] + 2.0 * a3[j] + a4[j]) for j in (0, 1))
    columns = {f"{name}_position": np.array(positions)[:, j] for j, name in enumerate(rig.joints)}
    columns |= {f"{name}_command": np.array(commands)[:, j] for j, name in enumerate(rig.drives)}
    return Recording(time=_PERIOD * np.arange(len(positions)), columns=columns)
