"""The deployed identifier: a NARX model of lags and splines of any signal, linear in parameters."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, get_args

from leglab._native import identification as native
from leglab.errors import LeglabError, unknown_name
from leglab.identification import checks
from leglab.identification.basis import Basis
from leglab.identification.features import (
    Block,
    Constant,
    Feature,
    Hammerstein,
    Lags,
    Signal,
    Spline,
)
from leglab.identification.front import Array, Identifier
from leglab.identification.settings import MAX_INPUTS, Guard, Rls, Scalar


@dataclass(frozen=True, kw_only=True)
class SplineNarxSettings:
    """Structure and constants of a `SplineNarx`.

    Attributes:
        output: The output and its declared range.
        inputs: Inputs in the order in which samples carry them.
        features: Blocks of the regressor; theta has their parameters in this order.
        rls: Recursive least squares; errors and gains are in scaled units.
        guard: Which samples are refused.
        output_error_after: Learned samples after which learning minimises the error of the
            model's own simulation (recursive prediction error method); 0 never.
        resynchronise_above: Simulation error, in units of the output, at which the simulation
            restarts from the measurements; that sample teaches nothing.
        pole_limit: Largest allowed radius of the poles of the lags of the output; they are moved
            inside after each update. 0 allows any.
        scalar: Arithmetic of the core.
    """

    output: Signal = field(default_factory=lambda: Signal(name="y"))
    inputs: tuple[Signal, ...] = field(default_factory=lambda: (Signal(name="u"),))
    features: tuple[Feature, ...]
    rls: Rls = field(default_factory=Rls.adaptive)
    guard: Guard = field(default_factory=Guard)
    output_error_after: int = 0
    resynchronise_above: float | None = None
    pole_limit: float = 0.0
    scalar: Scalar = "float64"

    def __post_init__(self) -> None:
        checks.whole("number of inputs", len(self.inputs), least=1, most=MAX_INPUTS)
        names = [self.output.name, *(signal.name for signal in self.inputs)]
        if len(set(names)) != len(names):
            raise LeglabError(f"signal names are {', '.join(names)}: must differ")
        if not self.features:
            raise LeglabError("features is empty: the model needs at least one")
        checks.whole("output_error_after", self.output_error_after, least=0)
        if self.resynchronise_above is None:
            object.__setattr__(self, "resynchronise_above", self.output.half_range / 2)
        checks.number("resynchronise_above", self.resynchronise_above, above=0.0)
        checks.number("pole_limit", self.pole_limit, least=0.0, most=1.0)
        checks.choice("scalar", self.scalar, get_args(Scalar))
        self.guard.check_inputs(len(self.inputs))
        for block in self.blocks:
            self._check(block)

    @classmethod
    def standard(
        cls,
        *,
        output: Signal,
        inputs: Iterable[Signal],
        na: int = 3,
        nb: int = 3,
        nk: int = 0,
        output_splines: int = 5,
        rls: Rls | None = None,
    ) -> "SplineNarxSettings":
        """Lags of y and of every input, a constant, and splines of y(t - 1) over its range."""
        inputs = tuple(inputs)
        features: list[Feature] = []
        if output_splines:
            basis = Basis.uniform(output.lower, output.upper, output_splines, outside="linear")
            features.append(Spline(signal=output.name, lag=1, basis=basis))
        if na:
            features.append(Lags(signal=output.name, first=1, count=na))
        features += [Lags(signal=signal.name, first=nk, count=nb) for signal in inputs]
        features.append(Constant())
        rls = Rls.adaptive() if rls is None else rls
        return cls(output=output, inputs=inputs, features=tuple(features), rls=rls)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Features as the core reads them."""
        return tuple(self._block(feature) for feature in self.features)

    @cached_property
    def lags(self) -> int:
        """Samples of history the regressor reaches back."""
        ends = [b.lag + (0 if b.feature == "spline" else b.lags - 1) for b in self.blocks]
        return max(1, *ends, *(b.factor_lag for b in self.blocks))

    def _index(self, name: str) -> int:
        names = [self.output.name, *(signal.name for signal in self.inputs)]
        if name not in names:
            raise unknown_name("signal", name, names)
        return names.index(name)

    def _block(self, feature: Feature) -> Block:
        if isinstance(feature, Constant):
            return Block("constant")
        index = self._index(feature.signal)
        if isinstance(feature, Lags):
            return Block("lags", index, feature.first, feature.count)
        signal = (self.output, *self.inputs)[index]
        knots = [(k - signal.centre) / signal.half_range for k in feature.basis.knots]
        basis = replace(feature.basis, knots=tuple(knots))
        if isinstance(feature, Hammerstein):
            mu = feature.learning_constant
            return Block("hammerstein", index, feature.first, feature.count, basis, -1, 0, mu)
        if feature.times is None:
            return Block("spline", index, feature.lag, 1, basis)
        factor, lag = feature.times
        return Block("spline", index, feature.lag, 1, basis, self._index(factor), lag)

    def _check(self, block: Block) -> None:
        least = 1 if block.signal == 0 and block.feature != "constant" else 0
        name = self.output.name
        if block.lag < least or (block.factor_signal == 0 and block.factor_lag < 1):
            raise LeglabError(
                f"a {block.feature} feature has lag 0 of the output {name!r}: must be at least 1"
            )
        if block.feature != "hammerstein" or block.basis is None:
            return
        if block.signal == 0:
            raise LeglabError(f"a hammerstein feature is of output {name!r}: must be of an input")
        if block.basis.kind != "full":
            raise LeglabError("a hammerstein feature has basis kind 'paper': must be 'full'")


class SplineNarx(Identifier):
    """The identifier for use on a machine; see `SplineNarxSettings`."""

    _banks: ClassVar = {"float64": native.SplineNarx64, "float32": native.SplineNarx32}
    settings: SplineNarxSettings

    @property
    def lags(self) -> int:
        """Samples of history the regressor reaches back."""
        return self.settings.lags

    @property
    def theta(self) -> Array:
        """Parameters of all features, in their order and in scaled units, (..., n)."""
        count = sum(block.count for block in self.settings.blocks)
        return self.parameters[..., :count]
