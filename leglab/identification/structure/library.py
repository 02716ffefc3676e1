"""Library of candidate features for models, built from lagged signals."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from leglab.identification.basis import Basis
from leglab.identification.features import Constant, Feature, Lags, Spline, Term
from leglab.identification.spline_state_space import Curve, SplineStateSpace, StateSpace
from leglab.identification.structure.fit import Array, Fit, Model, Problem
from leglab.identification.structure.states import variances

HINGES = (0.05, 0.2, 0.4, 0.6, 0.8, 0.95)  # quantiles of a signal for the kinks of hinge functions
SPLINES, FINE = 8, 16  # number of splines of a usual curve and of a fine curve
_SPLINE_RANGE = (0.005, 0.995)  # quantiles of a signal for the first and last knot of a curve
# Widths of smooth signs, in deviations of the signal: from nearly a jump to those of valves.
WIDTHS = (0.01, 0.1, 0.5)


@dataclass(frozen=True)
class Orders:
    """Orders of a model: which lags of its signals it uses.

    Attributes:
        outputs: Number of lags of the output y, which are 1 ... outputs.
        inputs: Number of lags of each input.
        delays: First lag of each input [samples].
    """

    outputs: int
    inputs: int
    delays: tuple[int, ...]

    def lags(self, problem: Problem) -> Iterator[tuple[str, int]]:
        """Yields (signal name, lag) for all lags of the output, then of the inputs."""
        template = problem.template
        for k in range(1, self.outputs + 1):
            yield template.output.name, k
        for signal, delay in zip(template.inputs, self.delays, strict=True):
            for k in range(delay, delay + self.inputs):
                yield signal.name, k

    def linear(self, problem: Problem) -> tuple[Feature, ...]:
        """Returns the features of the linear model: all lags and a constant."""
        template = problem.template
        parts: list[Feature] = []
        if self.outputs:
            parts.append(Lags(signal=template.output.name, first=1, count=self.outputs))
        if self.inputs:
            inputs = zip(template.inputs, self.delays, strict=True)
            parts += [Lags(signal=s.name, first=d, count=self.inputs) for s, d in inputs]
        return (*parts, Constant())


def terms(problem: Problem, orders: Orders) -> list[Feature]:
    """Returns products, cubes and hinges of all lags, and signs of signals and of changes."""
    lags = list(orders.lags(problem))
    out: list[Feature] = []
    for i, (name, lag) in enumerate(lags):
        out.extend(Term(signal=name, lag=lag, times=other) for other in lags[i:])
        out.append(Term(signal=name, lag=lag, degree=3))
        places = np.unique(np.quantile(problem.samples[name], HINGES))
        out.extend(Term(signal=name, lag=lag, curve="hinge", at=float(at)) for at in places)
    firsts = dict(reversed(lags))
    for name, lag in firsts.items():
        signs = list(_signs(name, lag, problem.samples[name]))
        out.extend(signs)
        others = [other for other in firsts.items() if other[0] != name]
        out.extend(replace(sign, times=other) for sign in signs for other in others)
    return out


def _signs(name: str, lag: int, values: np.ndarray) -> Iterator[Term]:
    for change, spread in ((True, np.diff(values)), (False, values)):
        if spread.size and spread.min() < 0 < spread.max():
            for share in WIDTHS:
                width = share * float(np.std(spread))
                yield Term(signal=name, lag=lag, curve="sign", width=width, change=change)


def curves(problem: Problem, orders: Orders, splines: int = SPLINES) -> list[Feature]:
    """Returns one spline curve per lag, as a function of the lagged signal."""
    out: list[Feature] = []
    for name, lag in orders.lags(problem):
        low, high = map(float, np.quantile(problem.samples[name], _SPLINE_RANGE))
        if high > low:
            basis = Basis.uniform(low, high, splines, outside="linear")
            out.append(Spline(signal=name, lag=lag, basis=basis))
    return out


_SMALL = 0.01  # share of a variance below which a contribution counts as negligible
# Libraries that are tried first, and refined libraries that are tried if `curves` is the best.
Maker = Callable[[Problem, Orders], list[Feature]]
KINDS: dict[str, Maker] = {"terms": terms, "curves": curves}
REFINED: dict[str, Maker] = {"fine curves": partial(curves, splines=FINE)}


def kind_of(problem: Problem, fit: Fit) -> str:
    """Names the model class in the literature's terms."""
    first = fit.features[0]
    if isinstance(first, StateSpace):
        return _state_space(first, first.parts(fit.theta).curves, variances(problem, fit))
    features = problem.lagged(fit.features).features
    output = problem.template.output.name
    bent = [f for f in features if isinstance(f, Term | Spline)]
    if all(isinstance(f, Constant) for f in features):
        return "a constant: no model was better"
    if not bent:
        return "linear"
    signals = {f.signal for f in bent} | {f.times[0] for f in bent if f.times is not None}
    if output not in signals:
        single = all(f.times is None for f in bent)
        return "Hammerstein: curves of the inputs" if single else "Hammerstein: functions of inputs"
    return "nonlinear in the output's lags as well (NARX)"


