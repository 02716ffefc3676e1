"""The diagnosis as a whole: three seconds of recordings of the bench, and its parts."""

import gc
import json
import shutil
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.cli import main
from leglab.diagnosis.balance.balances import forces_left
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.improve import improved_model
from leglab.diagnosis.intake.admission import admit
from leglab.diagnosis.intake.recordings import held_out_choice, read_recordings, split_held_out
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.twins import twins
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.plant.model import Change, Machine
from leglab.diagnosis.replay.residual import thinned
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.thresholds import Thresholds
from leglab.diagnosis.verdict.experiment import excitations, propose
from leglab.diagnosis.verdict.output import write_diagnosis
from leglab.diagnosis.verdict.verdict import diagnose
from tests.helpers.patched_models import reloaded_error
from tests.helpers.unpleasant import BENCH, of_bench

# Few effects keep the tests short; those of valve, seals, mechanics and sensing are among them.
EFFECTS = ("valve_deadband", "valve_bias", "internal_leakage", "payload", "command_delay")
DEADBAND = ("valve_deadband", "knee_valve")
DELAY = ("command_delay", "knee_valve")
TRUE_LAP = 0.065  # truth.toml of d2


def diagnosed(case, effects=EFFECTS, threads=1):
    settings = DiagnosisSettings(effects=effects, threads=threads)
    return diagnose("knee_bench", of_bench(case), held_out=("walk",), settings=settings)


def problem_of(recordings, threads=1, **settings):
    settings = DiagnosisSettings(effects=EFFECTS, threads=threads, **settings)
    return set_up("knee_bench", recordings, ("walk",), settings)


@pytest.fixture(scope="module")
def deadband():
    return diagnosed("d2")


@pytest.fixture(scope="module")
def problem():
    return problem_of(of_bench("nominal"))


def test_hidden_deadband_is_named_with_its_size(deadband):
    result, _ = deadband
    assert result.verdict == "named"
    assert [e.name for e in result.effects] == ["valve_deadband"]
    (lap,) = result.effects[0].parameters
    assert lap.value == pytest.approx(TRUE_LAP, rel=2e-3)
    assert lap.nominal == 0.02
    assert result.gap.closed_fraction > 0.9
    assert result.gap.after < 1.2
    assert [r.name for r in result.recordings if r.held_out] == ["walk"]


def test_hydraulics_disagree_and_the_mechanism_does_not(deadband):
    levels = {w.residual: w.level for w in deadband[0].where}
    assert levels["hydraulic"] > 5.0 * levels["mechanical"]


def test_json_holds_the_contract(deadband, tmp_path):
    content = json.loads(write_diagnosis(deadband[0], tmp_path).read_text())
    assert content["verdict"] == "named"
    (effect,) = content["effects"]
    assert effect["onset"] is None
    assert effect["indistinguishable_from"] == []
    lap = effect["parameters"]["lap"]
    assert lap["interval"][0] <= lap["value"] <= lap["interval"][1]
    assert set(content["gap"]) >= {"metric", "noise_floor", "before", "after", "closed_fraction"}
    assert content["gap"]["held_out"] == ["walk"]


def test_improved_model_runs_and_replays_as_the_fit(deadband, tmp_path):
    better = improved_model(deadband[1])
    path = better.write(tmp_path)[0]
    model = mujoco.MjModel.from_xml_path(str(path))
    mujoco.mj_step(model, mujoco.MjData(model), 100)
    assert 'key="lap"' in path.read_text()
    # Of a noise level: MJCF is written with few digits.
    assert reloaded_error(better.problem, better.hypothesis, path) < 0.1


def test_nothing_is_missing_on_the_nominal_bench():
    result, _ = diagnosed("nominal")
    assert result.verdict == "nothing_missing"
    assert result.effects == ()
    assert result.gap.after < 1.2


@pytest.mark.slow("a second whole diagnosis")
def test_an_effect_that_the_library_lacks_is_not_called_for_sure():
    result, _ = diagnosed("d2", ("payload", "entrained_air", "command_delay"))
    assert result.verdict == "unexplained"
    assert all(e.confidence < 0.5 for e in result.effects)


def test_errors_of_a_good_model_are_white(problem):
    cost = problem.window_cost(Hypothesis())
    assert 0.7 < cost.mean() < 1.3


def test_every_effect_at_its_nominal_values_changes_nothing():
    machine = Machine("knee_bench", timestep=1e-3)
    library = Library(machine)
    for key, site in library.sites.items():
        change = library.change({key: site.nominal}, machine)
        assert not change.corrections, key
        variant = machine.variant(tuple(change.edits))
        state = variant.plugin_state.copy()
        for (element, name), value in change.parameters.items():
            state[variant.slot(element, name)] = value
        for element, (start, table) in machine.base.elements.items():
            place = variant.elements[element][0]
            count = len(table.parameters)
            base = machine.base.plugin_state[start : start + count]
            np.testing.assert_allclose(state[place : place + count], base, rtol=1e-12)
        for path in change.commands.get("knee_valve", ()):
            samples = np.sin(np.arange(50.0))
            np.testing.assert_allclose(path(samples, 1e-3), samples, atol=1e-12)


