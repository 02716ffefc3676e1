"""Reference trajectories: joints, samples and checks, and the registry of their builders."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from leglab.base.errors import SettingsError, plugged_in
from leglab.base.registry import FactoryRegistry
from leglab.base.settings import Configuration


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A joint that follows a reference."""

    name: str  #: Name in the model
    rest: float = 0.0  #: Position in the rest pose [rad], where every trajectory starts
    lower: float = -math.inf  #: Smallest position [rad]
    upper: float = math.inf  #: Largest position [rad]
    velocity_limit: float = math.inf  #: Largest speed that the joint's cylinder allows [rad/s]

    def __post_init__(self) -> None:
        if not self.lower <= self.rest <= self.upper:
            text = f"joint {self.name!r}: rest position {self.rest:g} rad is outside "
            allowed = f"[{self.lower:g}, {self.upper:g}] rad"
            raise SettingsError(text, given=self.rest, allowed=allowed)
        if not self.velocity_limit > 0:
            text = f"joint {self.name!r}: velocity limit {self.velocity_limit:g} rad/s is not "
            raise SettingsError(text, given=self.velocity_limit, allowed="> 0")


class Samples(NamedTuple):
    """A sampled trajectory. Each of shape (n, joints): [rad], [rad/s], [rad/s^2]."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


# Evaluates a trajectory at times [s] of shape (n,).
Motion = Callable[[np.ndarray], Samples]


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A trajectory of some joints."""

    name: str  #: Name in the registry
    joints: tuple[Joint, ...]  #: The joints, in the order of the samples' columns
    #: Period of the motion [s], or its slowest period if it does not repeat: the window over which
    #: a tracking error is averaged.
    period: float
    motion: Motion  #: Evaluates the trajectory, without checks

    def sample(self, times: np.ndarray) -> Samples:
        """Evaluates the trajectory.

        Args:
            times: Times [s]; up to 0 the joints are at rest. Shape (n,).

        Returns:
            Position, velocity and acceleration.

        Raises:
            SettingsError: A joint would leave its range or exceed its velocity limit; names the
                joint, the time, the value and the limit.
        """
        times = np.asarray(times, dtype=np.float64)
        if times.ndim != 1:
            text = f"times of a reference have shape {times.shape}, allowed is "
            raise SettingsError(text, given=times.shape, allowed="(n,)")
        with plugged_in(f"reference {self.name!r}", self.motion):
            samples = Samples(*self.motion(times))
        self._check_form(times, samples)
        self._check(times, samples)
        return samples

    def check_velocity(self) -> None:
        """Tests that the velocity is the derivative of the position, as feed-forward requires.

        Raises:
            SettingsError: A joint's velocity is not the derivative; the message names the joint.
        """
        times = np.linspace(0.0, 2.0 * self.period, _TRIED)
        with plugged_in(f"reference {self.name!r}", self.motion):
            before, now, after = (self.motion(times + shift) for shift in (-_NEAR, 0.0, _NEAR))
        moves = (after.position - before.position) / (2.0 * _NEAR)
        slack = _SLACK * np.abs(now.velocity).max(axis=0, initial=_SLOW)
        wrong = np.mean(np.abs(moves - now.velocity) > slack, axis=0)  # a step may jump
        for joint, share in zip(self.joints, wrong, strict=True):
            if share > _SLACK:
                raise SettingsError(
                    f"reference {self.name!r}: the velocity of joint {joint.name!r} is not the "
                    f"derivative of its position at {share:.0%} of {_TRIED} times"
                )

    def _check_form(self, times: np.ndarray, samples: Samples) -> None:
        wanted = (times.size, len(self.joints))
        for name, values in zip(Samples._fields, samples, strict=True):
            if np.shape(values) != wanted:
                text = f"reference {self.name!r}: {name} has shape {np.shape(values)}, allowed is "
                raise SettingsError(text, given=np.shape(values), allowed=f"{wanted}")
            bad = np.argwhere(~np.isfinite(values))
            if bad.size:
                row, column = bad[0]
                raise SettingsError(
                    f"reference {self.name!r}: {name} of joint {self.joints[column].name!r} is "
                    f"{values[row, column]:g} at {times[row]:.4g} s"
                )

    def _check(self, times: np.ndarray, samples: Samples) -> None:
        lower = np.array([joint.lower for joint in self.joints])
        upper = np.array([joint.upper for joint in self.joints])
        speed = np.array([joint.velocity_limit for joint in self.joints])
        position, velocity = samples.position, samples.velocity
        for values, bad, verb, unit in (
            (position, (position < lower) | (position > upper), "goes to", "rad"),
            (velocity, np.abs(velocity) > speed, "moves at", "rad/s"),
        ):
            if bad.any():
                row, column = np.argwhere(bad)[0]
                joint, value = self.joints[column], float(values[row, column])
                limits = {
                    "rad": f"its range is [{joint.lower:g}, {joint.upper:g}] rad",
                    "rad/s": f"its limit is {joint.velocity_limit:g} rad/s",
                }
                where = f"reference {self.name!r}: joint {joint.name!r}"
                text = f"{where} {verb} {value:.4g} {unit} at {times[row]:.4g} s, "
                raise SettingsError(text, given=value, allowed=limits[unit])


