"""Diagnosis of leglab's own legs: recordings of `leglab run`, 500 Hz, truth columns in them."""

from functools import cache

import numpy as np
import pytest

from leglab.base.errors import LeglabError
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.effects.spring import rest_position
from leglab.diagnosis.intake.recordings import read_recordings, split_held_out
from leglab.diagnosis.likelihood.sizes import shown, sized
from leglab.diagnosis.plant.model import Machine, moved
from leglab.diagnosis.replay.replay import at_replay_step
from leglab.diagnosis.replay.windows import channels
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.verdict.notes import notes, touching_share
from leglab.diagnosis.verdict.verdict import diagnose
from leglab.runs.preparation import RunSettings
from leglab.runs.run import run_scenario

LEGS = {"leg": "random_stride", "leg_rail": "squat"}
# Few effects keep the tests short, one of each kind.
EFFECTS = ("internal_leakage", "payload", "command_delay", "viscous_friction", "encoder_offset")


@cache
def recording(model, seed, *, duration=4.0, timestep=None, reference=None):
    settings = RunSettings(
        scenario="nominal",
        controller="pd",
        model=model,
        reference=reference or LEGS.get(model, "random_stride"),
        duration=duration,
        seed=seed,
        timestep=timestep,
    )
    return run_scenario(settings).recording


def problem(model, recordings):
    return set_up(model, recordings, (), DiagnosisSettings(effects=EFFECTS, threads=1))


@pytest.mark.parametrize("model", ["leg", "leg_rail", "leg_motor"])
def test_rounding_of_moments_drives_no_joint(model):
    machine = Machine(model)
    for actuator, joints in machine.driven.items():
        assert joints == (actuator.removesuffix("_valve"),)


def test_an_actuator_across_two_joints_drives_both():
    assert moved(np.array([0.03, -1e-17, 0.0, 2e-4])).tolist() == [0, 3]
    assert moved(np.zeros(3)).tolist() == []


@pytest.mark.parametrize("model", LEGS)
def test_every_cylinder_is_compared_with_its_own_pressures(model):
    found = channels(Machine(model), {"one": recording(model, 1)})
    for channel in found:
        if channel.cylinder:
            assert channel.column.startswith(channel.cylinder.removesuffix("_valve"))


def test_replays_take_the_longest_step_that_the_model_accepts():
    leg = Machine("leg")
    with pytest.raises(LeglabError, match="too long"):
        leg.at_timestep(2e-3)
    assert at_replay_step(leg, 2e-3).timestep == pytest.approx(1e-3)
    bench = Machine("knee_bench")  # whose step is 0.5 ms
    assert at_replay_step(bench, 1e-3).timestep == pytest.approx(1e-3)
    assert at_replay_step(bench, 4e-3).timestep == pytest.approx(1e-3)


_more = pytest.mark.slow("more steps of the same leg")


@pytest.mark.parametrize(
    ("model", "timestep"),
    [
        ("leg", None),
        ("leg_rail", None),
        ("leg_motor", None),
        pytest.param("leg", 1e-4, marks=_more),
        pytest.param("leg_motor", 5e-4, marks=_more),
        pytest.param("leg_motor", 1e-4, marks=_more),
    ],
)
def test_the_unmodified_leg_explains_its_recordings(model, timestep):
    """At the model's own step, as a user records it, and at a tenth, as a machine would."""
    found = problem(model, {"one": recording(model, 1, timestep=timestep)})
    cost = found.window_cost(Hypothesis())
    assert 0.7 < np.median(cost) < 1.3
    # Also while the sole is on the ground, whose friction says nothing of bristles at rest.
    assert np.quantile(cost, 0.95) < 1.6


@pytest.mark.slow("the whole library on a leg that touches the ground")
def test_nothing_is_missing_where_nothing_is_hidden_beside_a_contact():
    recordings = {f"{i}": recording("leg_rail", i, duration=8.0) for i in (1, 2, 3)}
    result, _ = diagnose("leg_rail", recordings, settings=DiagnosisSettings(threads=1))
    assert result.verdict == "nothing_missing"