def test_thresholds_can_be_varied(problem):
    shorter = replace(Thresholds(), window=0.2, robust_limit=1e9)
    other = problem_of(of_bench("nominal"), thresholds=shorter)
    assert (problem.replay.samples, other.replay.samples) == (300, 200)
    squares = np.mean(other.residual(Hypothesis()) ** 2, axis=1)
    np.testing.assert_array_equal(other.window_cost(Hypothesis()), squares)


def test_windows_before_an_onset_replay_without_the_effect(problem):
    hypothesis = Hypothesis({DEADBAND: np.array([0.08])})
    healthy = problem.residual(Hypothesis())
    ill = problem.residual(hypothesis)
    late = problem.residual(hypothesis.with_onset(DEADBAND, np.full(3, 1.5)))
    start = problem.replay.start
    before, after = start + 0.3 <= 1.5, start >= 1.5
    np.testing.assert_array_equal(late[before], healthy[before])
    np.testing.assert_array_equal(late[after], ill[after])
    assert (late[~before & ~after] == 0.0).all()


def test_threads_do_not_change_a_bit(problem):
    other = problem_of(of_bench("nominal"), threads=2)
    hypothesis = Hypothesis({DELAY: np.array([0.0035])})
    np.testing.assert_array_equal(problem.residual(hypothesis), other.residual(hypothesis))


class Collects:
    """A hypothesis on whose way to another process everything unused is freed there."""

    def __reduce__(self):
        return collected, ()


def collected():
    gc.collect()
    return Hypothesis()


def test_a_process_does_not_end_the_threads_of_an_earlier_diagnosis():
    gc.disable()
    try:
        earlier = [problem_of(of_bench("nominal"), threads=2)]
        earlier.append(earlier)  # only the collection of garbage frees it
        del earlier
        problem = problem_of(of_bench("nominal"), threads=2)
        at = Errors(problem, Unknowns.of(problem.library), thinned(problem.fitted, 4))
        first, second = at.each([Collects(), Collects()])
    finally:
        gc.enable()
    np.testing.assert_array_equal(first, at.at(Hypothesis()))
    np.testing.assert_array_equal(first, second)


def test_held_out_recording_lies_within_the_others():
    machine = Machine("knee_bench")
    assert held_out_choice(of_bench("nominal"), machine) in (("multisine",), ("slow",))


def test_a_single_recording_keeps_its_end_for_the_judgement():
    whole = {"walk.parquet": of_bench("nominal")["walk"]}
    parts, held = split_held_out("knee_bench", whole, [])
    assert held == ("walk.parquet (end)",)
    assert sum(len(r) for r in parts.values()) == len(whole["walk.parquet"])


def test_recordings_of_another_machine_list_both_sides():
    stranger = {"a": of_bench("nominal")["walk"].select(["knee_position"])}
    with pytest.raises(LeglabError, match=r"knee_valve_command.*the recording has knee_position"):
        set_up("knee_bench", stranger, (), DiagnosisSettings())


def test_unknown_held_out_recording_is_an_error():
    with pytest.raises(LeglabError, match="unknown recording 'trot'"):
        split_held_out("knee_bench", of_bench("nominal"), ["trot"])


def test_gaps_leave_out_windows_only(problem):
    broken = of_bench("nominal")
    walk = broken["walk"]
    position = walk["knee_position"].copy()
    position[1000:1050] = np.nan
    broken["walk"] = walk.with_columns({"knee_position": position})
    other = problem_of(broken)
    lost = problem.replay.windows - other.replay.windows
    assert 1 <= lost <= 3
    assert other.window_cost(Hypothesis()).mean() < 1.3


def test_effects_compose_on_one_parameter():
    machine = Machine("knee_bench", timestep=1e-3)
    library = Library(machine)
    keys = ("coulomb_friction", "knee_valve"), ("stiction", "knee_valve")
    values = np.array([160.0]), np.array([250.0, 0.014, 2.0])
    change = library.change(dict(zip(keys, values, strict=True)), machine)
    assert isinstance(change, Change)
    assert change.parameters["knee_valve", "coulomb"] == 160.0
    assert change.parameters["knee_valve", "static"] == 150.0 + 60.0 + 100.0