# Test of velocities by central differences: number of times; half step [s]; tolerance as a share of
# the joint's peak speed, and maximum share of times at which it may be exceeded; least peak speed
# that the tolerance refers to [rad/s].
_TRIED, _NEAR, _SLACK, _SLOW = 100, 1e-5, 0.1, 1e-3

# Builds the motion of joints from settings; returns the motion and its period [s].
Builder = Callable[[tuple[Joint, ...], Any], tuple[Motion, float]]


REFERENCES: FactoryRegistry[Builder] = FactoryRegistry("reference")


def register_reference(
    name: str, *, summary: str, configuration: type[Configuration] = Configuration
) -> Callable[[Builder], Builder]:
    """Registers the decorated builder under a name.

    Args:
        name: Name of the reference.
        summary: One line for listings.
        configuration: Class of the builder's settings, all with a default.
    """
    return REFERENCES.register(name, summary=summary, configuration=configuration)


def make_reference(
    name: str,
    joints: Sequence[Joint],
    config: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
) -> Reference:
    """Makes a reference trajectory.

    Args:
        name: One of `reference_names()`.
        joints: Joints that follow the trajectory; those that it does not move stay at rest.
        config: Settings of this trajectory.
        seed: Seed of a random trajectory, unless `config` has one.

    Raises:
        SettingsError: The name or a setting is not known or not allowed, or no joint moves.
    """
    seeded = {} if seed is None else {"seed": seed}
    build, settings = REFERENCES.configured(name, config, **seeded)
    if not joints:
        raise SettingsError(f"reference {name!r} needs at least one joint")
    with plugged_in(f"reference {name!r}", build):
        motion, period = build(tuple(joints), settings)
    made = Reference(name=name, joints=tuple(joints), period=period, motion=motion)
    made.sample(np.zeros(2))
    made.check_velocity()
    return made


def reference_names() -> tuple[str, ...]:
    """Returns the names of all reference trajectories."""
    return REFERENCES.names()


# Flexion of hip and ankle as a share of the knee's. Thigh and shank are about equally long, so the
# hip stays above the ankle, and the foot flat, when each flexes half as much as the knee.
BEND_SHARE = {"hip_pitch": 0.5, "knee": 1.0, "ankle_pitch": 0.5}


def rest_pose(joints: Sequence[Joint]) -> np.ndarray:
    """Returns the rest positions [rad]. Shape (joints,)."""
    return np.array([joint.rest for joint in joints])


def moving_joints(joints: Sequence[Joint], known: Sequence[str], name: str) -> list[int]:
    """Returns the indices of the joints whose names are in `known`.

    Raises:
        SettingsError: No joint's name is in `known`.
    """
    indices = [i for i, joint in enumerate(joints) if joint.name in known]
    if not indices:
        text = f"reference {name!r} moves {', '.join(known)}, none of which is among the joints "
        raise SettingsError(text, given=tuple(known), allowed=(joint.name for joint in joints))
    return indices


def selected(joints: Sequence[Joint], names: Sequence[str] | None, reference: str) -> np.ndarray:
    """Returns 1 for joints that an excitation moves and 0 for the others.

    Args:
        joints: All joints.
        names: Names of the joints that move; None stands for all.
        reference: The trajectory's name, for the message.

    Returns:
        Shape (joints,).

    Raises:
        SettingsError: A name is not among the joints.
    """
    known = [joint.name for joint in joints]
    if names is None:
        return np.ones(len(known))
    for name in names:
        if name not in known:
            raise SettingsError.unknown(f"joint of reference {reference!r}", name, known)
    return np.array([float(name in names) for name in known])
