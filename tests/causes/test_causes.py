"""One row a cause: names that exist, magnitudes by the healthy machine, and what a row makes."""

import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from leglab import RunSettings
from leglab.base.errors import LeglabError
from leglab.base.scenario import scenario_names, scenario_per_joint
from leglab.causes.record import model_values
from leglab.causes.table import CAUSES, effect_of, kind_of, live_of
from leglab.diagnosis.effects import all_effects
from leglab.machine.changes import healthy_values, parameter_units
from leglab.machine.simulation import Simulation, load_model
from leglab.runs.loop import Loop
from leglab.runs.preparation import prepared, scenario_of

ROOT = Path(__file__).parents[2]

# A user's bench: supply [Pa], oil [°C] and valve [Hz] are none of the shipped models'.
OWN = {"supply_pressure": 210e5, "oil_temperature": 55.0, "bandwidth_hz": 90.0}


def own(scenario, **settings):
    return RunSettings(scenario=scenario, model="knee_bench", parameters=OWN, **settings)


def test_every_name_of_a_row_exists():
    known = {effect.name for effect in all_effects()}
    for cause in CAUSES.values():
        assert set(cause.effect.split(" and ")) <= known | {""}
        assert set(cause.parameters) <= parameter_units().keys()
        assert bool(cause.summary) == (cause.name in scenario_names()) == (not cause.part_of)
        assert not cause.summary or scenario_per_joint(cause.name) == cause.per_joint
        # Where both use a name they mean the same.
        assert cause.name not in known or cause.name == cause.effect


def test_names_that_differ_are_found_both_ways():
    assert effect_of("seal_wear") == "internal_leakage"
    assert live_of("internal_leakage") == ("seal_wear",)
    assert effect_of("stiction") == effect_of("oil_temperature") == ""
    assert live_of("valve_deadband") == live_of("armature") == ()
    assert kind_of("valve_hysteresis") == kind_of("valve_wear")
    assert kind_of("seal_wear") == ("seal_wear",)


def test_benchmarks_have_other_magnitudes_than_the_bank_and_larger_ones():
    for cause in CAUSES.values():
        for side in cause.sides:
            healthy = cause.healthy_magnitude()
            bank, benchmark = (
                [abs(m - healthy) for m in cause.magnitudes(steps, healthy)]
                for steps in (side.bank, side.benchmark)
            )
            assert not set(bank) & set(benchmark), cause.name
            assert sorted(set(benchmark)) == benchmark, cause.name
            assert sorted(set(bank)) == bank, cause.name
            assert not bank or benchmark[-1] > bank[-1], cause.name


@pytest.mark.parametrize("model", ["leg", "knee_bench"])
def test_a_shipped_machine_is_healthy_where_a_machine_without_model_is(model):
    """`get_scenario` without a model and the pages speak of the shipped machines."""
    values = partial(healthy_values, Simulation(load_model(model, visual=False)))
    for cause in CAUSES.values():
        assert cause.healthy_magnitude(values) == cause.healthy_magnitude()


def test_healthy_values_are_the_models_of_the_elements_that_change():
    machine = prepared(RunSettings(scenario="", parameters={"knee_valve.bandwidth_hz": 90})).nominal
    slow = CAUSES["slow_valve"]
    assert slow.healthy_magnitude(partial(healthy_values, machine, joint="knee")) == 90.0
    assert slow.healthy_magnitude(partial(healthy_values, machine, joint="hip_yaw")) == 250.0
    # A magnitude is a fault of every valve.
    assert slow.healthy_magnitude(partial(healthy_values, machine)) == 90.0
    assert healthy_values(machine, "rust") == ()
    assert model_values("lap", lambda _: ()) == (0.02,)


@pytest.mark.parametrize(
    ("scenario", "allowed", "refused", "default", "bounds"),
    [
        ("supply_drop", 180.0, 211.0, 131.25, r"\[26.25, 210\]"),
        ("slow_valve", 60.0, 91.0, 14.4, r"\[1.8, 90\]"),
        ("cold_oil", 50.0, 56.0, 15.0, r"\[5, 55\]"),
        ("hot_oil", 56.0, 54.0, 95.0, r"\[55, 135\]"),
    ],
)
def test_magnitudes_of_a_scenario_follow_the_machine(scenario, allowed, refused, default, bounds):
    assert scenario_of(own(scenario, severity=allowed)).severity == allowed
    assert scenario_of(own(scenario)).severity == default
    with pytest.raises(LeglabError, match=f"severity {refused} is outside {bounds}"):
        scenario_of(own(scenario, severity=refused))


