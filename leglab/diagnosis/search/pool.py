"""State of a search: fitted sets, their ranking, and the steps that were taken, with reasons."""

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import Columns, Jump, trials
from leglab.diagnosis.likelihood.evidence import Evidence
from leglab.diagnosis.likelihood.twins import own_forces
from leglab.diagnosis.replay.residual import lessens
from leglab.diagnosis.search.beam import without_idle
from leglab.diagnosis.search.rank import Compared, Ranked, rank
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter
from leglab.diagnosis.thresholds import (
    BEHIND,
    EXPLAINED,
    FRUITLESS,
    FURTHER_FITS,
    HOPELESS,
    NEAR,
    SMALL,
)

Members = frozenset[int]
# Names of the moves whose sets ("further sets") are limited in number, see `Pool.exhausted`.
FURTHER = ("both ways", "neighbours")


@dataclass(frozen=True, eq=False)
class Proposal:
    """A set of effects that a move proposes to fit."""

    move: str  #: Name of the move
    candidate: Candidate  #: The set, and the start of its fit
    reason: str  #: Reason in words
    beside: bool = True  #: Whether all parameters move from the first iteration, see `Fitter.fit`
    renewals: int = 0  #: Number of times that all tangents may be computed anew
    finishes: Fit | None = None  #: The unfinished fit that the fit of this proposal replaces
    once: Hashable = None  #: Key of a proposal that is made only once
    late: bool = False  #: Whether it counts as an attempt to find a rival of the best set


@dataclass(frozen=True, eq=False)
class Step:
    """Record of a set of effects that was fitted, without its linearisations."""

    move: str  #: Name of the move that proposed it
    reason: str  #: Reason in words
    keys: frozenset[Key]  #: Effects and elements of the set


@dataclass(frozen=True)
class Aim:
    """Purpose of a search: to find all rival causes, or one good description of recordings."""

    moves: tuple[Callable[["Pool"], Iterator[Proposal]], ...]  #: Moves in order of precedence
    rivals: bool  #: Whether rivals of good sets are fitted
    #: Smallest predicted log evidence, relative to the best set, for which a set is fitted [nats].
    ahead: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Constant part of a search, with caches of linearisations."""

    fitter: Fitter
    aim: Aim
    first: Columns  #: Linearisation of the unchanged model, with finite steps to all trial values
    compared: Compared
    #: Linearisations of fits without one effect, by fit and effect, see `Errors.without`.
    removed: dict[tuple[Fit, Key], Columns | None] = field(default_factory=dict)
    #: Linearisations of fits with changes by the finite steps `limits`, by fit.
    limited: dict[Fit, Columns] = field(default_factory=dict)

    @property
    def clear(self) -> bool:
        """Tests whether the errors of the unchanged model are noise in each recording."""
        return self.first.fine

    @cached_property
    def forces(self) -> np.ndarray:
        """Specimen's values that scale with all forces, e.g. inertia, see `own_forces`."""
        return own_forces(self.fitter.at.problem, self.fitter.at.unknowns)

    @cached_property
    def limits(self) -> list[Jump]:
        """Finite steps of limits, since the derivatives by a limit that is not reached are 0."""
        u = self.fitter.at.unknowns
        return [jump for jump in trials(u) if u.limits[jump[0]]]

    def without(self, fit: Fit, key: Key) -> Columns | None:
        """Linearises a fit without one effect; None if the replay blows up."""
        if (fit, key) not in self.removed:
            made = self.fitter.at.without(fit.columns, fit.members, key)
            self.removed[fit, key] = made
        return self.removed[fit, key]

    def with_limits(self, fit: Fit) -> Columns:
        """Adds the finite steps `limits` to the linearisation of a fit."""
        if fit not in self.limited:
            self.limited[fit] = self.fitter.at.jumped(fit.columns, self.limits)
        return self.limited[fit]

    def begins(self, one: Candidate) -> float:
        """Computes the median error at the start of a fit, in noise levels."""
        at = self.fitter.at
        return self.fitter.level(at.at(at.unknowns.moved(one.columns.base, one.start)))


