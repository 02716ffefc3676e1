"""From recordings to fitted sets of effects: the problem, the specimen, the onset, the search."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from leglab.base.errors import ModelError
from leglab.base.recording import Recording
from leglab.base.threads import threads_allowed
from leglab.diagnosis.balance.balances import forces_left
from leglab.diagnosis.balance.units import unquestioned
from leglab.diagnosis.effects.base import Effect, EffectParameter
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.intake.admission import Admitted, admit
from leglab.diagnosis.intake.recordings import machine_for
from leglab.diagnosis.intake.series import UniformSeries, common_period
from leglab.diagnosis.likelihood.sizes import Shown, shown, sized
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.replay import at_replay_step
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.windows import channels
from leglab.diagnosis.search.healthy import Specimen, calibrate
from leglab.diagnosis.search.onset import onset_of
from leglab.diagnosis.search.pool import Found
from leglab.diagnosis.search.search import search
from leglab.diagnosis.thresholds import DEFAULT, NO_FAULT, Thresholds


@dataclass(frozen=True, kw_only=True)
class DiagnosisSettings:
    """Settings of a diagnosis.

    Attributes:
        effects: Names of the effects to consider; None for all.
        excluded: Names of effects to leave out.
        threads: Cores that replay; by default OMP_NUM_THREADS, or all where that is not set.
            Results do not depend on it.
        thresholds: Of all steps.
    """

    effects: tuple[str, ...] | None = None
    excluded: tuple[str, ...] = ()
    threads: int = field(default_factory=threads_allowed)
    thresholds: Thresholds = DEFAULT


def set_up(
    model: str | Path | Machine,
    recordings: Mapping[str, Recording],
    held_out: Iterable[str],
    settings: DiagnosisSettings,
) -> Problem:
    """Builds the fit problem of recordings by name; those in `held_out` are not fitted.

    Raises:
        LeglabError: Model or recordings do not fit each other, or are too short.
    """
    machine, limits = machine_for(model, recordings.values()), settings.thresholds
    admitted = unquestioned(machine, admit(machine, recordings, held_out, limits), limits)
    return _problem(machine, admitted, settings)


def _problem(
    machine: Machine,
    admitted: Admitted,
    settings: DiagnosisSettings,
    *,
    specimen: Mapping[Key, np.ndarray] | None = None,
    beside: Mapping[str, Recording] | None = None,
) -> Problem:
    """Builds the fit problem of admitted recordings.

    `specimen` has the parameter values of the recorded machine; None for the model's values. Only
    signals that the recordings `beside` also have are predicted, so that errors are comparable.
    """
    recordings, limits = admitted.recordings, settings.thresholds
    others = {f"beside {name}": other for name, other in (beside or {}).items()}
    together = {**recordings, **others}
    found = channels(machine, together, limits)
    period = common_period(together, limits)
    needed = tuple(dict.fromkeys([*(c.column for c in found), *machine.columns]))
    series = [
        UniformSeries.from_recording(r, name, needed, limits, period=period)
        for name, r in recordings.items()
    ]

    def posed(machine: Machine) -> Problem:
        return Problem(
            machine,
            Library(
                machine,
                names=settings.effects,
                excluded=settings.excluded,
                specimen=specimen,
                # Logs round times of samples and commands to the period, which hides short delays.
                shortest=float(period / np.sqrt(12.0)),
            ),
            series,
            found,
            [i for i, name in enumerate(recordings) if name not in admitted.held_out],
            threads=settings.threads,
            thresholds=limits,
        )

    problem = posed(at_replay_step(machine, period))
    if problem.blown and problem.machine.timestep > machine.file_timestep:
        # The cause may be a time step above the model file's, so the file's time step is tried.
        steps = int(np.ceil(period / machine.file_timestep - 1e-9))
        problem = posed(machine.at_timestep(period / steps))
    _check_stable(problem)
    return problem


def _check_stable(problem: Problem) -> None:
    """Refuses a model that is unstable at its own time step."""
    if not (joint := problem.blown):
        return
    machine = problem.machine
    drives = " and ".join(repr(a) for a in machine.actuators if joint in machine.driven[a])
    driven = f", driven by {drives}," if drives else ""
    helps = "; at half of it it does not" if problem.finer_helps else ""
    raise ModelError(
        f"{machine.path.name}: joint {joint!r}{driven} blows up in simulations of the model as it "
        f"is, at time steps of {machine.timestep:.4g} s{helps}; allowed: ",
        given=machine.timestep,
        allowed='a shorter timestep, integrator="implicitfast" or softer gains',
    )


def searched(
    model: str | Path | Machine,
    recordings: Mapping[str, Recording],
    held_out: Iterable[str],
    healthy: Mapping[str, Recording] | None,
    settings: DiagnosisSettings,
    progress: Callable[[str], None],
) -> tuple[Found, Specimen | None, tuple[str, ...]]:
    """Searches for the effects that a model lacks; arguments as in `diagnose`.

    Returns all fitted sets, the specimen identified from healthy recordings (None without these),
    and notes on all recordings.
    """
    limits = settings.thresholds
    machine = machine_for(model, [*recordings.values(), *(healthy or {}).values()])
    admitted = unquestioned(machine, admit(machine, recordings, held_out, limits), limits)
    if not healthy:
        problem = _problem(machine, admitted, settings)
        problem = _sized(problem, shown(problem))
        progress("looking for an onset")
        found = search(problem, onsets=onset_of(problem), log=progress)
        return found, None, admitted.notes
    earlier = unquestioned(machine, admit(machine, healthy, (), limits), limits)
    # The specimen (individual machine) may deviate in other effects than the user selects.
    whole = replace(settings, effects=None, excluded=())
    before = _problem(machine, earlier, whole, beside=admitted.recordings)
    later = _problem(machine, admitted, whole, beside=earlier.recordings)
    seen = shown(before).or_larger(shown(later))
    progress("calibration of the specimen")
    specimen = calibrate(_sized(before, seen), later, progress)
    problem = _problem(
        machine, admitted, settings, specimen=specimen.values, beside=earlier.recordings
    )
    problem = _sized(problem, seen)
    spread = specimen.spread.of_recordings(specimen.nearest(problem))
    found = search(problem, specimen.priors, spread, specimen.kappa, log=progress)
    return found, specimen, admitted.notes + earlier.notes


def _sized(problem: Problem, seen: Shown) -> Problem:
    """Scales trial values to recorded magnitudes; guesses shape parameters from residual forces."""
    sites = dict(sized(problem.library, problem.machine, seen).sites)
    guessing = {k: s for k, s in sites.items() if type(s.effect).guess is not Effect.guess}
    left = forces_left(problem, Hypothesis()) if guessing else {}
    for key, site in guessing.items():
        force, own = left.get(site.element), site.own
        values = force and site.effect.guess(force)
        if not values:
            continue
        parameters = tuple(
            replace(p, nominal=float(np.clip(values[p.name], p.lower, p.upper)))
            if p.role == "shape"
            else p
            for p in site.parameters
        )
        if own is not None:
            # If the specimen hardly has the effect, new recordings give its shape parameters.
            found = np.array([values[p.name] for p in parameters])
            if _most(parameters, own) >= NO_FAULT or _most(parameters, found) < NO_FAULT:
                continue
            own = np.array([p.nominal for p in parameters])
        sites[key] = replace(site, parameters=parameters, own=own)
    other = copy(problem)
    other.library = problem.library.with_sites(sites)
    return other


def _most(parameters: Sequence[EffectParameter], values: np.ndarray) -> float:
    """Returns the largest departure of the strengths from nominal, in smallest trials."""
    each = zip(parameters, values.tolist(), strict=True)
    return max(p.departure(v, p.nominal) for p, v in each if p.role == "strength")