def test_no_spring_is_tried_that_pushes_harder_than_anything_recorded():
    """A hip that holds a small angle: a spring's force goes by the angle, not by what it moves."""
    one = recording("leg_rail", 1, duration=2.0)
    found = problem("leg_rail", {"one": one})
    seen = shown(found)
    library = sized(Library(found.machine), found.machine, seen)
    tried = 0
    for (name, joint), site in library.sites.items():
        orders = {"spring_stiffness": 1, "spring_hardening": 3}
        if name not in orders or found.machine.spring_of(joint):
            continue
        bent = one[f"{joint}_position"] - rest_position(found.machine, joint)
        force = site.parameters[0].trials[-1] * np.abs(bent) ** orders[name]
        assert force.max() < 0.5 * seen.joints[joint].force
        tried += 1
    assert tried >= 4


def test_bounds_reach_what_recordings_allow_and_rests_the_whole_travel():
    """Friction may take drive, weight and inertia together; a spring may rest beyond the motion."""
    found = problem("leg_rail", {"one": recording("leg_rail", 1, duration=2.0)})
    seen = shown(found)
    given = Library(found.machine)
    sites = sized(given, found.machine, seen).sites
    rests = [key for key in sites if key[0] == "spring_offset"]
    forces = [key for key in sites if key[0] == "force_offset"]
    assert rests
    assert forces
    for key in rests:
        own, travel = sites[key].parameters[0], given.sites[key].parameters[0]
        assert (own.lower, own.upper) == (travel.lower, travel.upper)
    for key in forces:
        largest = seen.joints[key[1]].force
        assert sites[key].parameters[0].upper == pytest.approx(3.0 * largest)


def test_windows_start_at_the_supply_pressure_of_that_moment():
    """Six valves on one pump: it falls by several bar, which no column of the diagnosis says."""
    one = recording("leg", 1)
    found = problem("leg", {"one": one})
    replay = found.replay
    change = found.library.change({}, found.machine)
    starts = replay._starts(change, list(replay._parts(change, None)))
    slot = starts.shape[1] - change.variant.model.npluginstate
    slot += change.variant.slot("supply", "pressure")
    true = np.interp(replay.start, one.time, one["supply_pressure"])
    assert np.ptp(true) > 3e5
    np.testing.assert_allclose(starts[:, slot], true, atol=0.1 * np.ptp(true))


def test_columns_of_the_truth_are_not_used():
    def falsified(one):
        machine = Machine("leg")
        used = {c.column for c in channels(machine, {"one": one})} | set(machine.columns)
        rng = np.random.default_rng(5)
        others = {name: rng.normal(size=len(one)) for name in one.columns if name not in used}
        assert {"knee_truth", "knee_truth_velocity", "knee_spool", "supply_pressure"} <= set(others)
        return one.with_columns(others)

    one = recording("leg", 1, duration=2.0)
    honest, lied_to = (
        problem("leg", {"one": r}).residual(Hypothesis()) for r in (one, falsified(one))
    )
    np.testing.assert_array_equal(honest, lied_to)


def test_recordings_of_several_runs_go_by_their_folders(tmp_path):
    from leglab import data

    for seed in (1, 2):
        (tmp_path / f"seed{seed}").mkdir()
        data.write(recording("leg", seed), tmp_path / f"seed{seed}" / "recording.parquet")
    paths = [tmp_path / f"seed{seed}" / "recording.parquet" for seed in (1, 2)]
    found = read_recordings(paths)
    assert list(found) == ["seed1/recording.parquet", "seed2/recording.parquet"]
    for wanted in (str(paths[1]), "seed2", "seed2/recording", "seed2/recording.parquet"):
        assert split_held_out("leg", found, [wanted])[1] == ("seed2/recording.parquet",)
    with pytest.raises(LeglabError, match="unknown recording 'recording'"):
        split_held_out("leg", found, ["recording"])
    with pytest.raises(LeglabError, match="two recordings are called"):
        read_recordings([paths[0], paths[0]])


def test_joints_that_nothing_drives_are_recorded_as_they_are_measured():
    one = recording("leg_rail", 1)
    off = one["rail_position"] - one["rail_truth"]
    assert 1e-5 < off.std() < 4e-5


@pytest.mark.parametrize(("model", "share"), [("leg", 0.0), ("leg_rail", 1.0)])
def test_contacts_are_noted(model, share):
    one = recording(model, 1)
    found = problem(model, {"one": one})
    assert touching_share(found.machine, found.series) == pytest.approx(share, abs=0.1)
    assert any("touches something" in note for note in notes(found)) == bool(share)
