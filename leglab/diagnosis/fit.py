"""Fit of parameters that the user chooses, by least squares of replay errors.

The user's bounds are the only prior. If a recording's metadata name no simulation, the times at
which commands act are uncertain by half a time step (standard deviation). Since errors of
neighbouring windows are correlated, the parameters' covariance is estimated from the scatter
between parts of the recordings (the "sandwich" of Liang and Zeger 1986, Biometrika 73, 13).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from leglab.base.errors import SettingsError
from leglab.base.recording import Recording
from leglab.base.threads import one_blas_thread
from leglab.diagnosis import result
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.intake.recordings import split_held_out
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.evidence import parts_of
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import Problem, robust_weight, whitened
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.thresholds import FINE, SAME
from leglab.diagnosis.verdict.notes import notes
from leglab.diagnosis.verdict.verdict import errors_of

# Number of fits: the first weights windows equally, and its errors determine the second's weights.
_ROUNDS = 2


class Wanted(NamedTuple):
    """A parameter to fit, as `ELEMENT:NAME`, or `ELEMENT:NAME=LOWER:UPPER` in SI units."""

    element: str  #: Joint, actuator, body or plugin instance
    name: str  #: Name of the effect or of its parameter, or EFFECT.PARAMETER
    lower: float = -inf
    upper: float = inf

    @classmethod
    def parse(cls, text: str) -> "Wanted":
        """Reads a parameter to fit from text.

        Raises:
            LeglabError: The text is not of this form.
        """
        what, given, bounds = text.partition("=")
        element, _, name = what.partition(":")
        allowed = "ELEMENT:NAME or ELEMENT:NAME=LOWER:UPPER, as knee:coulomb_friction=0.1:5"
        try:
            lower, upper = map(float, bounds.split(":")) if given else (-inf, inf)
        except ValueError:
            element = ""
        if not (element and name):
            message = f"--parameter {text!r} is no parameter; allowed: "
            raise SettingsError(message, given=text, allowed=allowed)
        if not lower < upper:
            message = f"--parameter {text!r}: the lower bound is not below the upper one; allowed: "
            raise SettingsError(message, given=bounds, allowed=allowed)
        return cls(element, name, lower, upper)


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """Fitted parameters.

    Attributes:
        result: Estimates, their covariance, errors and figures of the page.
        problem: Recordings and machine.
        hypothesis: The fitted values.
    """

    result: result.Diagnosis
    problem: Problem
    hypothesis: Hypothesis


@one_blas_thread()
def fit(
    model: str | Path | Machine,
    recordings: Mapping[str, Recording],
    parameters: Sequence[Wanted],
    *,
    held_out: Iterable[str] | None = None,
    settings: DiagnosisSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ParameterFit:
    """Fits parameters of a model to recordings.

    Args:
        model: MJCF file, the name of a model that ships with leglab, or its machine.
        recordings: By name.
        parameters: Parameters to fit, with bounds.
        held_out: Names of the recordings that no fit sees; None for the choice of `split_held_out`.
        settings: Threads and thresholds.
        progress: Called with a line of text on the present step.

    Raises:
        LeglabError: Model or recordings cannot be used, or the machine lacks a parameter.
    """
    began, settings = perf_counter(), settings or DiagnosisSettings()
    machine = model if isinstance(model, Machine) else Machine(model)
    library = Library(machine)
    places = [_place(library, wanted) for wanted in parameters]
    if twice := next(
        (w for w, p in zip(parameters, places, strict=True) if places.count(p) > 1), None
    ):
        asked = f"{twice.element}:{twice.name}"
        text = f"--parameter {asked} is given more than once; allowed: "
        raise SettingsError(text, given=asked, allowed="once")
    if held_out is None:
        recordings, held_out = split_held_out(machine, recordings, (), settings.thresholds)
    effects = tuple({key[0] for key, _ in places})
    problem = set_up(machine, recordings, held_out, replace(settings, effects=effects))
    fitted = _Fitted(problem, places, parameters)
    for round_ in range(_ROUNDS):
        fitted.solve(progress, round_)
    return fitted.told(began)


# Effects by the MJCF attribute that holds their value.
_ATTRIBUTES = {
    "frictionloss": "coulomb_friction",
    "damping": "viscous_friction",
    "stiffness": "spring_stiffness",
    "forcerange": "force_saturation",
    "ctrlrange": "command_saturation",
}


def _place(library: Library, wanted: Wanted) -> tuple[Key, int]:
    """Returns effect, element and number of a parameter that the user names."""
    own = [
        (key, i, p)
        for key, site in sorted(library.sites.items())
        if key[1] == wanted.element
        for i, p in enumerate(site.parameters)
    ]
    ways: tuple[Callable[[Key, str], bool], ...] = (
        lambda key, name: f"{key[0]}.{name}" == wanted.name,
        lambda key, _: key[0] in (wanted.name, _ATTRIBUTES.get(wanted.name)),
        lambda _, name: name == wanted.name,
    )
    asked, several = f"{wanted.element}:{wanted.name}", own
    told = f"--parameter {asked!r} names no parameter of this machine; allowed: "
    for way in ways:
        found = [row for row in own if row[2].role == "strength" and way(row[0], row[2].name)]
        found = found or [row for row in own if way(row[0], row[2].name)]
        if len(found) == 1:
            return found[0][:2]
        if found:
            told, several = f"--parameter {asked!r} names several parameters; allowed: ", found
            break
    elements = ", ".join(sorted({element for _, element in library.sites}))
    names = ", ".join(f"{key[0]}.{p.name}" for key, _, p in several)
    allowed = f"of {wanted.element}: {names}" if own else f"an element of {elements}"
    raise SettingsError(told, given=asked, allowed=allowed)


class _Fitted:
    """Least-squares fit of single parameters' departures from nominal, in smallest trials."""

    def __init__(
        self, problem: Problem, places: Sequence[tuple[Key, int]], wanted: Sequence[Wanted]
    ) -> None:
        self._problem, self._places = problem, places
        self._remarks: list[str] = []
        self._rows = [problem.library.sites[key].parameters[i] for key, i in places]
        unknowns = Unknowns.of(problem.library)
        self._errors = Errors(problem, unknowns, problem.fitted)
        self._unknowns = [unknowns.places.index((place,)) for place in places]
        self._ends = [self._bounds(*pair) for pair in zip(places, wanted, strict=True)]
        self._lower, self._upper = np.array(
            [
                [p.from_nominal(end) / p.scale for end in ends]
                for p, ends in zip(self._rows, self._ends, strict=True)
            ]
        ).T
        # The start is inside the bounds, because at a bound the solver takes tiny steps.
        inside = np.minimum(1.0, 0.1 * (self._upper - self._lower))
        self._z = np.clip(np.zeros(len(places)), self._lower + inside, self._upper - inside)
        self._weight = np.ones(int(problem.fitted.sum()))
        self._early = self._half_a_step_early()

    def _bounds(self, place: tuple[Key, int], wanted: Wanted) -> tuple[float, float]:
        """Returns the bounds that both the user and the effect allow [SI units]."""
        key, i = place
        p = self._problem.library.sites[key].parameters[i]
        lower, upper = max(wanted.lower, p.lower), min(wanted.upper, p.upper)
        if np.isfinite(wanted[2:]).any() and (lower, upper) != wanted[2:]:
            self._remarks.append(
                f"{wanted.element}:{wanted.name} is fitted within [{lower:g}, {upper:g}] {p.unit}: "
                "the effect has no other values"
            )
        if not lower < upper:
            raise SettingsError(
                f"--parameter {wanted.element}:{wanted.name}: the bounds leave nothing; allowed: ",
                given=f"{wanted.lower:g}:{wanted.upper:g}",
                allowed=f"within [{p.lower:g}, {p.upper:g}] {p.unit}",
            )
        return lower, upper

    def _hypothesis(self, z: np.ndarray) -> Hypothesis:
        by = dict(zip(self._unknowns, z.tolist(), strict=True))
        return self._errors.unknowns.moved(Hypothesis(), by)

    def _white(self, errors: np.ndarray) -> np.ndarray:
        """Weights errors, (windows, size), and whitens them for uncertain command times as well."""
        noise = self._problem.noise.whitening[self._errors.chosen]
        own, early = (
            np.sqrt(self._weight)[:, None] * whitened(noise, each[:, : self._errors.size])
            for each in (errors, self._early)
        )
        # Whitens all windows for the covariance I + e e', where e is the change by early commands.
        square = max(float((early**2).sum()), 1e-300)
        return own - (1.0 - (1.0 + square) ** -0.5) / square * float((early * own).sum()) * early

    def _half_a_step_early(self) -> np.ndarray:
        """Returns the errors' change if commands act half a time step early, (windows, size).

        It is zero for recordings whose metadata name a simulation, see `Recording.command_lead`.
        """
        problem, errors = self._problem, self._errors
        series, lead = problem.series, 0.5 * problem.machine.file_timestep
        unknown = np.array([s.command_lead is None for s in series])[errors.recording]
        change = problem.library.change(self._hypothesis(self._z), problem.replay.machine)
        here, early = (
            problem.replay.error(change, chosen=errors.chosen, lead=by).normalised
            for by in (0.0, lead)
        )
        return np.asarray(unknown[:, None] * (early - here).reshape(len(here), -1))

    def _residual(self, z: np.ndarray) -> np.ndarray:
        return self._white(self._errors.at(self._hypothesis(z)))

    def _jacobian(self, z: np.ndarray) -> np.ndarray:
        """Returns difference quotients of `_white` by parameter, (windows, size, parameters)."""
        step = np.maximum(FINE[0], FINE[1] * np.abs(z))
        step = np.where(z + step > self._upper, -step, step)
        points = [z, *(z + row for row in np.diag(step))]
        found = self._errors.each([self._hypothesis(point) for point in points])
        here, *moved = map(self._white, found)
        return np.stack([(one - here) / h for one, h in zip(moved, step, strict=True)], axis=2)

    def solve(self, progress: Callable[[str], None], round_: int) -> None:
        """Fits the parameters, then lowers the weights of windows with unusually large errors."""
        count = len(self._places)

        def flat(z: np.ndarray) -> np.ndarray:
            white = self._residual(z).ravel()
            progress(f"round {round_ + 1} of {_ROUNDS}: {np.sqrt(np.mean(white**2)):.4g}")
            return white

        found = least_squares(
            flat,
            self._z,
            jac=lambda z: self._jacobian(z).reshape(-1, count),
            bounds=(self._lower, self._upper),
            x_scale="jac",
            ftol=1e-6,
            xtol=1e-6,
        )
        self._z = found.x
        square = np.mean(self._residual(self._z) ** 2, axis=1) / self._weight
        limit = self._problem.thresholds.robust_limit
        self._weight = robust_weight(square / max(float(np.median(square)), 1.0), limit)
        # The noise model is renewed, since errors of start states propagate by the fitted model.
        self._problem = self._problem.about(self._hypothesis(self._z))
        self._errors = Errors(self._problem, self._errors.unknowns, self._problem.fitted)
        self._early = self._half_a_step_early()

    def _covariance(self) -> np.ndarray:
        """Estimates the departures' covariance by parts of recordings, (parameters, parameters)."""
        jacobian, white = self._jacobian(self._z), self._residual(self._z)
        part = parts_of(self._errors.recording)
        bread = np.linalg.pinv(np.einsum("wip,wiq->pq", jacobian, jacobian))
        slopes = np.einsum("wip,wi->wp", jacobian, white)
        sums = np.stack([slopes[part == k].sum(axis=0) for k in range(int(part.max()) + 1)])
        few = len(sums) / max(len(sums) - 1, 1)
        # The covariance by sensor noise is added, so that no variance is smaller than by noise.
        return np.asarray(bread @ (few * sums.T @ sums) @ bread + bread)

    def told(self, began: float) -> ParameterFit:
        """Returns the fit with the errors and figures that its page shows."""
        problem, final = self._problem, self._hypothesis(self._z)
        values = [float(final[key][i]) for key, i in self._places]
        steps = np.array([p.step(v) for p, v in zip(self._rows, values, strict=True)])
        covariance = self._covariance() * np.outer(steps, steps)
        names = tuple(
            f"{key[1]}:{key[0]}.{p.name}"
            for (key, _), p in zip(self._places, self._rows, strict=True)
        )
        near = SAME * np.maximum(np.abs(self._z), 1.0)
        ends = (self._z <= self._lower + near) | (self._z >= self._upper - near)
        bound = [f"{name} ended at a bound" for name, end in zip(names, ends, strict=True) if end]
        told = result.Diagnosis(
            verdict="fitted",
            effects=self._effects(values, covariance),
            **errors_of(problem, Hypothesis(), final),
            not_testable=(),
            ranking=(),
            rivals=(),
            next_experiment=None,
            notes=(*notes(problem), *self._remarks, *bound),
            covariance=(names, covariance),
            rollouts=problem.replay.rollouts,
            seconds=perf_counter() - began,
        )
        return ParameterFit(told, problem, final)

    def _effects(
        self, values: Sequence[float], covariance: np.ndarray
    ) -> tuple[result.NamedEffect, ...]:
        """Returns the fitted effects with estimates of their parameters, without a confidence."""
        sites, parts = self._problem.library.sites, int(parts_of(self._errors.recording).max())
        half = float(student.ppf(0.975, max(parts, 1))) * np.sqrt(np.diag(covariance))
        estimates: dict[Key, list[result.Estimate]] = {}
        rows = zip(self._places, self._rows, self._ends, values, half.tolist(), strict=True)
        for (key, i), p, (lower, upper), value, h in rows:
            estimate = result.Estimate(
                name=p.name,
                unit=p.unit,
                value=value,
                nominal=float(sites[key].nominal[i]),
                interval=(max(lower, value - h), min(upper, value + h)),
            )
            estimates.setdefault(key, []).append(estimate)
        return tuple(
            result.NamedEffect(
                name=key[0],
                element=key[1],
                group=sites[key].effect.group,
                physics=sites[key].effect.physics,
                onset=(),
                confidence=np.nan,
                contribution=np.nan,
                parameters=tuple(own),
                indistinguishable_from=(),
            )
            for key, own in estimates.items()
        )