def test_proposed_experiment_separates_the_rivals_better_than_another(problem):
    rivals = {
        "valve_bias": Hypothesis({("valve_bias", "knee_valve"): np.array([0.004])}),
        "command_delay": Hypothesis({DELAY: np.array([0.002])}),
    }
    proposal = propose(problem, rivals)
    assert proposal is not None
    assert proposal.rivals == ("valve_bias", "command_delay")
    assert proposal.separation > 100.0
    assert proposal.name in excitations(10, 1e-3)


def test_degrees_and_bars_are_refused_with_a_hint():
    machine = Machine("knee_bench")
    walk = of_bench("nominal")["walk"]
    degrees = walk.with_columns({"knee_position": np.rad2deg(walk["knee_position"])})
    with pytest.raises(LeglabError, match=r"'knee_position' covers .* is it in degrees\?"):
        admit(machine, {"walk": degrees})
    bars = walk.with_columns({"knee_pressure_a": 1e-5 * walk["knee_pressure_a"]})
    with pytest.raises(LeglabError, match=r"'knee_pressure_a' stays below .* in bar\?"):
        admit(machine, {"walk": bars})


def test_saturation_and_gaps_are_noted():
    machine = Machine("knee_bench")
    walk = of_bench("nominal")["walk"]
    assert admit(machine, {"walk": walk}).notes == ()
    pressure = np.minimum(walk["knee_pressure_a"], np.quantile(walk["knee_pressure_a"], 0.9))
    position = walk["knee_position"].copy()
    position[100:110] = np.nan
    bad = walk.with_columns({"knee_pressure_a": pressure, "knee_position": position})
    notes = admit(machine, {"walk": bad}).notes
    assert any("saturated" in note and "'knee_pressure_a'" in note for note in notes)
    assert any("without a number: 'knee_position' 10" in note for note in notes)


def test_too_short_recordings_are_refused():
    short = {n: r.between(0.0, 0.25) for n, r in of_bench("nominal").items()}
    with pytest.raises(LeglabError, match="no window of 0.3 s fits"):
        set_up("knee_bench", short, (), DiagnosisSettings())


def test_a_column_map_renames_and_converts(tmp_path):
    walk = of_bench("nominal")["walk"]
    others = {name: walk[name] for name in walk.columns if name != "knee_position"}
    other = Recording(time=walk.time, columns={**others, "enc": np.rad2deg(walk["knee_position"])})
    data.write(other, tmp_path / "a.parquet")
    (tmp_path / "map.toml").write_text(
        '[columns]\nenc = {name = "knee_position", factor = 0.017453292519943295}\n'
    )
    read = read_recordings([tmp_path / "a.parquet"], tmp_path / "map.toml")["a.parquet"]
    np.testing.assert_allclose(read["knee_position"], walk["knee_position"], rtol=1e-12)
    (tmp_path / "map.toml").write_text("[columns]\nenc = 3\n")
    with pytest.raises(LeglabError, match="column 'enc' is 3; allowed"):
        read_recordings([tmp_path / "a.parquet"], tmp_path / "map.toml")


def test_command_line_writes_verdict_and_model_on_all_cores(deadband, tmp_path, capsys):
    files = []
    for name in of_bench("d2"):
        files.append(str(shutil.copy(BENCH / f"d2_{name}.parquet", tmp_path / f"{name}.parquet")))
    options = ["--held-out", "walk", "--out", str(tmp_path / "out")]
    for effect in EFFECTS:
        options += ["--effect", effect]
    main(["diagnose", "knee_bench", *files, *options])
    shown = capsys.readouterr().out
    assert "verdict: named" in shown
    assert "hydraulic balance of knee_valve" in shown
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert content["model"] == "improved.xml"
    # On one thread or on all cores, with files or in memory: the same numbers.
    alone = json.loads(write_diagnosis(deadband[0], tmp_path).read_text())
    again = json.loads(json.dumps(content).replace(".parquet", ""))
    for key in ("model", "changed"):  # of an improved model, which is not written for `alone`
        del alone[key], again[key]
    assert again == alone
    mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "improved.xml"))


def test_without_pressures_a_late_command_and_a_late_sensor_are_one():
    settings = DiagnosisSettings(effects=("command_delay", "sensor_delay", "payload"), threads=1)
    whole = of_bench("nominal")
    blind = {
        name: log.select([c for c in log.columns if "_pressure_" not in c])
        for name, log in whole.items()
    }
    seen, unseen = (set_up("knee_bench", logs, (), settings) for logs in (whole, blind))
    assert twins(unseen, DELAY) == (("sensor_delay", "knee"),)
    assert twins(unseen, ("sensor_delay", "knee")) == (DELAY,)
    assert twins(unseen, ("payload", "shank")) == ()
    assert twins(seen, DELAY) == ()
    assert set(forces_left(seen, Hypothesis())) == {"knee"}
    assert forces_left(unseen, Hypothesis()) == {}
