"""Structure of the learned map from motion to each joint's flow, linear in its parameters."""

from dataclasses import replace

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

# Units of acceleration [rad/s^2] and jerk [rad/s^3] of the map's inputs: about the largest values
# in the walking stride of `leglab.references`, whose knee reaches 63 rad/s^2.
ACCELERATION, JERK = 50.0, 2000.0

# Prior standard deviations of the parameters by group of inputs; the splines' parameters have 1.
# Chosen on the walking leg and the squat on the ground with worn seals and valves, external
# leakage, hot oil and tired springs; factors of two change the errors by some 10 %. The prior of
# products is wide, because products are small in slow motion (1 % in the squat). In the squat with
# friction, 2 gives 1.5 times, 5 gives 1.2 times the offline fit's error; 20 bursts at worn valves.
_PRIOR = {"a": 1.0, "q": 0.3, "v": 1.0, "j": 1.0, "product": 5.0}

# Inputs for the flows of leak paths at measured pressures (`csrc/feedforward/pressure_valve.h`):
# from the cap side to the rod side, from the cap side outwards, from the rod side outwards.
LEAKS = ("leak", "leak_a", "leak_b")

# Knots of the velocity splines are dense within this share of full speed around standstill, where
# valve overlap and friction bend the map.
_DENSE = 0.05


class InverseMap:
    """Structure of the map from the motion of all joints to each joint's flow less its speed.

    For joint i, with every signal scaled to about one, the map is

        s(v_i) + p(q_i) + j_i + v_i q_i + sum_k (a_k + q_k + v_k + |v_i| a_k + |v_i| q_k),

    each term with its own parameter. The spline s represents valve overlap and friction, the spline
    p a joint spring. The terms a_k, q_k, v_k represent the load, which causes leakage flow, j its
    rate of change (compression flow), and the products its effect on the valve's pressure.

    Args:
        joints: Number of joints.
        rls: Settings of the recursive least squares.
        velocity_splines: Number of splines in s; 0 for a linear map: v_i, a constant, no products.
        position_splines: Number of splines in p; 0 for a term linear in q_i.
        leaks: Prior standard deviation of the parameters of leak paths, whose flows at measured
            pressures are three more inputs; 0 without measured pressures.
        least_memory: Fewest samples per parameter that forgetting keeps; sets the forgetting factor
            of `rls` to 1 - 1 / (least_memory * parameters). None keeps the factor of `rls`.
    """

    def __init__(
        self,
        joints: int,
        rls: Rls,
        *,
        velocity_splines: int,
        position_splines: int,
        leaks: float = 0.0,
        least_memory: float | None = None,
    ) -> None:
        self.joints = joints
        self.products = velocity_splines > 0
        self.settings = _structure(joints, rls, velocity_splines, position_splines, leaks)
        if least_memory is not None:
            parameters = self.learner().parameters.shape[-1]
            factor = 1.0 - 1.0 / (least_memory * parameters)
            self.settings = replace(self.settings, rls=replace(rls, forgetting_factor=factor))

    def learner(self) -> SplineNarx:
        """Returns a new learner of this structure."""
        return SplineNarx(self.settings, joints=self.joints)


def _structure(
    joints: int, rls: Rls, velocity_splines: int, position_splines: int, leaks: float
) -> SplineNarxSettings:
    """Builds the learner's settings; inputs in the order of `csrc/feedforward/inverse_map.h`."""
    products = velocity_splines > 0
    inputs = [Signal(name="v")]

    def add(name: str, group: str) -> None:
        limit = 1 / _PRIOR[group]
        inputs.append(Signal(name=name, lower=-limit, upper=limit))

    add("j", "j")
    if products:
        add("vq", "product")
    for other in range(joints):
        number = other or ""
        add(f"a{number}", "a")
        add(f"q{number}", "q")
        if other:
            add(f"v{number}", "v")
        if products:
            add(f"|v|a{number}", "product")
            add(f"|v|q{number}", "product")
    if leaks:
        inputs += [Signal(name=path, lower=-1 / leaks, upper=1 / leaks) for path in LEAKS]
    basis = Basis.asinh(-1, 1, max(velocity_splines, 3), width=_DENSE)
    features: list = [Spline(signal="v", lag=0, basis=basis)]
    if not products:
        features = [Lags(signal="v", first=0), Constant()]
    linear = [signal.name for signal in inputs[1:]]
    if position_splines:
        shape = Basis.uniform(-1, 1, position_splines, outside="linear")
        features.append(Spline(signal="q", lag=0, basis=shape))
        linear.remove("q")
    features += [Lags(signal=name, first=0) for name in linear]
    return SplineNarxSettings(
        output=Signal(name="flow"),
        inputs=tuple(inputs),
        features=tuple(features),
        rls=rls,
        # No range check with leaks, whose wide prior makes the range so narrow that they exceed it.
        plausible_range=0.0 if leaks else 5.0,
    )
