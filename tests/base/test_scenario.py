import math
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import leglab.scenarios
from leglab.base import scenario as module
from leglab.base.errors import LeglabError
from leglab.base.registry import Registry
from leglab.base.scenario import (
    Options,
    ParameterChange,
    Scenario,
    Severity,
    get_scenario,
    register_scenario,
    scenario_names,
    scenario_per_joint,
    scenario_severity,
    scenario_summary,
)
from leglab.causes.table import CAUSES

FOLDER = Path(leglab.scenarios.__file__).parent


def leak(start, **settings):
    return ParameterChange(parameter="internal_leakage", value=10.0, start=start, **settings)


def edges(scenario):
    return [(phase.name, phase.start, phase.end) for phase in scenario.phases]


def test_a_change_of_one_joint_is_of_its_cylinder_spring_and_encoder():
    (alone,) = get_scenario("seal_wear", element="knee").changes
    taken = [e for e in ("knee", "knee_valve", "knee_spring") if alone.applies_to(e)]
    assert taken == ["knee", "knee_valve", "knee_spring"]
    assert not any(alone.applies_to(e) for e in ("hip_valve", "kneecap", "supply", "*"))
    # A fault that is of one joint by itself may be moved to another one.
    (moved,) = get_scenario("encoder_shift", element="hip_yaw").changes
    assert moved.applies_to("hip_yaw")
    assert not moved.applies_to("knee")


def test_what_all_joints_share_has_no_element():
    for name in ("cold_oil", "supply_drop", "payload", "nominal"):
        with pytest.raises(LeglabError, match=f"'{name}' does not happen to one joint alone.*seal"):
            get_scenario(name, element="knee")
    able = [name for name in scenario_names() if scenario_per_joint(name)]
    assert {"seal_wear", "valve_wear", "spring_fatigue"} <= set(able)
    assert not {"hot_oil", "supply_droop", "cold_start"} & set(able)


def test_every_file_is_a_scenario_of_its_name():
    files = {path.stem for path in FOLDER.glob("*.py") if not path.stem.startswith("_")}
    assert files == {"nominal", "cold_start"} == set(scenario_names()) - set(CAUSES)


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_can_be_built_and_shortened(name):
    assert scenario_summary(name)
    for scenario in (get_scenario(name), get_scenario(name, duration=3.0)):
        assert scenario.name == name
        assert all(change.end <= scenario.duration for change in scenario.changes)
        names = [phase.name for phase in scenario.phases]
        if name == "cold_start":  # changes at once
            assert names == ["after"]
        else:
            assert names == (["before", "after"] if scenario.changes else ["whole"])
    assert scenario.duration == 3.0


@pytest.mark.parametrize("name", [n for n in scenario_names() if scenario_severity(n)])
def test_every_severity_reaches_the_changes(name):
    severity = scenario_severity(name)
    ends = {
        tuple(c.value for c in get_scenario(name, severity=s).changes)
        for s in (severity.lowest, severity.highest)
    }
    assert len(ends) == 2
    assert get_scenario(name).severity == severity.default
    if name == "cold_start":
        return
    ramped = get_scenario(name, ramp_duration=2.0)
    assert [phase.name for phase in ramped.phases] == ["before", "during", "after"]


def test_seal_wear_multiplies_the_leakage_by_ten_at_half_time():
    scenario = get_scenario("seal_wear", duration=10.0)
    values = [scenario.value_at(t, "internal_leakage", "knee", 1.7e-13) for t in (4.99, 5.0, 10.0)]
    assert values == [1.7e-13, 1.7e-12, 1.7e-12]
    assert scenario.value_at(9, "oil_temperature", "knee", 40.0) == 40.0


@pytest.mark.parametrize(("name", "celsius"), [("cold_oil", 0.0), ("hot_oil", 80.0)])
def test_oil_temperature_is_set_at_half_time(name, celsius):
    scenario = get_scenario(name)
    times = (0, scenario.duration / 2, scenario.duration)
    values = [scenario.value_at(t, "oil_temperature", "any", 40.0) for t in times]
    assert values == [40.0, celsius, celsius]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "seal_waer"}, "unknown scenario 'seal_waer': .* did you mean 'seal_wear'"),
        ({"name": "seal_wear", "severity": 0.5}, r"severity 0.5 is outside \[1, 1000\].*ratio"),
        ({"name": "seal_wear", "severity": math.nan}, "severity nan is outside"),
        ({"name": "nominal", "severity": 2.0}, "scenario 'nominal' has no severity, but 2.0"),
        ({"name": "nominal", "ramp_duration": 2.0}, "'nominal' changes nothing"),
        ({"name": "seal_wear", "duration": 0.0}, "duration 0.0 s is not allowed"),
        ({"name": "seal_wear", "duration": -1.0}, "duration -1.0 s is not allowed"),
        ({"name": "seal_wear", "duration": math.nan}, "duration nan s is not allowed"),
        ({"name": "seal_wear", "ramp_duration": -1.0}, "ramp_duration -1.0 s is not allowed"),
        ({"name": "seal_wear", "ramp_duration": 99.0}, "lasts until 109 s, the run ends at 20 s"),
    ],
)
def test_bad_options(arguments, message):
    with pytest.raises(LeglabError, match=message) as caught:
        get_scenario(**arguments)
    assert "\n" not in str(caught.value)


