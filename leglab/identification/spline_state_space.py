"""State-space identifier: a linear state-space model in feedback with static curves."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from leglab._native import identification as native
from leglab._native.structure import StateRuns
from leglab.base.errors import SettingsError
from leglab.identification import checks
from leglab.identification.basis import Basis
from leglab.identification.checks import a_number, a_whole
from leglab.identification.front import Array, Identifier
from leglab.identification.settings import SignalSettings

if TYPE_CHECKING:
    import control

OBSERVED = 10  # measured samples, per state, from which a free run's initial state is estimated
# Simulation to rest: change of scaled states per round at which it ends, samples per round, rounds.
_RESTS, _ROUND, _ROUNDS = 1e-9, 1000, 100
REACH = 2.0  # bound of the scaled states in the C header, as in the core (state_space.h)


class Curve(NamedTuple):
    """A static curve f(z) = sum_i e_i N_i(z) of z = v' [x; u], in scaled units.

    Attributes:
        v: Weights of the states and inputs in z, (n + M,).
        w: Weights of f in the next states, (n,).
        o: Weight of f in the output.
        e: Weights of the splines, (K,).
    """

    v: Array
    w: Array
    o: float
    e: Array


class Parts(NamedTuple):
    """Parameters of a model in scaled units; see `StateSpace`.

    Attributes:
        A: (n, n).
        B: (n, M).
        C: (n,).
        D: (M,).
        d: Constant of the output.
        curves: The static curves.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    d: float
    curves: tuple[Curve, ...]