@dataclass(frozen=True, eq=False)
class Pool:
    """Fitted sets and the steps of a search. A pool is immutable: each step returns a new pool."""

    scene: Scene
    kappa: float  #: Factor on log likelihoods, 1/design effect
    fits: tuple[Fit, ...] = ()
    steps: tuple[Step, ...] = ()
    tried: frozenset[Members] = frozenset({frozenset()})  #: Sets that moves have proposed
    done: frozenset[Hashable] = frozenset()  #: Keys of proposals that are made once
    ranks: tuple[Ranked, ...] = ()  #: Sets by evidence, best first
    erring: Fit | None = None  #: Fit from whose errors `kappa` was estimated
    vain: int = 0  #: Number of consecutive attempts without a rival of the best set

    def with_unchanged(self, fit: Fit) -> "Pool":
        """Adds the fit of the empty set."""
        step = Step("first order", "the model as it is", fit.keys)
        steps = (*self.steps, step)
        return replace(self, fits=(*self.fits, fit), steps=steps, erring=self.erring or fit)

    def after(self, proposal: Proposal, fit: Fit) -> "Pool":
        """Adds the fit of a proposal."""
        kept = tuple(f for f in self.fits if f is not proposal.finishes)
        done = {proposal.once, *([fit] if proposal.finishes else [])} - {None}
        return replace(
            self,
            fits=(*kept, fit),
            steps=(*self.steps, Step(proposal.move, proposal.reason, fit.keys)),
            tried=self.tried | {frozenset(proposal.candidate.members)},
            done=self.done | done,
            erring=self.erring or fit,
            vain=self.vain_now if proposal.late else self.vain,
        )

    def ranked(self) -> "Pool":
        """Ranks all sets, with `kappa` from the errors of the fit with the smallest errors."""
        compared = self.scene.compared
        ranks, kappa = rank(compared, self.fits, self.kappa), self.kappa
        least = min(ranks, key=lambda r: r.fit.level)
        if least.fit is not self.erring:
            kappa = 1.0 / max(least.evidence.design_effect(least.score), 1.0)
            ranks = rank(compared, self.fits, kappa)
        return replace(self, ranks=tuple(ranks), kappa=kappa, erring=least.fit)

    @property
    def best(self) -> Ranked:
        """The most probable set."""
        return self.ranks[0]

    @cached_property
    def least(self) -> Fit:
        """The fit with the smallest median error."""
        return min(self.ranks, key=lambda r: r.fit.level).fit

    @property
    def give_up(self) -> float:
        """Median error above which a fit is abandoned, in noise levels."""
        return HOPELESS * min((f.level for f in self.fits), default=np.inf)

    @cached_property
    def near(self) -> list[Ranked]:
        """Sets that may turn out to be better than the best set.

        Their evidence is at most `BEHIND * NEAR` below the best set's. While no set explains the
        recordings, the margin grows with the best set's gain over the empty set, because the errors
        of predicted gains are relative. Sets as small as the best that leave only noise are near.
        """
        top, rivals = self.best.score.log, self.scene.aim.rivals
        behind = BEHIND * NEAR if rivals else 0.0
        if rivals and not self.scene.fitter.explains(self.least):
            nothing = next(r.score.log for r in self.ranks if not r.fit.members)
            behind += SMALL * (top - nothing)
        small, noise = len(self.best.fit.members), EXPLAINED
        return [
            r
            for r in self.ranks
            if r.score.log + r.fit.gained >= top - behind
            or (rivals and r.fit.level <= noise and len(r.fit.members) <= small)
        ]

    def needed(self, fit: Fit, there: Evidence | None = None) -> bool:
        """Tests whether all effects of a fit contribute, or the contributing subset is not fitted.

        `there` is the evidence by which an effect contributes; None for the evidence at the fit.
        """
        at = self.scene.fitter.at
        there = there or self.scene.compared.evidence(fit, fit.spread, fit, self.kappa)
        less = without_idle(there, there.score([(q, None) for q in fit.members]), 0.0)
        names = at.unknowns.names(less.unknowns)
        return names == fit.keys or all(names != f.keys for f in self.fits)

    @property
    def sound(self) -> list[Ranked]:
        """Sets without a parameter at a bound; all sets if each has one."""
        return [r for r in self.ranks if not r.fit.ended] or list(self.ranks)

    def knows(self, members: Members) -> bool:
        """Tests whether a set has been proposed or ruled out."""
        return members in self.tried or members in self.done

    @property
    def further(self) -> list[Step]:
        """Records of the sets that the moves in `FURTHER` proposed."""
        return [s for s in self.steps if s.move in FURTHER]

    @cached_property
    def vain_now(self) -> int:
        """Value of `vain` after the last further set; 0 if that set is a rival of the best set."""
        last = self.further[-1].keys if self.further else frozenset[Key]()
        top = self.best.score.log
        rival = last in {r.fit.keys for r in self.near if r.score.log > top - NEAR}
        return 0 if rival else self.vain + 1

    @property
    def exhausted(self) -> bool:
        """Tests whether enough further sets were fitted, or too many in a row were no rivals."""
        return self.vain_now > FRUITLESS or len(self.further) >= FURTHER_FITS

    @property
    def ended(self) -> bool:
        """Tests whether the search can stop.

        If the unchanged model leaves only noise, linearised evidence is exact, so the search stops
        if the empty set is the best or no fit clearly lessens the errors. A search without rivals
        stops when the best set leaves only noise.
        """
        fitter, best = self.scene.fitter, self.best.fit
        if self.scene.clear:
            least = min(fitter.rms(f.columns.errors) for f in self.fits)
            if not best.members or not lessens(fitter.rms(self.scene.first.errors), least):
                return True
        return not self.scene.aim.rivals and fitter.explains(best)


@dataclass(frozen=True, eq=False)
class Found:
    """All fitted sets, best first."""

    pool: Pool
    level: float  #: Median error of the unchanged model, in noise levels
    onsets: np.ndarray | None = None  #: Times [s] at which missing effects begin, see `search`

    @property
    def fitter(self) -> Fitter:
        """The fitter of all sets."""
        return self.pool.scene.fitter

    @property
    def first(self) -> Columns:
        """Linearisation of the unchanged model, with finite steps to all trial values."""
        return self.pool.scene.first

    @property
    def ranks(self) -> tuple[Ranked, ...]:
        """Sets by evidence, best first."""
        return self.pool.ranks


def in_words(names: frozenset[Key]) -> str:
    """Lists the effects of a set with their elements."""
    return " + ".join(f"{name} at {element}" for name, element in sorted(names)) or "nothing"
