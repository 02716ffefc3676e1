"""Moves of the search on pools made by hand: what each proposes, and when it does not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from leglab.diagnosis.likelihood.columns import Errors, trials
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import thinned
from leglab.diagnosis.search.moves import (
    another_point,
    balance,
    both_ways,
    finish,
    first_order,
    force_scale,
    neighbours,
    removal,
)
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.search.pool import Pool, Proposal, Scene
from leglab.diagnosis.search.rank import Compared, Ranked
from leglab.diagnosis.search.regression import Balanced
from leglab.diagnosis.search.renewal import renewed, wanted
from leglab.diagnosis.search.search import CAUSES, DESCRIPTION
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter
from leglab.diagnosis.thresholds import COARSE, FRUITLESS, HOPELESS, NEAR
from rigs import PENDULUM, Truth
from tests.helpers.unpleasant import of_kinds

EFFECTS = ("asymmetric_friction", "coulomb_friction", "viscous_friction", "payload", "armature")


@cache
def scene(aim=CAUSES):
    """Two recordings of a pendulum with four times its viscous friction, in a dozen windows."""
    logs = of_kinds(PENDULUM, Truth(viscous_factor=4.0), ("multisine", "fast"), seconds=2.0)
    problem = set_up(PENDULUM.model, logs, (), DiagnosisSettings(effects=EFFECTS, threads=1))
    at = Errors(problem, Unknowns.of(problem.library), thinned(problem.fitted, 12))
    fitter = Fitter(at, Priors())
    first = at.jumped(at.columns(COARSE), trials(at.unknowns))
    return Scene(fitter, aim, first, Compared(fitter))


def unknown(effect, at=0):
    """The place of an effect's first nameable parameters, by their order."""
    u = scene().fitter.at.unknowns
    own = [i for i in range(u.single) if u.keys[i][0] == effect and u.nameable[i]]
    return own[at]


def ranked(*effects, log=0.0, level=5.0, gain=0.0, **changes):
    """A fitted set where the model is as it is, with a log evidence and a level of one's own."""
    s = scene()
    members = tuple(e if isinstance(e, int) else unknown(e) for e in effects)
    spread, weight = s.fitter.about(s.first.errors)
    evidence = s.fitter.evidence(replace(s.first), spread, weight, 0.3)
    score = replace(evidence.score([(q, None) for q in members]), log=log)
    fit = Fit(
        members=members,
        keys=s.fitter.at.unknowns.names(members),
        columns=evidence.columns,
        spread=spread,
        weight=weight,
        score=score,
        level=level,
        ended=(),
        finished=True,
        unkept=0.0,
        gained=0.0,
    )
    return Ranked(replace(fit, **changes), evidence, score, gain)


def pool(*ranks, aim=CAUSES, **changes):
    """A pool of sets, the most probable first."""
    if all(r.fit.members for r in ranks):
        ranks = (*ranks, ranked(log=-40.0, level=9.0))
    made = Pool(scene(aim), 0.3, fits=tuple(r.fit for r in ranks), ranks=ranks)
    return replace(made, **changes)


def names(proposal):
    u = scene().fitter.at.unknowns
    return {u.keys[q][0] for q in proposal.candidate.members}


def test_first_order_promises_most_of_what_is_missing():
    s = scene()
    evidence, ranks, kappa = first_order.annealed(s.fitter, s.first, 0.3)
    found = first_order.candidates(evidence, ranks)
    alone = next(c for c in found if len(c.members) == 1)
    assert alone.members == (unknown("viscous_friction"),)
    assert found[0].promise == max(c.promise for c in found)
    assert found[0].promise > ranks[-1].log
    assert 0.0 < kappa <= 1.0


def test_the_right_set_leaves_noise_once_the_noise_is_taken_about_it():
    s, member = scene(), unknown("viscous_friction")
    start = Candidate((member,), {}, s.first, *s.fitter.about(s.first.errors))
    fit = s.fitter.fit(start, 0.3)
    nothing = ranked(level=9.0).fit
    old = Pool(s, 0.3, fits=(fit, nothing)).ranked()
    new = renewed(old)
    fitted, as_it_is = new.fits
    levels = (1.0, 5.0, 50.0)
    asked = [wanted(pool(ranked("viscous_friction", level=level))) for level in levels]
    assert asked == [False, True, False]
    assert not wanted(new)
    assert not fitted.finished
    assert as_it_is.finished
    fitter = new.scene.fitter
    there = fitter.at.at(fitted.columns.base)
    assert fitted.level == pytest.approx(fitter.level(there), rel=1e-9)
    (continued, *_) = finish.propose(new)
    again = fitter.fit(continued.candidate, 0.3, renewals=continued.renewals)
    assert again.level < 1.3


def test_balances_of_joints_are_sets_by_themselves_and_together():
    s = scene()
    spread, weight = s.fitter.about(s.first.errors)
    evidence = s.fitter.evidence(s.first, spread, weight, 0.3)

    def sets(found):
        return {frozenset(c.members) for c in balance.candidates(evidence, found)}

    one, two = Balanced({1: 2.0}, 5.0), Balanced({1: 2.0, 3: 1.0}, 9.0)
    assert sets({"knee": [one, two]}) == {frozenset({1}), frozenset({1, 3})}
    assert sets({"knee": [one], "hip": [Balanced({4: 1.0}, 2.0)]}) == {frozenset({1, 4})}
    assert sets({"knee": [Balanced({1: 2.0}, -1.0)]}) == set()