@dataclass(frozen=True, kw_only=True)
class StateSpace(checks.Settings):
    """Structure of a linear state-space model in feedback with static curves.

    x(t+1) = A x + B u + sum_c w_c f_c(z_c) and y(t) = C x + D u + d + sum_c o_c f_c(z_c), with
    z_c = v_c' [x; u]: a nonlinear linear-fractional representation (Schoukens and Toth 2020), of
    which Hammerstein, Wiener and Wiener-Hammerstein models and a linear system with nonlinear
    feedback are special cases. Signals are scaled to [-1, 1], inputs delayed by their delays.

    Attributes:
        states: Order n of the linear system.
        delays: Delay of each input [samples].
        curves: Number of static curves.
        splines: Number of splines of a curve, over [-1, 1] of z.
        noise: Variance of the output error in scaled units (half the output's range is 1), by
            which the predictor weighs a measurement.
    """

    owner: ClassVar = "state space"
    states: int = a_whole(2, least=1, most=20)
    delays: tuple[int, ...] = (0,)
    curves: int = a_whole(0, least=0, most=20)
    splines: int = a_whole(8, least=3, most=100)
    noise: float = a_number(1e-4, above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        for delay in self.delays:
            checks.whole("delay of an input", delay, least=0, most=1000)

    @cached_property
    def basis(self) -> Basis:
        """Spline basis of a curve."""
        return Basis.uniform(-1.0, 1.0, self.splines, outside="linear")

    @property
    def signals(self) -> int:
        """Number of states and inputs."""
        return self.states + len(self.delays)

    @property
    def linear(self) -> int:
        """Number of parameters of A, B, C, D and d."""
        return (self.states + 1) * self.signals + 1

    @property
    def curve(self) -> int:
        """Number of parameters of a curve."""
        return self.signals + self.states + 1 + self.splines

    @property
    def count(self) -> int:
        """Number of all parameters."""
        return self.linear + self.curves * self.curve

    @property
    def spline_weights(self) -> NDArray[np.int64]:
        """Indices of each curve's spline weights e among the parameters, (curves, splines)."""
        ends = self.linear + self.curve * np.arange(1, self.curves + 1)
        return ends[:, None] + np.arange(-self.splines, 0)

    def parts(self, theta: Array) -> Parts:
        """Splits a parameter vector, (count,), into matrices and curves."""
        n, m = self.states, len(self.delays)
        a, b, c, d, constant = np.split(theta[: self.linear], np.cumsum([n * n, n * m, n, m]))
        curves = []
        for own in theta[self.linear : self.count].reshape(self.curves, self.curve):
            v, w, o, e = np.split(own, np.cumsum([self.signals, n, 1]))
            curves.append(Curve(v, w, float(o[0]), e))
        return Parts(a.reshape(n, n), b.reshape(n, m), c, d, float(constant[0]), tuple(curves))


@dataclass(frozen=True, kw_only=True)
class SplineStateSpaceSettings(SignalSettings):
    """Structure and constants of a `SplineStateSpace`.

    Attributes:
        structure: States, delays and curves.
        process_noise: Variance that disturbances add to each scaled state per sample. At 0 the
            inputs alone drive the machine, so that learning minimises the free-run error.
    """

    structure: StateSpace
    process_noise: float = a_number(0.0, least=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.structure.delays) != len(self.inputs):
            text = f"state space has {len(self.structure.delays)} delays: must be "
            raise SettingsError(
                text, given=self.structure.delays, allowed=f"{len(self.inputs)}, one an input"
            )
        self.check_count(self.structure.count)

    @property
    def lags(self) -> int:
        """Measured samples from which the initial state of a free run is estimated."""
        return OBSERVED * self.structure.states + max(self.structure.delays)


class SplineStateSpace(Identifier):
    """Identifier that estimates state and parameters by an extended Kalman predictor.

    Parameters start at zero, from where nothing can be learned: assign fitted parameters first.
    """

    _banks: ClassVar = {"float64": native.SplineStateSpace64, "float32": native.SplineStateSpace32}
    settings: SplineStateSpaceSettings

    def parts(self, joint: int = 0) -> Parts:
        """Returns the parameters of one joint by name, in scaled units."""
        return self.settings.structure.parts(np.atleast_2d(self.parameters)[joint])

    def at_rest(self, inputs: Mapping[str, float], joint: int = 0) -> tuple[float, Array]:
        """Simulates constant inputs until the model rests; returns output and scaled states (n,).

        Raises:
            SettingsError: An input is missing.
        """
        u = self._scaled(inputs)
        parts = self.parts(joint)
        held = np.tile([inputs[s.name] for s in self.settings.inputs], (_ROUND, 1))
        runs = StateRuns(self.settings, [(held, np.full(_ROUND, np.nan), 0)], np.zeros(0))
        theta = np.atleast_2d(self.parameters)[joint]
        x = np.zeros(len(parts.A))
        for _ in range(_ROUNDS):
            before, x = x, runs.states(np.append(theta, x))[-1]
            if np.abs(x - before).max() < _RESTS:
                break
        values, _ = self._curves(parts, x, u)
        y = parts.C @ x + parts.D @ u + parts.d
        y += sum(f * c.o for f, c in zip(values, parts.curves, strict=True))
        output = self.settings.output
        return float(output.centre + output.half_range * y), x

    def linearise(
        self, joint: int = 0, at: Mapping[str, float] | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Returns A (n, n), B (n, M), C (1, n), D (1, M), with inputs and output in their units.

        Args:
            joint: Index of the joint.
            at: Values of the inputs by name; the model is linearised where it rests under these
                inputs. Other names are ignored. None takes the linear part alone.
        """
        parts = self.parts(joint)
        a, b, c, d = parts.A.copy(), parts.B.copy(), parts.C.copy(), parts.D.copy()
        if at is not None:
            names = [s.name for s in self.settings.inputs]
            inputs = {name: at[name] for name in names if name in at}
            _, x = self.at_rest(inputs, joint)
            _, slopes = self._curves(parts, x, self._scaled(inputs))
            for slope, curve in zip(slopes, parts.curves, strict=True):
                n = len(a)
                a += slope * np.outer(curve.w, curve.v[:n])
                b += slope * np.outer(curve.w, curve.v[n:])
                c += slope * curve.o * curve.v[:n]
                d += slope * curve.o * curve.v[n:]
        reach = self.settings.output.half_range
        scale = np.array([s.half_range for s in self.settings.inputs])
        return a, b / scale, reach * c[None], reach * d[None] / scale

    def transfer_function(
        self,
        joint: int = 0,
        *,
        signal: str | None = None,
        at: Mapping[str, float] | None = None,
        timestep: float | bool = True,
    ) -> "control.TransferFunction":
        """Returns the transfer function from `signal` (None: input 1) to y; see `linearise`."""
        import control  # takes a second
        from scipy.signal import ss2tf

        names = [s.name for s in self.settings.inputs]
        name = names[0] if signal is None else signal
        if name not in names:
            raise SettingsError.unknown("input", name, names)
        k = names.index(name)
        numerator, denominator = ss2tf(*self.linearise(joint, at), input=k)
        late = np.zeros(self.settings.structure.delays[k])
        return control.TransferFunction(numerator[0], np.append(denominator, late), timestep)

    def poles(
        self, joint: int = 0, at: Mapping[str, float] | None = None
    ) -> NDArray[np.complex128]:
        """Returns the poles, complex, (n,); see `linearise` for `at`."""
        return np.linalg.eigvals(self.linearise(joint, at)[0]).astype(np.complex128)

    def project_poles(self, radius: float = 0.999) -> bool:
        """Scales the poles of the linear part by one factor, if needed, to lie within the radius.

        Returns:
            Whether any joint's poles had to move.
        """
        checks.number("radius", radius, above=0.0, most=1.0)
        rows = np.atleast_2d(self.parameters).copy()
        moved = False
        for joint, row in enumerate(rows):
            largest = float(np.abs(self.poles(joint)).max())
            if largest > radius:
                row[: self.settings.structure.states**2] *= radius / largest
                moved = True
        if moved:
            self.parameters = rows if self.joints > 1 else rows[0]
        return moved

    def _scaled(self, inputs: Mapping[str, float]) -> Array:
        for signal in self.settings.inputs:
            if signal.name not in inputs:
                text = f"operating point lacks input {signal.name!r}"
                raise SettingsError(text, given=tuple(inputs))
        return np.array([(inputs[s.name] - s.centre) / s.half_range for s in self.settings.inputs])

    def _curves(self, parts: Parts, x: Array, u: Array) -> tuple[list[float], list[float]]:
        """Returns values and slopes of all curves."""
        signals = np.concatenate([x, u])
        found = [self._curve(c.e, float(c.v @ signals)) for c in parts.curves]
        return [f for f, _ in found], [slope for _, slope in found]

    def _curve(self, weights: Array, z: float) -> tuple[float, float]:
        inside = min(max(z, -1.0), 1.0)
        spline = self.settings.structure.basis.spline(weights)
        slope = float(spline(inside, 1))
        return float(spline(inside)) + slope * (z - inside), slope
