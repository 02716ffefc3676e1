"""Feature blocks of the regressor of `SplineNarx`, and the signals that they depend on."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from leglab.identification import checks
from leglab.identification.basis import Basis
from leglab.identification.checks import a_number, a_whole

Curve = Literal["power", "hinge", "sign"]


@dataclass(frozen=True, kw_only=True)
class Signal(checks.Settings):
    """A signal and its declared range, which is scaled to [-1, 1] and never adapted to data.

    Attributes:
        name: Name by which features refer to the signal.
        lower: Lower end of the range in units of the signal.
        upper: Upper end.
    """

    name: str
    lower: float = -1.0
    upper: float = 1.0

    def __post_init__(self) -> None:
        checks.interval(f"range of signal {self.name!r}", (self.lower, self.upper))

    @property
    def centre(self) -> float:
        """Middle of the range."""
        return (self.lower + self.upper) / 2

    @property
    def half_range(self) -> float:
        """Half the width of the range."""
        return (self.upper - self.lower) / 2


@dataclass(frozen=True, kw_only=True)
class Lags(checks.Settings):
    """Linear features x(t - first), ..., x(t - first - count + 1).

    Attributes:
        signal: Name of x.
        first: Smallest lag [samples]; at least 1 for the output.
        count: Number of lags.
    """

    signal: str
    first: int = 1
    count: int = 1

    def __post_init__(self) -> None:
        checks.whole(f"first lag of {self.signal!r}", self.first, least=0, most=1000)
        checks.whole(f"count of lags of {self.signal!r}", self.count, least=1, most=1000)


@dataclass(frozen=True, kw_only=True)
class Constant(checks.Settings):
    """The feature 1."""


@dataclass(frozen=True, kw_only=True)
class Spline(checks.Settings):
    """Features N_i(x(t - lag)), each with its own parameter, learned by least squares.

    Attributes:
        signal: Name of x.
        lag: Lag [samples]; at least 1 for the output.
        basis: The splines, with knots in units of x.
        times: Optional (signal, lag) that multiplies every spline: a gain that depends on x.
    """

    signal: str
    lag: int = 1
    basis: Basis
    times: tuple[str, int] | None = None

    def __post_init__(self) -> None:
        checks.whole(f"spline lag of {self.signal!r}", self.lag, least=0, most=1000)
        if self.times is not None:
            checks.whole(f"factor lag of {self.times[0]!r}", self.times[1], least=0, most=1000)


@dataclass(frozen=True, kw_only=True)
class Hammerstein(checks.Settings):
    """Features n(t - first), ... of n = sum_i w_i N_i(x); gradient steps adapt the weights w.

    The weights start as the identity and follow the gradient of the squared error, with
    d y / d w_i = sum_k theta_k N_i(x(t - k)). The paper's rule differs: it trains the network
    towards y itself.

    Attributes:
        signal: Name of the input x.
        first: Smallest lag [samples].
        count: Number of lags.
        basis: The splines, full, with knots in units of x.
        learning_constant: mu in [0, 2) of the gradient step.
    """

    owner: ClassVar = "hammerstein"
    signal: str
    first: int = 1
    count: int = 3
    basis: Basis
    learning_constant: float = a_number(0.1, least=0.0, most=2.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.whole(f"first lag of {self.signal!r}", self.first, least=0, most=1000)
        checks.whole(f"count of lags of {self.signal!r}", self.count, least=1, most=1000)


@dataclass(frozen=True, kw_only=True)
class Term(checks.Settings):
    """The feature g(x(t - lag)), alone or times another signal's lag.

    Attributes:
        signal: Name of x.
        lag: Lag [samples]; at least 1 for the output.
        curve: g: "power" is x^degree of the scaled x; "hinge" is max(x - at, 0); "sign" is
            q / (q + 1/2) with the sign of x - at, s = |x - at| / width and q = s (s + 1/2): as
            smooth as s / sqrt(1 + s^2), but without a square root.
        degree: Exponent of "power".
        at: Kink of "hinge" or zero of "sign", in units of x.
        width: Width of "sign" in units of x: |g| is 3/4 at this distance from `at`.
        change: Whether g is a function of the change x(t - lag) - x(t - lag - 1), on whose sign
            friction and hysteresis depend. `at` is then in units of the change.
        times: Optional (signal, lag) that multiplies g. A product of two lags is a "power" of
            degree one, multiplied by the second lag.
    """

    owner: ClassVar = "term"
    signal: str
    lag: int = 1
    curve: Curve = "power"
    degree: int = a_whole(1, least=1, most=5)
    at: float = a_number(0.0)
    width: float = a_number(1.0, above=0.0)
    change: bool = False
    times: tuple[str, int] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.whole(f"term lag of {self.signal!r}", self.lag, least=0, most=1000)
        if self.times is not None:
            checks.whole(f"factor lag of {self.times[0]!r}", self.times[1], least=0, most=1000)


Feature = Lags | Constant | Spline | Hammerstein | Term