def test_a_schedule_does_not_go_backwards():
    with pytest.raises(LeglabError, match=r"'x': the schedule goes backwards: .* at 2 s.* at 3 s"):
        Scenario(name="x", duration=10.0, changes=(leak(3.0), leak(2.0)))


def test_phases_of_a_step_a_ramp_and_two_changes():
    def scenario(*changes):
        return Scenario(name="x", duration=10.0, changes=changes)

    assert edges(scenario()) == [("whole", 0, 10)]
    assert edges(scenario(leak(4))) == [("before", 0, 4), ("after", 4, 10)]
    during = [("before", 0, 4), ("during", 4, 6), ("after", 6, 10)]
    assert edges(scenario(leak(4, ramp_duration=2))) == during
    assert edges(scenario(leak(4), leak(6))) == during
    assert edges(scenario(leak(0))) == [("after", 0, 10)]


def test_breakpoints():
    changes = (leak(2, ramp_duration=3), leak(4), leak(5))
    assert Scenario(name="x", duration=10.0, changes=changes).breakpoints == (2, 4, 5)
    assert Scenario(name="x", duration=10.0).breakpoints == ()


def test_a_later_change_starts_from_what_the_first_left():
    changes = (leak(2), leak(5, element="knee*"))
    scenario = Scenario(name="x", duration=10.0, changes=changes)
    assert scenario.value_at(9, "internal_leakage", "knee_valve", 1.0) == 100
    assert scenario.value_at(9, "internal_leakage", "hip_valve", 1.0) == 10


@given(
    st.lists(st.tuples(st.floats(0, 8), st.floats(0, 2)), max_size=4),
    st.lists(st.floats(0, 10), min_size=2, max_size=30),
)
def test_what_does_not_move_keeps_its_value(pairs, times):
    """A runner that writes parameters for `moving` alone ends with the right values."""
    changes = tuple(leak(start, ramp_duration=ramp) for start, ramp in sorted(pairs))
    scenario = Scenario(name="x", duration=10.0, changes=changes)
    previous, written = -math.inf, 3.0
    for time in sorted(times):
        if scenario.moving(previous, time):
            written = scenario.value_at(time, "internal_leakage", "knee", 3.0)
        assert written == scenario.value_at(time, "internal_leakage", "knee", 3.0)
        previous = time


def test_registering(monkeypatch):
    monkeypatch.setattr(module, "SCENARIOS", Registry("scenario"))
    severity = Severity(meaning="payload [kg]", default=3.0, lowest=0.0, highest=10.0)

    @register_scenario("load", summary="a load", severity=severity, reference="squat")
    def load(options: Options):
        return (
            ParameterChange(
                parameter="payload", kind="set", value=options.severity, start=options.half
            ),
        )

    scenario = get_scenario("load", severity=5.0, duration=8.0)
    assert scenario.changes[0].value == 5.0
    assert scenario.changes[0].start == 4.0
    assert (scenario.reference, scenario.summary, scenario.severity) == ("squat", "a load", 5.0)


def test_a_scenario_runs_as_a_script():
    """The script asks for its own scenario, although it also is a module of the package."""
    program = (
        "import runpy, sys, types, warnings\n"
        "warnings.simplefilter('error')\n"
        "from leglab.base.scenario import get_scenario\n"
        "cli = types.ModuleType('leglab.cli')\n"
        "cli.run_scenario_as_script = lambda name: print(get_scenario(name).name)\n"
        "sys.modules['leglab.cli'] = cli\n"
        "runpy.run_module(f'leglab.scenarios.{sys.argv[1]}', run_name='__main__', alter_sys=True)\n"
    )
    for name in ("nominal", "cold_start"):
        result = subprocess.run(
            [sys.executable, "-c", program, name], capture_output=True, text=True, check=False
        )
        assert (result.stdout, result.stderr) == (f"{name}\n", "")
