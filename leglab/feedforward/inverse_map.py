"""The map from motion to valve command of every joint, linear in what it learns."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from leglab.identification import (
    Basis,
    Constant,
    Lags,
    Rls,
    Signal,
    Spline,
    SplineNarx,
    SplineNarxSettings,
)

# Full scale of accelerations [rad/s^2] and jerks [rad/s^3], of the order of the walking stride's
# in `leglab.references`, whose knee reaches 63 rad/s^2.
_ACCELERATION, _JERK = 50.0, 2000.0

# Prior deviation of the parameters of a group of terms against those of the splines. The best of
# 38 random settings on the walking leg came near; others did about as well.
_PRIOR = {"a": 0.5, "q": 0.3, "v": 1.0, "j": 1.0, "product": 2.0}

# Knots of the velocity splines are dense within this share of full speed around standstill, where
# valve overlap and friction bend the map.
_DENSE = 0.05

StaticMap = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class MotionRange:
    """Declared ranges from which signals are scaled, one value a joint.

    Attributes:
        lower: Smallest positions [rad], (joints,).
        upper: Largest positions [rad], (joints,).
        speed: Speeds of full scale [rad/s], (joints,).
    """

    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray


class InverseMap:
    """Structure of the map: valve commands of all joints from the motion of all joints.

    For joint i, with every signal scaled to about one, the command is

        s(v_i) + p(q_i) + j_i + v_i q_i + |v_i| a_i + |v_i| q_i + sum_k (a_k + q_k + v_k),

    each term with a parameter of its own. The spline s carries valve overlap and friction, p a
    joint spring, the sum load (inertia, gravity, hence leakage flow) and its rate of change (hence
    compression flow), the products lever geometry and the pressure drop that the load leaves at
    the valve.

    Args:
        ranges: Declared ranges.
        rls: How it is learned.
        velocity_splines: Splines in s; 0 for a linear map: v_i and a constant, no products.
        position_splines: Splines in p; 0 for a term linear in q_i.
    """

    def __init__(
        self, ranges: MotionRange, rls: Rls, *, velocity_splines: int, position_splines: int
    ) -> None:
        self.joints = joints = len(ranges.speed)
        self.ranges = ranges
        half = (ranges.upper - ranges.lower) / 2
        ones = np.ones(joints)
        self._scale = np.stack([1 / half, 1 / ranges.speed, ones / _ACCELERATION, ones / _JERK])
        self._offset = np.zeros((4, joints))
        self._offset[0] = (ranges.lower + ranges.upper) / 2 / half
        self._signals = np.empty((7, joints))  # rows: q, v, a, j, v q, |v| q, |v| a
        self._speed = np.empty(joints)
        self.settings, self._index = _structure(joints, rls, velocity_splines, position_splines)
        if joints == 1:
            self._index = self._index[0]

    def inputs(self, motion: np.ndarray) -> np.ndarray:
        """Inputs of the learner, (joints, inputs), or (inputs,) of one joint.

        Args:
            motion: Position [rad] and its three derivatives, (4, joints).
        """
        signals = self._signals
        scaled = signals[:4]
        np.multiply(motion, self._scale, out=scaled)
        scaled -= self._offset
        speed = np.abs(scaled[1], out=self._speed)
        np.multiply(scaled[1], scaled[0], out=signals[4])
        np.multiply(speed, scaled[0:3:2], out=signals[5:])
        return signals.take(self._index)

    def learner(self) -> SplineNarx:
        """Returns a new learner of this structure."""
        return SplineNarx(self.settings, joints=self.joints)

    def fitted_to(self, static_map: StaticMap, pose: np.ndarray) -> np.ndarray:
        """Parameters with which the map is a bench calibration, by least squares.

        Args:
            static_map: Commands (joints,) at positions [rad] and velocities [rad/s].
            pose: Positions [rad] around which to compare, (joints,).
        """
        rng = np.random.default_rng(0)
        ranges, samples = self.ranges, 1500
        shape = (samples, self.joints)
        spread = (ranges.upper - ranges.lower) / 4
        motion = np.stack(
            [
                (pose + spread * rng.normal(size=shape)).clip(ranges.lower, ranges.upper),
                ranges.speed * rng.uniform(-1, 1, shape) ** 3,  # mostly slow, as motion is
                # Nothing to the steady map: as noise their parameters come out zero.
                _ACCELERATION * rng.uniform(-1, 1, shape),
                _JERK * rng.uniform(-1, 1, shape),
            ],
            axis=1,
        )
        settings = replace(self.settings, rls=Rls(initial_gain=1e6), plausible_range=0.0)
        learner = SplineNarx(settings, joints=self.joints)
        u = np.stack([self.inputs(sample) for sample in motion])
        y = np.stack([static_map(sample[0], sample[1]) for sample in motion])
        learner.run(u, y if self.joints > 1 else y[:, 0])
        return learner.parameters


def _structure(
    joints: int, rls: Rls, velocity_splines: int, position_splines: int
) -> tuple[SplineNarxSettings, np.ndarray]:
    """The learner's settings, and where its inputs stand among the signals, (joints, inputs)."""
    inputs = [Signal(name="v")]
    rows = [[joints + i] for i in range(joints)]

    def add(name: str, group: str, row: int, other: int) -> None:
        limit = 1 / _PRIOR[group]
        inputs.append(Signal(name=f"{name}{other or ''}", lower=-limit, upper=limit))
        for i, places in enumerate(rows):
            places.append(row * joints + (i + other) % joints)

    add("j", "j", 3, 0)
    if velocity_splines:
        for name, row in (("vq", 4), ("|v|q", 5), ("|v|a", 6)):
            add(name, "product", row, 0)
    for other in range(joints):
        add("a", "a", 2, other)
        add("q", "q", 0, other)
        if other:
            add("v", "v", 1, other)
    basis = Basis.asinh(-1, 1, max(velocity_splines, 3), width=_DENSE)
    features: list = [Spline(signal="v", lag=0, basis=basis)]
    if not velocity_splines:
        features = [Lags(signal="v", first=0), Constant()]
    linear = [signal.name for signal in inputs[1:]]
    if position_splines:
        shape = Basis.uniform(-1, 1, position_splines, outside="linear")
        features.append(Spline(signal="q", lag=0, basis=shape))
        linear.remove("q")
    features += [Lags(signal=name, first=0) for name in linear]
    settings = SplineNarxSettings(
        output=Signal(name="command"), inputs=tuple(inputs), features=tuple(features), rls=rls
    )
    return settings, np.array(rows)