def _state_space(structure: StateSpace, curves: Sequence[Curve], spread: Array) -> str:
    linear = f"linear state space of order {structure.states}"
    if not curves:
        return linear
    many = "a static curve" if len(curves) == 1 else f"{len(curves)} static curves"
    n = structure.states
    heights = np.array([np.ptp(c.e) for c in curves])
    # Variance by signal in arguments of curves, and squared weights of curves in states and output.
    into = heights @ np.array([c.v**2 * spread for c in curves])
    out = heights @ np.array([np.append(c.w, c.o) ** 2 for c in curves])
    if into[:n].sum() < _SMALL * into.sum():
        return f"Hammerstein: {many} of inputs before a {linear}"
    if out[:n].sum() < _SMALL * out.sum():
        return f"Wiener: {many} behind a {linear}"
    return f"{linear} in feedback with {many} of states and inputs (nonlinear LFR)"


def name_of(feature: Feature) -> str:
    """Returns the formula of a feature."""
    if isinstance(feature, Constant):
        return "1"
    if isinstance(feature, Spline):
        return f"curve of {_lagged(feature.signal, feature.lag)}"
    if isinstance(feature, Term):
        return _term(feature)
    first = _lagged(feature.signal, feature.first)
    last = feature.first + feature.count - 1
    return first if feature.count == 1 else f"{first} ... {_lagged(feature.signal, last)}"


def _lagged(signal: str, lag: int) -> str:
    return f"{signal}(t-{lag})" if lag else f"{signal}(t)"


def _term(term: Term) -> str:
    x = _lagged(term.signal, term.lag)
    if term.change:
        x = f"{x} - {_lagged(term.signal, term.lag + 1)}"
    if term.curve == "hinge":
        sign = "-" if term.at >= 0 else "+"
        g = f"max({x} {sign} {abs(term.at):.3g}, 0)"
    elif term.curve == "sign":
        g = f"sign({x}; width {term.width:.3g})"
    else:
        g = x if term.degree == 1 else f"{x}^{term.degree}"
    if term.curve == "power" and term.times == (term.signal, term.lag) and not term.change:
        return f"{x}^{term.degree + 1}"
    return g if term.times is None else f"{g} {_lagged(*term.times)}"


def named_parameters(model: Model) -> Iterator[tuple[str, list[str], Array]]:
    """Yields each feature's name, the names of its parameters, and their values in scaled units.

    A state-space model yields its matrices, row by row, and its curves in place of features.
    """
    if isinstance(model, SplineStateSpace):
        yield from _matrices(model)
        return
    for feature, (_, theta, _) in zip(model.settings.features, model.learned_blocks(), strict=True):
        yield name_of(feature), _parameters(feature, len(theta)), theta


def _matrices(model: SplineStateSpace) -> Iterator[tuple[str, list[str], Array]]:
    parts = model.parts()
    inputs = [_lagged(s.name, d) for s, d in zip(
        model.settings.inputs, model.settings.structure.delays, strict=True
    )]  # fmt: skip
    states = [f"x{i + 1}" for i in range(len(parts.A))]
    for name, matrix, across in (("A", parts.A, states), ("B", parts.B, inputs)):
        names = [f"{row}(t+1) by {column}" for row in states for column in across]
        yield f"{name}: states by {'states' if name == 'A' else 'inputs'}", names, matrix.ravel()
    output = model.settings.output.name
    yield "C: output by states", [f"{output} by {x}" for x in states], parts.C
    yield "D: output by inputs", [f"{output} by {u}" for u in inputs], parts.D
    yield "d: constant of the output", ["d"], np.array([parts.d])
    for k, curve in enumerate(parts.curves, 1):
        of = [f"z{k} by {x}" for x in (*states, *inputs)]
        yield f"v{k}: argument z{k} of curve {k}", of, curve.v
        to = [f"{row} by curve {k}" for row in (*states, output)]
        yield f"w{k}, o{k}: what curve {k} adds to", to, np.append(curve.w, curve.o)
        names = [f"curve {k}, weight {i + 1}" for i in range(len(curve.e))]
        yield f"e{k}: curve {k}, weights of its splines", names, curve.e


def _parameters(feature: Feature, count: int) -> list[str]:
    if isinstance(feature, Lags):
        return [_lagged(feature.signal, feature.first + k) for k in range(count)]
    name = name_of(feature)
    return [name] if count == 1 else [f"{name}, weight {k + 1}" for k in range(count)]
