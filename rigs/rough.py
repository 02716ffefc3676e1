"""Motor-driven machines that differ from their models everywhere a little, with hidden faults.

Knows neither MuJoCo nor leglab. Lagrange's equations of one or two links in a vertical plane, by
Runge and Kutta's fourth order at 0.2 ms; a machine draws its masses, its law of friction, its
drives' lag, its gears' teeth and its encoders. Recordings of many machines are made at once.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leglab.base.recording import Recording
from rigs.kept import kept
from rigs.linkages import Driven, Pair, reference_share

_SUBSTEPS = 5  # of a sample
_PERIOD = 1e-3  # s
_GRAVITY = 9.81
_FOLDER = Path(__file__).parent
KINDS = ("multisine", "fast", "slow", "stairs")


@dataclass(frozen=True, kw_only=True)
class RoughRig(Driven):
    """One of links in a vertical plane."""

    #: Mass, distance of its centre from the joint and inertia about the centre, by link.
    links: tuple[tuple[float, float, float], ...]
    length: float  #: From the first joint to the second
    armature: Pair  #: By joint, as all that follows
    coulomb: Pair  #: Dry friction
    torque: Pair  #: What the joint usually bears; faults and small irregularities are shares of it


ROUGH_ARM = RoughRig(
    model=_FOLDER / "rough_arm.xml",
    joints=("shoulder", "elbow"),
    drives=("shoulder_drive", "elbow_drive"),
    links=((2.5, 0.2, 0.03), (1.5, 0.17, 0.015)),
    length=0.4,
    armature=(0.05, 0.03),
    damping=(0.6, 0.3),
    coulomb=(0.8, 0.3),
    torque=(12.0, 3.0),
    reach=(0.9, 1.1),
    gains=((90.0, 9.0), (40.0, 3.0)),
    limits=(60.0, 25.0),
)
ROTOR = RoughRig(
    model=_FOLDER / "rotor.xml",
    joints=("shaft",),
    drives=("motor",),
    links=((0.0, 0.0, 0.03),),
    length=0.0,
    armature=(0.01,),
    damping=(0.05,),
    coulomb=(0.06,),
    torque=(0.6,),
    reach=(2.0,),
    gains=((6.0, 0.5),),
    limits=(6.0,),
)
SERVO_LINK = RoughRig(
    model=_FOLDER / "servo_link.xml",
    joints=("hinge",),
    drives=("servo",),
    links=((1.0, 0.3, 0.01),),
    length=0.0,
    armature=(0.02,),
    damping=(0.08,),
    coulomb=(0.1,),
    torque=(2.5,),
    reach=(1.0,),
    gains=((60.0, 3.0),),
    limits=(math.inf,),
    servo=True,
)
RIGS = {rig.model.stem: rig for rig in (ROUGH_ARM, ROTOR, SERVO_LINK)}

# Of a machine: by parameter its value in each joint.
Values = dict[str, np.ndarray]

_NAMES = (
    *("mass", "centre", "inertia", "armature", "damping", "exponent", "coulomb", "breakaway"),
    *("stribeck", "rise", "asymmetry", "loss", "gain", "lag", "delay", "dead", "teeth"),
    *("teeth_period", "teeth_phase", "offset", "scale", "force", "stiffness", "quadratic"),
    *("forward", "backward", "ripple", "ripple_period", "ripple_phase", "payload", "payload_at"),
    *("tilt", "counts", "noise"),
)


def as_made(rig: RoughRig) -> Values:
    """The machine that the model is of: each value (joints,)."""
    n = len(rig.joints)
    mass, centre, inertia = np.array(rig.links).T
    nothing = np.zeros(n)
    same = {
        "mass": mass,
        "centre": centre,
        "inertia": inertia,
        "armature": np.array(rig.armature),
        "damping": np.array(rig.damping),
        "coulomb": np.array(rig.coulomb),
        "rise": np.full(n, 2e-3),
        "counts": np.full(n, 1e-9),
        "noise": np.full(n, 1e-6),
        "lag": np.full(n, 1e-6),
    }
    ones = ("exponent", "breakaway", "stribeck", "gain", "scale", "teeth_period", "ripple_period")
    values = dict.fromkeys(_NAMES, nothing) | {name: np.ones(n) for name in ones} | same
    return {name: value.copy() for name, value in values.items()}


def _fastest(rig: RoughRig) -> np.ndarray:
    """About the largest speed over the references, (joints,)."""
    return 5.0 * np.array(rig.reach)


def machine(rig: RoughRig, rng: np.random.Generator) -> Values:
    """Draws a healthy machine: each value (joints,)."""
    n = len(rig.joints)

    def normal(size: float) -> np.ndarray:
        return size * np.clip(rng.standard_normal(n), -2.0, 2.0)

    def between(low: float, high: float) -> np.ndarray:
        return rng.uniform(low, high, n)

    torque, coulomb = np.array(rig.torque), np.array(rig.coulomb)
    stiff = np.array([g[0] for g in rig.gains]) if rig.servo else 1.0  # torque of a unit command
    mass, centre, inertia = np.array(rig.links).T
    return as_made(rig) | {
        "mass": mass * np.exp(normal(0.02)),
        "centre": centre * np.exp(normal(0.015)),
        "inertia": inertia * np.exp(normal(0.06)),
        "armature": np.array(rig.armature) * np.exp(normal(0.10)),
        "damping": np.array(rig.damping) * np.exp(normal(0.20)),
        "exponent": between(0.9, 1.1),  # of the viscous part
        "coulomb": coulomb * np.exp(normal(0.15)),
        "breakaway": between(1.0, 1.4),  # static over sliding friction
        "stribeck": between(0.02, 0.1),
        "rise": between(0.004, 0.015),  # speed at which dry friction is three quarters there
        "asymmetry": normal(0.03),  # of dry friction
        "loss": between(0.0, 0.02),  # friction by the torque of the drive
        "gain": 1.0 + normal(0.02),
        "lag": between(0.3e-3, 1.5e-3),
        "delay": between(0.2e-3, 1.4e-3),
        "dead": torque / stiff * between(0.0, 0.004),
        "teeth": torque * between(0.002, 0.012),
        "teeth_period": between(0.15, 0.8),
        "teeth_phase": between(0.0, 2.0 * math.pi),
        "offset": normal(0.002),
        "force": torque * normal(0.005),
        "stiffness": torque * between(0.0, 0.01),
        "quadratic": torque * between(0.0, 0.02) / _fastest(rig) ** 2,
        "payload_at": np.full(n, 0.2),
        "tilt": np.repeat(np.clip(rng.standard_normal(), -2.0, 2.0) * 0.004, n),
        "counts": np.full(n, 2.0 * math.pi / 65536),
        "noise": np.exp(between(math.log(3e-5), math.log(1.5e-4))),
    }


# Sizes of gross faults, log-uniform: lower and upper, and whether either sign is drawn. Shares of
# the joint's torque, friction, inertia; seconds, rad.
FAULTS: Mapping[str, tuple[float, float, bool]] = {
    "viscous_friction": (1.2, 5.0, False),
    "coulomb_friction": (1.0, 4.0, False),
    "asymmetric_friction": (0.8, 4.0, True),
    "load_dependent_friction": (0.08, 0.3, False),
    "stiction": (1.0, 4.0, False),
    "actuator_gain": (0.12, 0.4, True),
    "command_delay": (4e-3, 1.5e-2, False),
    "command_deadband": (0.06, 0.3, False),
    "payload": (0.15, 0.6, False),
    "armature": (0.3, 1.2, False),
    "spring_stiffness": (0.15, 0.6, False),
    "quadratic_damping": (0.2, 1.0, False),
    "force_offset": (0.06, 0.3, True),
    "encoder_offset": (0.04, 0.15, True),
    "encoder_scale": (0.03, 0.12, True),
    "cogging": (0.08, 0.3, False),
}


def faults_of(rig: RoughRig) -> tuple[str, ...]:
    """Those that a rig can show.

    Without weight its encoder's zero is anywhere, and an encoder's scale is the drive's.
    """
    weightless = {"encoder_offset", "encoder_scale", "payload"} if rig.links[0][0] == 0.0 else set()
    return tuple(name for name in FAULTS if name not in weightless)


def hide(rig: RoughRig, values: Values, fault: str, joint: int, rng: np.random.Generator) -> float:
    """Puts a fault into a machine; returns its size."""
    low, high, signed = FAULTS[fault]
    size = math.exp(rng.uniform(math.log(low), math.log(high)))
    size *= float(rng.choice((-1.0, 1.0))) if signed else 1.0
    torque, outer = rig.torque[joint], len(rig.joints) - 1
    m, at, own = rig.links[outer]
    inertia = rig.armature[joint] + own + m * at**2
    if joint < outer:
        first = rig.links[joint]
        inertia += first[2] + first[0] * first[1] ** 2 + m * rig.length**2
    # What grows by the size, and the unit of the size there.
    grows = {
        "viscous_friction": ("damping", rig.damping[joint]),
        "coulomb_friction": ("coulomb", rig.coulomb[joint]),
        "load_dependent_friction": ("loss", 1.0),
        "stiction": ("breakaway", 1.0),
        "command_delay": ("delay", 1.0),
        "command_deadband": ("dead", torque / rig.gains[joint][0] if rig.servo else torque),
        "armature": ("armature", inertia),
        "spring_stiffness": ("stiffness", torque),
        "force_offset": ("force", torque),
        "encoder_offset": ("offset", 1.0),
        "encoder_scale": ("scale", 1.0),
    }
    if fault in grows:
        name, unit = grows[fault]
        values[name][joint] += size * unit
    elif fault == "asymmetric_friction":
        side = "forward" if size > 0 else "backward"
        values[side][joint] = abs(size) * rig.coulomb[joint]
    elif fault == "actuator_gain":
        values["gain"][joint] *= 1.0 + size
    elif fault == "payload":
        values["payload"][outer] = size * m
        values["payload_at"][outer] = at * rng.uniform(0.8, 1.8)
    elif fault == "quadratic_damping":
        values["quadratic"][joint] += size * torque / _fastest(rig)[joint] ** 2
    else:
        values["ripple"][joint] = size * torque
        values["ripple_period"][joint] = math.exp(rng.uniform(math.log(0.15), math.log(0.9)))
        values["ripple_phase"][joint] = rng.uniform(0.0, 2.0 * math.pi)
    return size


@kept
def record_rough(
    rig: RoughRig, machines: Sequence[Values], *, seed: int, seconds: float = 8.0
) -> list[dict[str, Recording]]:
    """Four recordings of each machine, by the kind of the reference."""
    n, kinds = len(rig.joints), len(KINDS)
    count = len(machines) * kinds
    p = {
        k: np.repeat(np.stack([one[k] for one in machines], axis=1), kinds, axis=1)
        for k in machines[0]
    }  # (joints, runs)
    samples = round(seconds / _PERIOD)
    goals = np.array(
        [
            [
                [rig.reach[j] * reference_share(kind, t * _PERIOD, j) for kind in KINDS]
                for j in range(n)
            ]
            for t in range(samples + 1)
        ]
    )  # (samples, joints, kinds)
    goals = np.tile(goals, (1, 1, len(machines)))
    rng = np.random.default_rng(seed)
    kp, kd = (np.array([g[i] for g in rig.gains])[:, None] for i in (0, 1))
    limits = np.array(rig.limits)[:, None]
    h = _PERIOD / _SUBSTEPS
    late = np.round(p["delay"] / h).astype(int)
    depth = int(late.max()) + 1
    rows = np.arange(n)[:, None], np.arange(count)[None, :]
    commands = np.zeros((depth, n, count))
    q, v = goals[0].copy(), np.zeros((n, count))
    act = np.zeros((n, count))
    if rig.servo:
        commands[:] = q
        act[:] = q
    last, speed = q * p["scale"] + p["offset"], np.zeros((n, count))
    taken_q, taken_u = np.empty((samples, n, count)), np.empty((samples, n, count))
    step = 0

    def rates(q: np.ndarray, v: np.ndarray, act: np.ndarray) -> np.ndarray:
        drive = act
        if rig.servo:
            drive = kp * (act - q) - kd * v
        drive = p["gain"] * drive
        dry = p["coulomb"] * (1.0 + p["asymmetry"] * np.sign(v))
        dry = dry * (1.0 + (p["breakaway"] - 1.0) * np.exp(-((v / p["stribeck"]) ** 2)))
        dry = dry + np.where(v > 0.0, p["forward"], p["backward"]) + p["loss"] * np.abs(drive)
        moved = np.abs(v)
        out = drive + p["force"] - dry * np.tanh(v / p["rise"])
        out -= p["damping"] * np.sign(v) * moved ** p["exponent"] + p["quadratic"] * moved * v
        out -= p["stiffness"] * q
        out += p["teeth"] * np.sin(2.0 * math.pi * q / p["teeth_period"] + p["teeth_phase"])
        out += p["ripple"] * np.sin(2.0 * math.pi * q / p["ripple_period"] + p["ripple_phase"])
        return _accelerations(rig, p, q, v, out)

    for k in range(samples):
        measured = p["scale"] * q + p["offset"]
        fine = measured + 0.02 * p["noise"] * rng.standard_normal((n, count))
        if rig.servo:
            command = goals[k].copy()
        else:
            speed += 0.2 * ((fine - last) / _PERIOD - speed) if k else 0.0
            ahead = (goals[k + 1] - goals[k]) / _PERIOD
            command = kp * (goals[k] - fine) + kd * (ahead - speed)
            command = np.clip(command, -limits, limits)
        last = fine
        noisy = measured + p["noise"] * rng.standard_normal((n, count))
        taken_q[k] = p["counts"] * np.round(noisy / p["counts"])
        taken_u[k] = command
        for _ in range(_SUBSTEPS):
            commands[step % depth] = command
            arrived = commands[(step - late) % depth, *rows] if step >= depth else command
            beyond = np.abs(arrived) - p["dead"]
            if rig.servo:
                error = arrived - q
                beyond = np.abs(error) - p["dead"]
                arrived = q + np.sign(error) * np.maximum(beyond, 0.0)
            else:
                arrived = np.sign(arrived) * np.maximum(beyond, 0.0)
            act = act + (1.0 - np.exp(-h / p["lag"])) * (arrived - act)
            a1 = rates(q, v, act)
            v2 = v + 0.5 * h * a1
            a2 = rates(q + 0.5 * h * v, v2, act)
            v3 = v + 0.5 * h * a2
            a3 = rates(q + 0.5 * h * v2, v3, act)
            v4 = v + h * a3
            a4 = rates(q + h * v3, v4, act)
            q = q + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            step += 1
    time = _PERIOD * np.arange(samples)
    found = []
    for i in range(len(machines)):
        one = {}
        for k, kind in enumerate(KINDS):
            run = i * kinds + k
            columns = {f"{name}_position": taken_q[:, j, run] for j, name in enumerate(rig.joints)}
            columns |= {f"{name}_command": taken_u[:, j, run] for j, name in enumerate(rig.drives)}
            one[kind] = Recording(time=time, columns=columns)
        found.append(one)
    return found


def _accelerations(
    rig: RoughRig, p: Values, q: np.ndarray, v: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Of links that hang down at zero; the second angle is between the links."""
    if len(rig.joints) == 1:
        mass = p["inertia"][0] + p["mass"][0] * p["centre"][0] ** 2 + p["armature"][0]
        pull = p["mass"][0] * p["centre"][0] + p["payload"][0] * p["payload_at"][0]
        mass = mass + p["payload"][0] * p["payload_at"][0] ** 2
        return (force - pull * _GRAVITY * np.sin(q + p["tilt"])) / mass
    upper = rig.length
    m11 = p["armature"][0] + p["inertia"][0] + p["mass"][0] * p["centre"][0] ** 2
    m22, m12 = p["armature"][1], 0.0
    first = q[0] + p["tilt"][0]
    g1 = p["mass"][0] * _GRAVITY * p["centre"][0] * np.sin(first)
    g2, b1, b2 = 0.0, 0.0, 0.0
    s, c, both = np.sin(q[1]), np.cos(q[1]), np.sin(first + q[1])
    outer = (p["mass"][1], p["centre"][1], p["inertia"][1])
    for mass, at, own in (outer, (p["payload"][1], p["payload_at"][1], 0.0)):
        m11 = m11 + own + mass * (upper**2 + at**2 + 2.0 * upper * at * c)
        m12 = m12 + own + mass * (at**2 + upper * at * c)
        m22 = m22 + own + mass * at**2
        turn = mass * upper * at * s
        b1 = b1 - turn * (2.0 * v[0] * v[1] + v[1] ** 2)
        b2 = b2 + turn * v[0] ** 2
        g1 = g1 + mass * _GRAVITY * (upper * np.sin(first) + at * both)
        g2 = g2 + mass * _GRAVITY * at * both
    f1, f2 = force[0] - b1 - g1, force[1] - b2 - g2
    det = m11 * m22 - m12 * m12
    return np.stack([(m22 * f1 - m12 * f2) / det, (m11 * f2 - m12 * f1) / det])
