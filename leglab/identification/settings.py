"""Settings that the identifiers share: forgetting, change detection and sample guards."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from leglab.base.errors import SettingsError
from leglab.identification import checks
from leglab.identification.checks import a_number, a_whole
from leglab.identification.features import Signal

Forgetting = Literal["none", "exponential", "directional", "variable"]
ChangeAction = Literal["reset", "inflate"]
Scalar = Literal["float64", "float32"]
MAX_INPUTS = 40  # of any identifier, as in the core (guard.h)
# The factor of least squares holds half the square of this number: 64 MiB in float64.
MAX_PARAMETERS = 4096


@dataclass(frozen=True, kw_only=True)
class ChangeDetection(checks.Settings):
    """Opens the gain when the a-priori error grows: fast at first, slow later.

    A change is declared where the mean squared error over about `fast_window` samples exceeds
    `ratio` times that over `slow_window`. A ratio of 2 gives false alarms, 4 misses changes.

    Attributes:
        fast_window: Samples of the fast exponential mean.
        slow_window: Samples of the slow exponential mean.
        ratio: Ratio of the fast to the slow mean square at which a change is declared.
        hold_off: Samples after the start and after a change without (another) alarm.
        action: "reset" sets F to gain * I, "inflate" adds gain * I.
        gain: See action.
    """

    owner: ClassVar = "change"
    fast_window: int = a_whole(20, least=1)
    slow_window: int = 500
    ratio: float = a_number(3.0, above=1.0)
    hold_off: int = a_whole(200, least=0)
    action: ChangeAction = "reset"
    gain: float = a_number(1e4, above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.whole("change slow_window", self.slow_window, least=self.fast_window + 1)


@dataclass(frozen=True, kw_only=True)
class Rls(checks.Settings):
    """Recursive least squares (Eqs. 6 to 8) with forgetting.

    Attributes:
        initial_gain: F(0) is this factor times the identity.
        forgetting: "none" is Eq. 8. "exponential" has a constant factor. "directional" forgets
            only along the regressor (Kulhavy 1987). "variable" chooses the factor from the
            error (Fortescue, Kershenbaum and Ydstie 1981).
        forgetting_factor: Lambda in [0.5, 1]; the least one allowed in variable forgetting.
        memory: N_0 of variable forgetting [samples].
        noise_variance: Variance that variable forgetting assumes, in squared (scaled) output
            units; 0 uses the slow mean of the squared error.
        gain_bound: Bound of trace(F) per parameter; None takes ten times the initial gain.
        restore_interval: Updates from one restoration to the next. Each restores the forgotten
            prior information of one parameter in turn (Gunnarsson 1996): without excitation the
            model returns to the prior instead of drifting. 0: never.
        restore_gain: Variance of that prior, whose mean is zero; None takes the initial gain.
        change: Change detection, or None.
    """

    owner: ClassVar = "rls"
    initial_gain: float = a_number(1e4, above=0.0)
    forgetting: Forgetting = "none"
    forgetting_factor: float = a_number(1.0, least=0.5, most=1.0)
    memory: float = a_number(400.0, least=1.0)
    noise_variance: float = a_number(0.0, least=0.0)
    gain_bound: float | None = None
    restore_interval: int = a_whole(0, least=0)
    restore_gain: float | None = None
    change: ChangeDetection | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        gain = self.initial_gain if self.restore_gain is None else self.restore_gain
        object.__setattr__(self, "restore_gain", gain)
        checks.number("rls restore_gain", gain, above=0.0)
        bound = 10 * self.initial_gain if self.gain_bound is None else self.gain_bound
        object.__setattr__(self, "gain_bound", bound)
        checks.number("rls gain_bound", bound, least=self.initial_gain)
        if self.change is not None and self.change.gain > bound:
            text = f"change gain is {self.change.gain!r}: must not exceed "
            raise SettingsError(text, given=self.change.gain, allowed=f"gain_bound {bound!r}")

    @classmethod
    def adaptive(cls, initial_gain: float = 1e4) -> "Rls":
        """Returns variable forgetting (N_0 = 400) with reset on change, which re-adapts fastest."""
        return cls(
            initial_gain=initial_gain,
            forgetting="variable",
            forgetting_factor=0.9,
            change=ChangeDetection(gain=initial_gain),
        )


@dataclass(frozen=True, kw_only=True)
class Guard(checks.Settings):
    """Rules for samples that are counted but not learned; the last good value replaces a bad one.

    NaN and infinite values are always refused. After a bad sample learning waits until the
    regressor holds only good ones.

    Attributes:
        stuck_samples: Number of samples with bit-identical output, while an input moves, after
            which the sensor counts as stuck; 0: never.
        input_limits: (lower, upper) for each input in its units: a command at or beyond a limit
            is saturated. Empty: no limits.
    """

    owner: ClassVar = "guard"
    stuck_samples: int = a_whole(0, least=0)
    input_limits: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        limits = tuple((float(low), float(high)) for low, high in self.input_limits)
        object.__setattr__(self, "input_limits", limits)
        for j, limit in enumerate(limits):
            checks.interval(f"guard input_limits[{j}]", limit)

    def check_inputs(self, inputs: int) -> None:
        """Requires limits for all inputs, whose number is `inputs`, or for none."""
        if self.input_limits and len(self.input_limits) != inputs:
            text = f"guard has limits for {len(self.input_limits)} inputs: the model has "
            raise SettingsError(text, given=len(self.input_limits), allowed=str(inputs))


@dataclass(frozen=True, kw_only=True)
class SignalSettings(checks.Settings):
    """Settings common to identifiers of scaled signals.

    Attributes:
        output: The output and its declared range.
        inputs: Inputs in the order of their columns in a sample.
        rls: Recursive least squares; errors and gains are in scaled units.
        guard: Which samples are refused.
        plausible_range: Largest distance of a signal from the middle of its declared range, in
            half ranges; samples beyond are refused as implausible. 0 allows any.
        free_run_limits: Bounds of the simulated output in validation and free run, in units of
            the output, as a stop or an overflow bounds the machine's output; None: no bounds.
        scalar: Arithmetic of the core.
    """

    output: Signal = field(default_factory=lambda: Signal(name="y"))
    inputs: tuple[Signal, ...] = field(default_factory=lambda: (Signal(name="u"),))
    rls: Rls = field(default_factory=Rls.adaptive)
    guard: Guard = field(default_factory=Guard)
    plausible_range: float = a_number(5.0, least=0.0)
    free_run_limits: tuple[float, float] | None = None
    scalar: Scalar = "float64"

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.whole("number of inputs", len(self.inputs), least=1, most=MAX_INPUTS)
        names = self.names
        if len(set(names)) != len(names):
            text = f"signal names are {', '.join(names)}: must differ"
            raise SettingsError(text, given=tuple(names))
        self.guard.check_inputs(len(self.inputs))
        if self.free_run_limits is not None:
            checks.interval("free_run_limits", self.free_run_limits)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The output, then the inputs."""
        return (self.output, *self.inputs)

    @property
    def names(self) -> list[str]:
        """Names of all signals."""
        return [signal.name for signal in self.signals]

    def check_count(self, count: int) -> None:
        """Requires between 1 and `MAX_PARAMETERS` parameters."""
        checks.whole("number of parameters", count, least=1, most=MAX_PARAMETERS)
