"""The deployed identifier: a NARX model of lags and splines of any signal, linear in parameters."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from leglab._native import identification as native
from leglab.base.errors import SettingsError
from leglab.identification import checks, linear
from leglab.identification.basis import Basis
from leglab.identification.checks import a_number, a_whole
from leglab.identification.features import (
    Constant,
    Curve,
    Feature,
    Hammerstein,
    Lags,
    Spline,
    Term,
)
from leglab.identification.front import Array, Identifier
from leglab.identification.settings import SignalSettings

if TYPE_CHECKING:
    import control
    from scipy.interpolate import BSpline


@dataclass(frozen=True)
class ParameterBlock:
    """A feature in the form that the C++ core takes: signals by index, knots scaled."""

    feature: str
    signal: int = 0
    lag: int = 0
    lags: int = 1
    basis: Basis | None = None
    factor_signal: int = -1
    factor_lag: int = 0
    learning_constant: float = 0.0
    curve: Curve = "power"
    degree: int = 1
    at: float = 0.0
    width: float = 1.0
    change: bool = False

    @property
    def count(self) -> int:
        """Number of parameters in theta."""
        return self.basis.count if self.feature == "spline" and self.basis else self.lags

    @property
    def weights(self) -> int:
        """Number of weights of a Hammerstein block; 0 for other features."""
        return self.basis.count if self.feature == "hammerstein" and self.basis else 0


@dataclass(frozen=True, kw_only=True)
class SplineNarxSettings(SignalSettings):
    """Structure and constants of a `SplineNarx`.

    Attributes:
        features: Blocks of the regressor; theta has their parameters in this order.
        output_error_after: Learned samples after which learning minimises the error of the
            model's own simulation (recursive prediction error method); 0: never.
        resynchronise_above: Simulation error, in units of the output, at which the simulation
            restarts from the measurements; this sample is learned by its one-step error. None
            takes a quarter of the output's range.
        pole_limit: Largest allowed radius of the poles of the output's lags; poles beyond are
            moved inside after each update. 0 allows any.
    """

    features: tuple[Feature, ...]
    output_error_after: int = a_whole(0, least=0)
    resynchronise_above: float | None = None
    pole_limit: float = a_number(0.0, least=0.0, most=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.features:
            text = "features is empty: the model needs "
            raise SettingsError(text, given=self.features, allowed="at least one")
        threshold = self.resynchronise_above
        threshold = self.output.half_range / 2 if threshold is None else threshold
        object.__setattr__(self, "resynchronise_above", threshold)
        checks.number("resynchronise_above", threshold, above=0.0)
        for block in self.blocks:
            self._check(block)
        self.check_count(sum(block.count + block.weights for block in self.blocks))

    @cached_property
    def blocks(self) -> tuple[ParameterBlock, ...]:
        """Features in the form that the C++ core takes."""
        return tuple(self._block(feature) for feature in self.features)

    @cached_property
    def lags(self) -> int:
        """Samples of history the regressor reaches back."""
        return max(1, *(max(b.lag + b.lags - 1 + b.change, b.factor_lag) for b in self.blocks))

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise SettingsError.unknown("signal", name, self.names)
        return self.names.index(name)

    def _block(self, feature: Feature) -> ParameterBlock:
        if isinstance(feature, Constant):
            return ParameterBlock("constant")
        index = self._index(feature.signal)
        if isinstance(feature, Lags):
            return ParameterBlock("lags", index, feature.first, feature.count)
        signal = self.signals[index]
        if isinstance(feature, Term):
            centre = 0.0 if feature.change else signal.centre
            name, lag = feature.times or (None, 0)
            return ParameterBlock(
                "term",
                index,
                feature.lag,
                factor_signal=-1 if name is None else self._index(name),
                factor_lag=lag,
                curve=feature.curve,
                degree=feature.degree,
                at=(feature.at - centre) / signal.half_range,
                width=feature.width / signal.half_range,
                change=feature.change,
            )
        knots = [(k - signal.centre) / signal.half_range for k in feature.basis.knots]
        basis = replace(feature.basis, knots=tuple(knots))
        if isinstance(feature, Hammerstein):
            own = feature.first, feature.count, basis
            return ParameterBlock(
                "hammerstein", index, *own, learning_constant=feature.learning_constant
            )
        if feature.times is None:
            return ParameterBlock("spline", index, feature.lag, 1, basis)
        factor, lag = feature.times
        return ParameterBlock("spline", index, feature.lag, 1, basis, self._index(factor), lag)

    def _check(self, block: ParameterBlock) -> None:
        least = 1 if block.signal == 0 and block.feature != "constant" else 0
        name = self.output.name
        if block.lag < least or (block.factor_signal == 0 and block.factor_lag < 1):
            text = f"a {block.feature} feature has lag 0 of the output {name!r}: must be "
            raise SettingsError(text, given=0, allowed="at least 1")
        if block.feature != "hammerstein" or block.basis is None:
            return
        if block.signal == 0:
            text = f"a hammerstein feature is of output {name!r}: must be "
            raise SettingsError(text, given=name, allowed="of an input")
        if block.basis.kind != "full":
            text = "a hammerstein feature has basis kind 'paper': must be 'full'"
            raise SettingsError(text, given=block.basis.kind, allowed=("full",))


class SplineNarx(Identifier):
    """The identifier for use on a machine; see `SplineNarxSettings`."""

    _banks: ClassVar = {"float64": native.SplineNarx64, "float32": native.SplineNarx32}
    settings: SplineNarxSettings

    @property
    def theta(self) -> Array:
        """Parameters of all features, in their order and in scaled units, (..., n)."""
        count = sum(block.count for block in self.settings.blocks)
        return self.parameters[..., :count]

    def linearise(self, joint: int = 0, at: Mapping[str, float] | None = None) -> Array:
        """Returns the gain of every lag of every signal, d y(t) / d x(t - k), in physical units.

        Args:
            joint: Index of the joint.
            at: Value of every signal at the operating point, by name. None takes only linear
                features and `Hammerstein` features, the latter with slope one.

        Returns:
            (1 + inputs, lags + 1); row 0 belongs to the output and begins with zero.

        Raises:
            SettingsError: A signal is missing in `at`, or unknown.
        """
        signals = self.settings.signals
        point = np.zeros(len(signals))
        if at is not None:
            for name in at:
                self.settings._index(name)
            for i, signal in enumerate(signals):
                if signal.name not in at:
                    text = f"operating point lacks signal {signal.name!r}"
                    raise SettingsError(text, given=tuple(at), allowed=self.settings.names)
                point[i] = (at[signal.name] - signal.centre) / signal.half_range
        gains = np.zeros((len(signals), self.lags + 1))
        for block, theta, weights in self.learned_blocks(joint):
            row, lags = gains[block.signal], slice(block.lag, block.lag + block.lags)
            if block.feature == "lags":
                row[lags] += theta
            elif block.feature == "hammerstein" and block.basis is not None:
                centre = point[block.signal]
                slope = 1.0 if at is None else _value(block.basis, weights, centre, 1)
                row[lags] += theta * slope
            elif block.feature == "spline" and block.basis is not None and at is not None:
                factor = 1.0 if block.factor_signal < 0 else point[block.factor_signal]
                row[block.lag] += _value(block.basis, theta, point[block.signal], 1) * factor
                if block.factor_signal >= 0:
                    value = _value(block.basis, theta, point[block.signal], 0)
                    gains[block.factor_signal, block.factor_lag] += value
            elif block.feature == "term":
                _add_term(gains, block, float(theta[0]), point if at is not None else None)
        scale = np.array([signal.half_range for signal in signals])
        return gains * (scale[0] / scale[:, None])

    def transfer_function(
        self,
        joint: int = 0,
        *,
        signal: str | None = None,
        at: Mapping[str, float] | None = None,
        timestep: float | bool = True,
    ) -> "control.TransferFunction":
        """Returns the transfer function from `signal` (None: input 1) to y; see `linearise`."""
        names = [s.name for s in self.settings.inputs]
        name = names[0] if signal is None else signal
        if name not in names:
            raise SettingsError.unknown("input", name, names)
        gains = self.linearise(joint, at)
        return linear.transfer_function(gains[0, 1:], gains[1 + names.index(name)], timestep)

    def poles(
        self, joint: int = 0, at: Mapping[str, float] | None = None
    ) -> NDArray[np.complex128]:
        """Returns the poles of the output's lags, complex; see `linearise` for `at`."""
        return linear.poles(np.trim_zeros(self.linearise(joint, at)[0, 1:], "b"))

    def static_spline(self, feature: int = 0, joint: int = 0) -> "BSpline":
        """Returns the static map of one feature as a SciPy spline in physical units.

        Args:
            feature: Index among the settings' features. The map of a `Spline` is its contribution
                to y; the map of a `Hammerstein` is its output n in units of its input.
            joint: Index of the joint.

        Raises:
            SettingsError: The feature has no spline.
        """
        chosen = self.settings.features[feature]
        if not isinstance(chosen, Spline | Hammerstein):
            text = f"feature {feature} is {type(chosen).__name__}: it has no spline"
            raise SettingsError(text, given=feature, allowed=("Spline", "Hammerstein"))
        block, theta, weights = list(self.learned_blocks(joint))[feature]
        if isinstance(chosen, Spline):
            return chosen.basis.spline(theta * self.settings.output.half_range)
        signal = self.settings.inputs[block.signal - 1]
        return chosen.basis.spline(weights * signal.half_range, signal.centre)

    def learned_blocks(self, joint: int = 0) -> Iterator[tuple[ParameterBlock, Array, Array]]:
        """Yields each feature's block, parameters and weights; only Hammerstein has weights."""
        theta = np.atleast_2d(self.theta)[joint]
        weights = np.atleast_2d(self.parameters)[joint, len(theta) :]
        for block in self.settings.blocks:
            own, theta = np.split(theta, [block.count])
            own_weights, weights = np.split(weights, [block.weights])
            yield block, own, own_weights