def test_oil_of_another_grade_counts_from_the_machines_own():
    """No grade of its own is a change, and leakage goes with the ratio to it."""
    thin = {"viscosity_40": 32e-6}
    settings = RunSettings(scenario="viscosity_change", model="knee_bench", parameters=thin)
    scenario = scenario_of(settings)
    assert scenario.severity == 68.0
    leak = next(c for c in scenario.changes if c.parameter == "internal_leakage")
    assert leak.value == pytest.approx(32 / 68)


def test_wear_mends_no_valve():
    """A valve of more overlap than the wear keeps it."""
    wide = {"lap": 0.05}
    settings = RunSettings(scenario="valve_wear", model="knee_bench", parameters=wide)
    for severity, lap in ((0.02, 0.05), (0.06, 0.06)):
        changes = scenario_of(RunSettings(**{**vars(settings), "severity": severity})).changes
        assert {c.parameter: c.value for c in changes} == {"lap": lap, "hysteresis": severity}


def test_names_of_a_users_machine_are_right():
    """Oil of 40 °C is colder than this machine's, and its bank has no faster valve than its own."""
    loop = Loop(own("cold_oil", severity=40.0, controller="bsnn_arx_bank", duration=16.0))
    loop.run()
    (event,) = loop.controller.events
    (name,) = event.names
    assert (name.fault, event.withdrawn) == ("cold_oil", None)
    assert name.low < 40.0 < name.high
    curves = {curve.fault: curve.sizes for curve in loop.controller.monitor._bank.curves}
    assert curves["slow_valve"].tolist() == [90.0, 36.0, 21.6, 14.4, 9.0]
    assert (curves["cold_oil"][0], curves["hot_oil"][0]) == (55.0, 55.0)
    assert curves["supply_drop"][0] == 210.0


PROGRAM = """
import json, sys
from leglab.causes.record import Cause, EffectRow, Side, Trials
from leglab.causes.table import CAUSES, add_cause
add_cause(Cause(
    "weak_pilot",
    "the spools lose half of their damping at half time",
    effect="valve_damping",
    parameters=("damping_ratio",),
    per_joint=True,
    meaning="damping ratio of the spools",
    healthy="damping_ratio",
    default=0.5,
    allowed=(0.05, 1.0),
    sides=(Side((0.5, 0.2), (0.7, 0.35, 0.1)),),
    effects=(EffectRow(
        "valve_damping", (Trials("damping_ratio", (0.3, 0.6), lower=0.05, upper=1.0),),
        group="valve and command", physics="zeta", source="a test", excitation="steps",
    ),),
))
import leglab.runs.fault_simulation as making
from leglab import RunSettings
from leglab.base.scenario import get_scenario
from leglab.cli.catalogue import catalogue_page, cause_rows
from leglab.diagnosis.effects import all_effects
from leglab.diagnosis.plant.model import Machine
from leglab.runs.loop import Loop
from benchmarks.adaptation_faults import faults
sys.path.insert(0, "docs/_tools")
from make_effect_table import markdown_table
from make_scenarios import index
(change,) = get_scenario("weak_pilot", element="knee").changes
bench = Machine("knee_bench")
(effect,) = (e for e in all_effects() if e.name == "valve_damping")
making.CAUSES = {"weak_pilot": CAUSES["weak_pilot"]}
settings = RunSettings(scenario="weak_pilot", model="knee_bench", controller="bsnn_arx_bank")
(curve,) = making.fault_bank(settings, get_scenario("weak_pilot"), Loop).curves
print(json.dumps({
    "scenario": [change.parameter, change.value],
    "bank": [curve.fault, curve.sizes.tolist()],
    "effect": effect.parameters(bench, "knee_valve")[0].trials,
    "benchmark": faults("knee_bench")["weak_pilot"],
    "list": cause_rows()[-1],
    "pages": [page.count("weak_pilot") for page in (catalogue_page(), index())],
    "effects page": markdown_table().count("`valve_damping`"),
}))
"""


def test_a_new_cause_is_one_row(tmp_path, monkeypatch):
    """It is a scenario, a curve of the bank, an effect, and in lists, tables and pages."""
    monkeypatch.setenv("LEGLAB_CACHE", str(tmp_path))
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert not done.returncode, done.stderr
    found = json.loads(done.stdout)
    healthy = 0.7
    assert found["scenario"] == ["damping_ratio", pytest.approx(0.5 * healthy)]
    assert found["bank"] == ["weak_pilot", pytest.approx([healthy, 0.35, 0.14])]
    assert found["effect"] == pytest.approx([0.3 * healthy, 0.6 * healthy])
    assert found["benchmark"] == pytest.approx([0.49, 0.245, 0.07])
    assert found["list"]["effect"] == "valve_damping"
    assert found["list"]["healthy"] == "0.7"
    assert all(found["pages"])
    assert found["effects page"] == 1
