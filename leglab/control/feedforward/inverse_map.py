"""Structure of the learned map from motion to flow of every joint, linear in what it learns."""

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

# Full scale of accelerations [rad/s^2] and jerks [rad/s^3], of the order of the walking stride's
# in `leglab.references`, whose knee reaches 63 rad/s^2.
ACCELERATION, JERK = 50.0, 2000.0

# Prior deviation of the parameters of a group of terms against those of the splines. Chosen on the
# walking leg and the squat on the ground with worn seals and valves, external leakage, hot oil and
# tired springs; factors of two change the errors by some ten percent. Products are small in slow
# motion (a hundredth in the squat), so theirs is wide: with 2, friction left the squat at 1.5
# times the offline fit's error, with 5 at 1.2; with 20 worn valves burst on the ground.
_PRIOR = {"a": 1.0, "q": 0.3, "v": 1.0, "j": 1.0, "product": 5.0}

# Leak paths whose flows the pressures tell, as `csrc/feedforward/pressure_valve.h` has them: from
# the cap side to the rod side, and from either to the outside.
LEAKS = ("leak", "leak_a", "leak_b")

# Knots of the velocity splines are dense within this share of full speed around standstill, where
# valve overlap and friction bend the map.
_DENSE = 0.05


class InverseMap:
    """Structure of the map: flow into every joint, beyond its own speed, from the motion of all.

    For joint i, with every signal scaled to about one, it is

        s(v_i) + p(q_i) + j_i + v_i q_i + sum_k (a_k + q_k + v_k + |v_i| a_k + |v_i| q_k),

    each term with a parameter of its own. The spline s carries valve overlap and friction, p a
    joint spring, the sum load (inertia, gravity, hence leakage flow), j its rate of change
    (compression flow), the products the pressure drop that load leaves at the valve.

    Args:
        joints: How many.
        rls: How it is learned.
        velocity_splines: Splines in s; 0 for a linear map: v_i and a constant, no products.
        position_splines: Splines in p; 0 for a term linear in q_i.
        leaks: Prior deviation of the parameters of leak paths, whose flows at measured pressures
            are the last three inputs; 0 where there are no pressures.
        least_memory: Samples a parameter that forgetting always keeps: the forgetting factor of
            `rls`, then, is 1 - 1 / (least_memory * parameters). None leaves it as it is.
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
    """The learner's settings; inputs in the order of `csrc/feedforward/inverse_map.h`."""
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
        # A wide prior is a short range: leaks pass it without being wrong.
        plausible_range=0.0 if leaks else 5.0,
    )
