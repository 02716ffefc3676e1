"""`identify`: models of the outputs of a machine, with errors on training and test data."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from leglab.base.errors import RecordingError
from leglab.base.recording import Recording
from leglab.base.threads import one_blas_thread
from leglab.identification.features import Constant, Signal
from leglab.identification.settings import Rls
from leglab.identification.spline_narx import SplineNarx, SplineNarxSettings
from leglab.identification.spline_state_space import SplineStateSpace
from leglab.identification.structure import library, plans, search
from leglab.identification.structure.blocks import Held, stretches
from leglab.identification.structure.fit import (
    Array,
    Model,
    Problem,
    Record,
    Simulator,
    fit,
    one_step_stretches,
    single,
    startable,
    whole_runs,
)
from leglab.identification.structure.plans import Candidate, Plan
from leglab.identification.structure.signals import Signals, signals_of
from leglab.identification.structure.states import information_of, refitted

# The free run is limited to the range of the training output, widened on each side by this share of
# the range: test data may lie beyond the range, but an unstable model must not diverge.
_REACH = 0.3
_INITIAL_GAIN = 1e4  # F(0) of an untrained model; later F in directions that the data do not excite
_DEPARTURE = 0.1  # prior standard deviation of a state-space model's parameters about their start
_DISTURBANCES = (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)  # tried process noise, in output-error variances


@dataclass(frozen=True)
class Errors:
    """Errors of a model on one recording.

    Attributes:
        recording: Name of the recording.
        free_run: RMS error of the free run from the first measured samples on [output's unit].
        one_step: RMS error of the one-step prediction.
        fit: 100 (1 - |y - free run| / |y - mean of y|) [%].
        linear: RMS free-run error of the best linear model.
        mean: RMS deviation of the output from the mean of the training data.
        online: RMS free-run error of `Identified.online`, learned in a single pass.
        measured: Output, (N,).
        simulated: Free run, (N,); begins with measured samples.
        predicted: One-step prediction, (N,); begins with measured samples.
    """

    recording: str
    free_run: float
    one_step: float
    fit: float
    linear: float
    mean: float
    online: float
    measured: Array
    simulated: Array
    predicted: Array


@dataclass(frozen=True)
class Identified:
    """A model of one output and the candidates from which it was chosen.

    Attributes:
        output: Name of the output.
        inputs: Names of the inputs.
        period: Sampling period [s].
        model: The identifier, ready to continue learning where the training data ended.
        candidates: All structures, the chosen one first.
        problem: Training records.
        tests: Test records, which no fit uses.
        notes: Messages about omitted, interpolated or doubtful data.
    """

    output: str
    inputs: tuple[str, ...]
    period: float
    model: Model
    candidates: tuple[Candidate, ...]
    problem: Problem
    tests: tuple[Record, ...]
    notes: tuple[str, ...]

    @property
    def chosen(self) -> Candidate:
        """The chosen structure."""
        return self.candidates[0]

    @property
    def linear(self) -> Candidate:
        """The best linear structure."""
        return next(c for c in self.candidates if c.plan.kind in plans.LINEAR)

    @property
    def constant(self) -> Candidate:
        """The constant output, which every model has to beat."""
        return next(c for c in self.candidates if c.plan.kind == plans.CONSTANT)

    @property
    def kind(self) -> str:
        """Name of the model class in the literature."""
        kind = library.kind_of(self.problem, self.chosen.fit)
        how = {"linear": ", fitted to the free run", "one step": ", fitted to one step (ARX)"}
        return kind + how.get(self.chosen.plan.kind, "")

    @property
    def better_than_mean(self) -> bool:
        """True if the free run over held-out blocks beats a constant."""
        return self.chosen.plan.kind != plans.CONSTANT

    def at_rest(self, signal: str, values: Array) -> Array:
        """Returns the output for values of one signal, the other signals at their means, (n,).

        A model of lags predicts one step with all lags of a signal at the same value; for a
        state-space model the result is the steady output under constant inputs.

        Args:
            signal: An input or, for a model of lags, the output.
            values: Values of the signal in its units, (n,).
        """
        model = self.model
        names = model.settings.names
        means = {name: float(np.mean(self.problem.samples[name])) for name in names}
        if isinstance(model, SplineStateSpace):
            inputs = {name: means[name] for name in self.inputs}
            rows = [{**inputs, signal: float(value)} for value in values]
            return np.array([model.at_rest(row)[0] for row in rows])
        table = np.tile([means[name] for name in names], (len(values), 1))
        table[:, names.index(signal)] = values
        held = np.repeat(table, model.lags + 2, axis=0)
        return model.one_step(single(held[:, 1:]), held[:, 0])[model.lags + 1 :: model.lags + 2]

    @cached_property
    def online(self) -> tuple[Model, Array]:
        """A model learned online in one pass, and its parameters over the first record, (N, P).

        A model of lags starts from zero parameters, a state-space model with straight curves, which
        make it linear. The parameters are in scaled units.
        """
        model = _from_nothing(self.model)
        trajectory = np.zeros((0, 0))
        for record in self.problem.records:
            _break_off(model)
            _, own = model.run_recorded(single(record.u), record.y, missing="skip")
            trajectory = own if not len(trajectory) else trajectory
        model.freeze()
        return model, trajectory

    @cached_property
    def trained(self) -> tuple[Errors, ...]:
        """Errors on the training records; each free run starts from a record's first samples."""
        return self._all_errors(self.problem.records)

    @cached_property
    def tested(self) -> tuple[Errors, ...]:
        """Errors on the test records."""
        return self._all_errors(self.tests)

    def _all_errors(self, records: Sequence[Record]) -> tuple[Errors, ...]:
        """Computes the errors on the records that have enough measured samples to start from."""
        lags = max(self.model.lags, self._linear.lags)
        usable = [record for record in records if startable(record, lags).any()]
        if records and not usable:
            raise RecordingError(f"{records[0].name}: no {lags} outputs in a row are measured")
        return tuple(map(self._errors, usable))

    def _errors(self, record: Record) -> Errors:
        runs = [self._run(m, record) for m in (self.model, self._linear, self.online[0])]
        free, linear, online = (rms(run - record.y, self.model.lags) for run in runs)
        mean = float(np.nanmean(np.concatenate([r.y for r in self.problem.records])))
        spread = rms(record.y - np.nanmean(record.y), self.model.lags)
        predicted = self._one_step(record)
        return Errors(
            recording=record.name,
            free_run=free,
            one_step=rms(predicted - record.y, self.model.lags),
            fit=100 * (1 - free / spread) if spread > 0 else float("nan"),
            linear=linear,
            mean=rms(record.y - mean, self.model.lags),
            online=online,
            measured=record.y,
            simulated=runs[0],
            predicted=predicted,
        )

    @cached_property
    def _linear(self) -> Model:
        return self.problem.identifier(self.linear.fit)

    def _run(self, model: Model, record: Record) -> Array:
        first = int(startable(record, max(model.lags, self.model.lags)).argmax())
        given = record.y[first - model.lags : first]
        run = model.free_run(single(record.u[first - model.lags :]), given)
        return np.concatenate([record.y[: first - model.lags], run])

    def _one_step(self, record: Record) -> Array:
        y = record.y
        bridged = np.interp(np.arange(len(y)), np.flatnonzero(np.isfinite(y)), y[np.isfinite(y)])
        return self.model.one_step(single(record.u), bridged)


def rms(residual: Array, given: int = 0) -> float:
    """Returns the RMS of a residual without its first `given` samples and without NaN."""
    rest = residual[given:]
    rest = rest[np.isfinite(rest)]
    return float(np.sqrt(np.mean(rest**2))) if len(rest) else float("nan")


def _break_off(model: Model) -> None:
    """Feeds a sample of NaN, so that the model does not take the next record as a continuation."""
    missing = np.full((1, model.inputs), np.nan)
    model.run(single(missing), np.full(1, np.nan), missing="skip")


def _from_nothing(model: Model) -> Model:
    """Returns an untrained model of the same structure."""
    settings = model.settings
    if isinstance(settings, SplineNarxSettings):
        rls = Rls(initial_gain=_INITIAL_GAIN)
        return SplineNarx(replace(settings, rls=rls, output_error_after=0))
    # Straight curves make the model linear. Zero curves would also remove feedback through curves.
    structure = settings.structure
    out = SplineStateSpace(
        replace(settings, rls=Rls(initial_gain=_DEPARTURE**2), process_noise=0.0)
    )
    theta, places = model.parameters.copy(), structure.spline_weights
    at = structure.basis.identity_weights()
    for own in places:
        theta[own] = np.polyval(np.polyfit(at, theta[own], 1), at)
    out.parameters = theta
    return out


def identify(
    recordings: Mapping[str, Recording] | Recording,
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    tests: Mapping[str, Recording] | None = None,
    period: float | None = None,
    jobs: int = 1,
    progress: search.Progress | None = None,
    kept: Mapping[str, Mapping[Plan, Candidate]] | None = None,
    keep: Callable[[str, Candidate], None] | None = None,
) -> dict[str, Identified]:
    """Chooses delays, lags and features from recordings, and fits them.

    Args:
        recordings: Training recordings, by name.
        inputs: Columns that drive the machine; by default the columns that begin with u.
        outputs: Columns to be modelled; by default the columns that begin with y.
        tests: Test recordings; they do not affect the choice.
        period: Sampling period to resample to [s].
        jobs: Number of threads; the result does not depend on it.
        progress: Function called after each structure; see `search.Progress`.
        kept: Results of an interrupted search, by output.
        keep: Function called with the name of an output and each new result for it.

    Returns:
        A model for each output, by name.

    Raises:
        LeglabError: As `signals_of`.
    """
    if isinstance(recordings, Recording):
        recordings = {"recording": recordings}
    learned = signals_of(recordings, inputs, outputs, period=period)
    tested = None
    if tests:
        tested = signals_of(
            tests,
            learned.inputs,
            learned.outputs,
            period=period or learned.period,
            resting=True,
        )
        if lacking := set(learned.inputs) - set(tested.inputs):
            why = next(n for n in tested.notes if n.startswith(repr(min(lacking))))
            raise RecordingError(f"test data: {why}", given=min(lacking))
    out = {}
    for k, output in enumerate(learned.outputs):
        problem = _problem(learned, k)
        with one_blas_thread():
            found = search.search(
                problem,
                jobs=jobs,
                progress=progress,
                kept=(kept or {}).get(output),
                keep=None if keep is None else partial(keep, output),
            )
            out[output] = _identified(problem, found, learned, tested, k)
    return out


def _identified(
    problem: Problem,
    found: Sequence[Candidate],
    learned: Signals,
    tested: Signals | None,
    k: int,
) -> Identified:
    """Refits the chosen structure to more samples of all records, and collects the results."""
    candidates = settled(problem, found)
    output, tests = learned.outputs[k], tested.records[k] if tested else ()
    notes = (*learned.notes, *(tested.notes if tested else ()))
    notes += _drift(problem.records, tests, learned.inputs, output)
    notes += tuple(
        f"{test.name}: the test data are training data, so their errors test nothing"
        for test in tests
        if any(np.array_equal(test.y, record.y, equal_nan=True) for record in problem.records)
    )
    return Identified(
        output=output,
        inputs=learned.inputs,
        period=learned.period,
        model=_going_on(problem, candidates[0]),
        candidates=candidates,
        problem=problem,
        tests=tests,
        notes=tuple(dict.fromkeys(notes)),
    )


def settled(problem: Problem, found: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Returns the candidates, first the best one whose fit to all records holds.

    A fit has ended in a wrong minimum if its free run over the records that it has seen is worse
    than the best linear model's over held-out blocks.
    """
    limit = next(c.score for c in found if c.plan.kind in plans.LINEAR)
    for k, candidate in enumerate(found):
        if candidate.plan.kind in (*plans.LINEAR, plans.CONSTANT):
            break
        for tried in () if candidate.plan.sketch else (_refitted(problem, candidate), candidate):
            held = Held(problem, problem.model(tried.fit.features).lags)
            if plans.mean_score(held.errors([tried.fit] * len(held.all))) <= limit:
                return tried, *found[:k], *found[k + 1 :]
    return _refitted(problem, candidate), *found[:k], *found[k + 1 :]


def _refitted(problem: Problem, candidate: Candidate) -> Candidate:
    """Refits a structure, from its present parameters, to more samples of all records."""
    plan, features = candidate.plan, candidate.fit.features
    if plan.kind == plans.STATES:
        return replace(candidate, fit=refitted(problem, candidate.fit, plan.strength, plans.LAST))
    if plan.kind == "one step":
        return candidate
    settings = problem.lagged(features)
    own = stretches(problem, settings.lags, plan.length, plans.LAST)
    last = fit(problem, settings.features, candidate.fit.theta, own, plan.strength)
    return replace(candidate, fit=last)


def _problem(learned: Signals, k: int) -> Problem:
    records = learned.records[k]
    y = np.concatenate([r.y for r in records])
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    signals = []
    for j, name in enumerate(learned.inputs):
        column = np.concatenate([r.u[:, j] for r in records])
        signals.append(Signal(name=name, lower=float(column.min()), upper=float(column.max())))
    # Forgetting factor: after as many new samples as training samples, the old ones weigh 1/e.
    kept = 1 - 1 / max(int(np.isfinite(y).sum()), 2)
    template = SplineNarxSettings(
        output=Signal(name=learned.outputs[k], lower=low, upper=high),
        inputs=tuple(signals),
        features=(Constant(),),
        rls=Rls(
            initial_gain=_INITIAL_GAIN,
            forgetting="exponential",
            forgetting_factor=kept,
            gain_bound=_INITIAL_GAIN,
        ),
        free_run_limits=(low - _REACH * (high - low), high + _REACH * (high - low)),
    )
    return Problem(records, template)


def _going_on(problem: Problem, best: Candidate) -> Model:
    """Returns an identifier with the fitted parameters and the gain after all training samples.

    The identifier minimises the free-run or the one-step error in learning, whichever leaves the
    smaller free-run error after another pass over the training data. Sensor noise biases learning
    by the one-step error; disturbances of the machine bias learning by the free-run error.
    """
    tried: list[tuple[float, Model]] = []
    for model, information in _learners(problem, best):
        gain = np.linalg.inv(information + np.eye(len(information)) / _INITIAL_GAIN)
        model.set_gain((gain + gain.T) / 2)
        again = model.copy()
        for record in problem.records:
            _break_off(again)
            again.run(single(record.u), record.y, missing="skip")
        left = _free_run_error(problem, again)
        tried.append((left if np.isfinite(left) else np.inf, model))
    model = min(tried, key=lambda one: one[0])[1]
    # Fills the regressor with the last samples; a frozen identifier does not learn from them.
    last = problem.records[-1]
    model.freeze()
    model.run(single(last.u[-model.lags - 1 :]), last.y[-model.lags - 1 :], missing="skip")
    model.freeze(False)
    return model


def _learners(problem: Problem, best: Candidate) -> Iterator[tuple[Model, Array]]:
    """Yields identifiers that minimise free-run or one-step errors, and information matrices."""
    theta, settings = best.fit.theta, problem.model(best.fit.features)
    if isinstance(settings, SplineNarxSettings):
        simulator = Simulator(settings, problem.records)
        whole = whole_runs(problem, settings.lags)
        for after, own in ((1, whole), (0, one_step_stretches(problem, settings.lags))):
            narx = SplineNarx(replace(settings, output_error_after=after))
            narx.parameters = theta
            yield narx, simulator.sums(theta, own, sensitivities=True).products
        return
    information = information_of(problem, best.fit, best.plan.strength)
    # Exponential forgetting would let F grow along the many parameters that have no effect on y.
    rls = replace(settings.rls, forgetting="directional")
    settings = replace(settings, rls=rls)
    for disturbed in (False, True):
        model = SplineStateSpace(settings)
        model.parameters = theta
        if disturbed:
            model = disturbed_model(problem, model)
        yield model, information


def disturbed_model(problem: Problem, model: SplineStateSpace) -> SplineStateSpace:
    """Returns the model with the process noise that gives the least one-step error."""
    tried: list[tuple[float, int, SplineStateSpace]] = []
    for share in _DISTURBANCES:
        noise = share * model.settings.structure.noise
        own = SplineStateSpace(replace(model.settings, process_noise=noise))
        own.parameters = model.parameters
        tried.append((_one_step_error(problem, own), len(tried), own))
    return min(tried)[2]


def _one_step_error(problem: Problem, model: Model) -> float:
    """Returns the mean squared one-step error over all records, in the output's unit squared."""
    left = model.copy()
    left.freeze()
    total = count = 0.0
    for record in problem.records:
        _break_off(left)
        error = left.run(single(record.u), record.y, missing="skip") - record.y
        total, count = total + float(np.nansum(error**2)), count + np.isfinite(error).sum()
    return total / count


def _free_run_error(problem: Problem, model: Model) -> float:
    """Returns the sum of squared errors of free runs of all records, from the first valid start."""
    total = 0.0
    for record in problem.records:
        usable = startable(record, model.lags)
        if usable.any():
            first = int(usable.argmax())
            given = record.y[first - model.lags : first]
            run = model.free_run(single(record.u[first - model.lags :]), given)
            total += float(np.nansum((run - record.y[first - model.lags :]) ** 2))
    return total


def _drift(
    learned: Sequence[Record], tested: Sequence[Record], inputs: Sequence[str], output: str
) -> tuple[str, ...]:
    """Returns notes on test signals that exceed the training range or have another mean."""
    if not tested:
        return ()
    notes = []
    columns = [(output, [r.y for r in learned], [r.y for r in tested])]
    for j, name in enumerate(inputs):
        columns.append((name, [r.u[:, j] for r in learned], [r.u[:, j] for r in tested]))
    for name, before, after in columns:
        a, b = (np.concatenate(part) for part in (before, after))
        low, high = np.nanmin(a), np.nanmax(a)
        slack = 0.02 * (high - low)
        beyond = float(np.nanmean((b < low - slack) | (b > high + slack)))
        if beyond > 0.001:
            notes.append(f"{100 * beyond:.2g} % of the test data of {name!r} lie beyond training")
        shift = abs(np.nanmean(b) - np.nanmean(a)) / np.nanstd(a)
        if shift > 0.5:
            notes.append(f"the mean of {name!r} drifts by {shift:.2g} deviations from training on")
    return tuple(notes)
