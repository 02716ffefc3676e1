"""All that a search knows: which sets were fitted, how they compare, what was tried and why."""

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
# Moves that look for other sets than those that are proposed at first.
FURTHER = ("both ways", "neighbours")


@dataclass(frozen=True, eq=False)
class Proposal:
    """A set that a move asks to fit."""

    move: str  #: Name of the move
    candidate: Candidate  #: The set and where its fit begins
    reason: str  #: Why, in words
    beside: bool = True  #: As of `Fitter.fit`
    renewals: int = 0  #: As of `Fitter.fit`
    finishes: Fit | None = None  #: The unfinished fit that this one replaces
    once: Hashable = None  #: What the move does not do again
    late: bool = False  #: Whether all that was proposed at first is done


@dataclass(frozen=True, eq=False)
class Step:
    """A proposal and what came of it."""

    proposal: Proposal
    fit: Fit


@dataclass(frozen=True)
class Aim:
    """What a search looks for.

    The causes of a change, with every rival of a good set; or any good description of recordings,
    where no rival of one is sought.
    """

    moves: tuple[Callable[["Pool"], Iterator[Proposal]], ...]  #: The earlier ones have precedence
    rivals: bool  #: Whether rivals are sought
    #: By so much a new set promises to be more probable than the best one [nats].
    ahead: float


@dataclass(frozen=True, eq=False)
class Scene:
    """What stays the same throughout a search."""

    fitter: Fitter
    aim: Aim
    first: Columns  #: Linearisation of the model as it is, with all trials
    compared: Compared
    #: Linearisations with an effect taken out, see `Errors.without`, by fit and effect.
    removed: dict[tuple[Fit, Key], Columns | None] = field(default_factory=dict)
    #: Linearisations of fits with jumps to limits.
    limited: dict[Fit, Columns] = field(default_factory=dict)

    @property
    def clear(self) -> bool:
        """Whether the model as it is leaves each recording noise alone."""
        return self.first.fine

    @cached_property
    def forces(self) -> np.ndarray:
        """Values of the specimen that a factor on all forces scales, see `own_forces`."""
        return own_forces(self.fitter.at.problem, self.fitter.at.unknowns)

    @cached_property
    def limits(self) -> list[Jump]:
        """Jumps of limits: a tangent shows one only where commands or forces come near it."""
        u = self.fitter.at.unknowns
        return [jump for jump in trials(u) if u.limits[jump[0]]]

    def without(self, fit: Fit, key: Key) -> Columns | None:
        """A fit with an effect taken out; None where its replay blows up."""
        if (fit, key) not in self.removed:
            made = self.fitter.at.without(fit.columns, fit.members, key)
            self.removed[fit, key] = made
        return self.removed[fit, key]

    def with_limits(self, fit: Fit) -> Columns:
        """A fit's linearisation with jumps to limits."""
        if fit not in self.limited:
            self.limited[fit] = self.fitter.at.jumped(fit.columns, self.limits)
        return self.limited[fit]

    def begins(self, one: Candidate) -> float:
        """Level of the errors where a fit would begin."""
        at = self.fitter.at
        return self.fitter.level(at.at(at.unknowns.moved(one.columns.base, one.start)))


@dataclass(frozen=True, eq=False)
class Pool:
    """Fitted sets and what was tried. Each step of a search makes another pool."""

    scene: Scene
    kappa: float  #: 1/design effect
    fits: tuple[Fit, ...] = ()
    steps: tuple[Step, ...] = ()
    tried: frozenset[Members] = frozenset({frozenset()})  #: Sets that have been proposed
    done: frozenset[Hashable] = frozenset()  #: What moves do once
    ranks: tuple[Ranked, ...] = ()  #: Sets by evidence, best first
    erring: Fit | None = None  #: The fit whose errors `kappa` is by
    vain: int = 0  #: Looks for another set in a row that found no rival of the best one

    def with_fit(self, fit: Fit) -> "Pool":
        """With a fit that nobody proposed."""
        return replace(self, fits=(*self.fits, fit), erring=self.erring or fit)

    def after(self, proposal: Proposal, fit: Fit) -> "Pool":
        """The pool after a proposal was fitted."""
        kept = tuple(f for f in self.fits if f is not proposal.finishes)
        done = {proposal.once, *([fit] if proposal.finishes else [])} - {None}
        return replace(
            self,
            fits=(*kept, fit),
            steps=(*self.steps, Step(proposal, fit)),
            tried=self.tried | {frozenset(proposal.candidate.members)},
            done=self.done | done,
            erring=self.erring or fit,
            vain=self.vain_now if proposal.late else self.vain,
        )

    def ranked(self) -> "Pool":
        """With all sets compared, by the errors of the fit that leaves least."""
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
        """The fit that leaves least."""
        return min(self.ranks, key=lambda r: r.fit.level).fit

    @property
    def give_up(self) -> float:
        """Level of the errors beyond which nothing is hoped for."""
        return HOPELESS * min((f.level for f in self.fits), default=np.inf)

    @cached_property
    def near(self) -> list[Ranked]:
        """Sets that may be the best one.

        What may lead is fitted to its end. While no set explains all, tangents are far from what
        will be found; so may a set no larger than the best one that leaves noise alone already.
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
        """Whether no other fitted set does as well there, or at its own fit, with fewer members."""
        at = self.scene.fitter.at
        there = there or self.scene.compared.evidence(fit, fit.spread, fit, self.kappa)
        less = without_idle(there, there.score([(q, None) for q in fit.members]), 0.0)
        names = at.unknowns.names(less.unknowns)
        return names == fit.keys or all(names != f.keys for f in self.fits)

    @property
    def sound(self) -> list[Ranked]:
        """Sets that are a yardstick: what ended at a bound would be another machine beyond it."""
        return [r for r in self.ranks if not r.fit.ended] or list(self.ranks)

    def knows(self, members: Members) -> bool:
        """Whether a set has been proposed, or is ruled out."""
        return members in self.tried or members in self.done

    @property
    def further(self) -> list[Step]:
        """Steps to other sets than those that were proposed at first, and than smaller ones."""
        return [s for s in self.steps if s.proposal.move in FURTHER]

    @cached_property
    def vain_now(self) -> int:
        """Looks in a row that found no rival of the best set, this one included."""
        last = self.further[-1].fit.keys if self.further else frozenset[Key]()
        top = self.best.score.log
        rival = last in {r.fit.keys for r in self.near if r.score.log > top - NEAR}
        return 0 if rival else self.vain + 1

    @property
    def exhausted(self) -> bool:
        """Whether further sets are no longer looked for."""
        return self.vain_now > FRUITLESS or len(self.further) >= FURTHER_FITS

    @property
    def ended(self) -> bool:
        """Whether nothing is left to be found.

        Near noise first order is exact: what is behind nothing stays there, and what is before it
        but hardly lessens the errors is not told. A description ends where noise is left.
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
    level: float  #: Of the model as it is
    onsets: np.ndarray | None = None  #: As `search` was given them

    @property
    def fitter(self) -> Fitter:
        """With which the sets were fitted."""
        return self.pool.scene.fitter

    @property
    def first(self) -> Columns:
        """Linearisation of the model as it is, with all trials."""
        return self.pool.scene.first

    @property
    def ranks(self) -> tuple[Ranked, ...]:
        """The sets."""
        return self.pool.ranks


def told(names: frozenset[Key]) -> str:
    """A set in a few words."""
    return " + ".join(f"{name} at {element}" for name, element in sorted(names)) or "nothing"