def test_what_may_lead_is_fitted_to_its_end_once():
    begun = ranked("viscous_friction", finished=False)
    proposal = next(finish.propose(pool(begun, ranked("payload", log=-1.0))))
    assert proposal.finishes is begun.fit
    assert names(proposal) == {"viscous_friction"}
    after = pool(begun).after(proposal, replace(begun.fit))
    assert begun.fit not in after.fits
    assert not list(finish.propose(replace(after, ranks=(replace(begun, fit=after.fits[0]),))))


@pytest.mark.parametrize("changes", [{"log": -1e4}, {"level": 5.0 * HOPELESS + 1.0}])
def test_what_is_far_behind_is_not_fitted_to_its_end(changes):
    begun = ranked("viscous_friction", finished=False, **changes)
    ahead = ranked("payload", finished=True, log=0.0)
    assert not list(finish.propose(pool(ahead, begun)))


def test_a_set_is_fitted_once_from_where_it_gains():
    other = ranked("payload", log=-1.0)
    late = replace(ranked("viscous_friction", gain=NEAR + 1.0), evidence=other.evidence)
    proposal = next(another_point.propose(pool(late, other)))
    assert proposal.candidate.columns is other.fit.columns
    assert not list(another_point.propose(pool(late, other, done=frozenset({proposal.once}))))
    little = replace(late, gain=NEAR - 1.0)
    assert not list(another_point.propose(pool(little, other)))


def test_forces_that_are_all_scaled_are_a_rival_where_none_is_known():
    s = scene()
    heavier, at = ranked("payload"), unknown("payload")
    x = heavier.fit.columns.x.copy()
    x[at] = 2.0
    made = pool(replace(heavier, fit=replace(heavier.fit, columns=replace(s.first, x=x))))
    assert not list(force_scale.propose(made))  # the motor's force is known
    own = np.zeros(s.fitter.at.unknowns.single)
    own[[at, unknown("viscous_friction")]] = 4.0, 4.0
    loose = replace(s)
    loose.__dict__["forces"] = own
    (proposal,) = force_scale.propose(replace(made, scene=loose))
    assert names(proposal) == {"viscous_friction"}
    assert proposal.candidate.start[unknown("viscous_friction")] == pytest.approx(-4.0 / 3.0)
    tried = frozenset({frozenset({unknown("viscous_friction")})})
    assert not list(force_scale.propose(replace(made, scene=loose, tried=tried)))


def test_both_directions_alike_are_one_effect():
    u = scene().fitter.at.unknowns
    pair = [i for i in range(u.single) if u.keys[i][0] == "asymmetric_friction" and u.nameable[i]]
    by_direction = ranked(*pair[:2])
    proposal = next(both_ways.propose(pool(by_direction)))
    assert names(proposal) == {"viscous_friction"}
    assert not list(both_ways.propose(pool(by_direction, done=frozenset({proposal.once}))))


def test_a_neighbour_adds_what_promises_most():
    proposal = next(neighbours.propose(pool(ranked(log=-1e4))))
    assert names(proposal) == {"viscous_friction"}
    assert proposal.candidate.promise > -1e4
    tried = pool(ranked(log=-1e4), tried=frozenset({frozenset(proposal.candidate.members)}))
    other = next(neighbours.propose(tried), None)
    assert other is None or names(other) != {"viscous_friction"}


def test_no_neighbour_is_proposed_that_promises_too_little():
    assert not list(neighbours.propose(pool(ranked("viscous_friction", log=1e6))))


def test_each_effect_is_taken_out_of_the_best_set_once():
    made = pool(ranked("viscous_friction", "payload"))
    proposals = list(removal.propose(made))
    assert [names(p) for p in proposals] == [{"viscous_friction"}, {"payload"}]
    made = replace(made, done=frozenset({proposals[0].once}))
    assert [names(p) for p in removal.propose(made)] == [{"payload"}]
    assert not list(removal.propose(pool(ranked("viscous_friction"))))


def test_a_search_gives_up_after_looks_in_vain():
    best = ranked("viscous_friction")
    made, far = pool(best), ranked("payload", log=-1e3)
    nothing = made.ranks[-1]
    look = Proposal(
        "neighbours",
        Candidate((1,), {}, best.fit.columns, best.fit.spread, best.fit.weight),
        "",
        late=True,
    )
    for _ in range(FRUITLESS - 1):
        made = replace(made.after(look, far.fit), ranks=(best, far, nothing))
        assert not made.exhausted
    made = replace(made.after(look, far.fit), ranks=(best, far, nothing))
    assert made.exhausted
    # A rival of the best one says that others may be near.
    near = ranked("payload", log=-1.0)
    made = replace(made.after(look, near.fit), ranks=(best, near, nothing))
    assert not made.exhausted


def test_a_description_ends_where_noise_is_left_and_a_cause_does_not():
    explained = ranked("viscous_friction", level=1.0)
    assert pool(explained, aim=DESCRIPTION).ended
    assert not pool(explained).ended
    assert not pool(ranked("viscous_friction", level=5.0), aim=DESCRIPTION).ended


def test_rivals_are_near_the_best_set_and_descriptions_are_not():
    best, behind = ranked("viscous_friction", level=1.0), ranked("payload", log=-2.0 * NEAR)
    assert pool(best, behind).near[:2] == [best, behind]
    assert pool(best, behind, aim=DESCRIPTION).near == [best]