def _add_term(
    gains: Array, block: ParameterBlock, theta: float, point: NDArray[np.float64] | None
) -> None:
    """Adds the gains of a term at an operating point; if it is None, of a linear term only."""
    linear = block.curve == "power" and block.degree == 1 and block.factor_signal < 0
    if point is None and not linear:
        return
    x = 0.0 if point is None or block.change else point[block.signal]
    d = x - block.at
    if block.curve == "power":
        value, slope = x**block.degree, block.degree * x ** (block.degree - 1)
    elif block.curve == "hinge":
        value, slope = max(d, 0.0), float(d > 0)
    else:
        s = abs(d) / block.width
        share = 0.5 / (s * (s + 0.5) + 0.5)
        value, slope = np.copysign(1 - share, d), 2 * share**2 * (2 * s + 0.5) / block.width
    factor = 1.0 if block.factor_signal < 0 or point is None else point[block.factor_signal]
    gains[block.signal, block.lag] += theta * slope * factor
    if block.change:
        gains[block.signal, block.lag + 1] -= theta * slope * factor
    if block.factor_signal >= 0:
        gains[block.factor_signal, block.factor_lag] += theta * value


def _value(basis: Basis, weights: Array, at: float, derivative: int) -> float:
    inside = min(max(at, basis.knots[0]), basis.knots[-1])
    if inside != at and basis.outside == "clamp" and derivative:
        return 0.0
    spline = basis.spline(weights)
    if basis.outside == "quadratic" or inside == at:
        return float(spline(at, derivative))
    tangent = basis.outside == "linear" and not derivative
    return float(spline(inside, derivative)) + tangent * (at - inside) * float(spline(inside, 1))
