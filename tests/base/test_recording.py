import pickle

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leglab.base.errors import LeglabError
from leglab.base.recording import Recording


def make(n=10, **metadata):
    time = np.arange(n) * 0.001
    return Recording(
        time=time,
        columns={
            "knee_position": np.sin(time),
            "knee_valve_command": np.cos(time),
            "knee_pressure_a": 1e6 * time,
        },
        metadata=metadata,
    )


def test_holds_its_own_read_only_copy():
    time, samples = np.arange(3.0), np.ones(3)
    recording = Recording(time=time, columns={"knee_position": samples})
    samples[0] = 5
    time[0] = -1
    assert recording["knee_position"][0] == 1
    assert recording.time[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        recording["knee_position"][0] = 2
    with pytest.raises(TypeError):
        recording.columns["x"] = samples
    with pytest.raises(AttributeError):
        recording.time = time


def test_integers_become_floats():
    recording = Recording(time=[0, 1], columns={"a": [1, 2]})
    assert recording.time.dtype == recording["a"].dtype == np.float64


@pytest.mark.parametrize(
    ("time", "columns", "message"),
    [
        ([0.0, 0.1, 0.1], {}, r"'time', row 2: 0\.1 s does not come after 0\.1 s"),
        ([0.0, 0.2, 0.1], {}, r"'time', row 2: 0\.1 s does not come after 0\.2 s"),
        ([0.0, np.nan], {}, "'time', row 1: nan is not a finite time"),
        ([], {}, "at least one sample"),
        ([[0.0, 1.0]], {}, r"'time' has shape \(1, 2\)"),
        ([0.0, 1.0], {"a": [1.0]}, "'a' has 1 samples, 'time' has 2"),
        ([0.0, 1.0], {"a": [1.0, "x"]}, "'a', row 1: 'x' is not a number"),
        ([0.0, 1.0], {"time": [1.0, 2.0]}, "'time' cannot name a column"),
    ],
)
def test_bad_samples_are_named(time, columns, message):
    with pytest.raises(LeglabError, match=message) as caught:
        Recording(time=time, columns=columns)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [np.float64("nan"), object(), {1, 2}])
def test_metadata_must_fit_json(value):
    with pytest.raises(LeglabError, match="metadata 'seed'"):
        make(seed=value)


def test_lookup_and_names():
    recording = make()
    assert recording.joints == ("knee",)
    assert recording.actuators == ("knee_valve",)
    assert "knee_position" in recording
    assert recording["time"] is recording.time
    with pytest.raises(LeglabError, match="did you mean 'knee_position'"):
        recording["knee_postion"]


def test_stack_keeps_the_order_of_elements():
    recording = make().with_columns({"hip_position": np.zeros(10)})
    stacked = recording.stack(("hip", "knee"), "position")
    np.testing.assert_array_equal(stacked[:, 1], recording["knee_position"])
    assert stacked.shape == (10, 2)


def test_select_and_metadata():
    recording = make(seed=1).select(["knee_pressure_a"]).with_metadata(case="x")
    assert list(recording.columns) == ["knee_pressure_a"]
    assert dict(recording.metadata) == {"seed": 1, "case": "x"}
    with pytest.raises(LeglabError, match="unknown column"):
        recording.select(["knee_position"])


@given(st.floats(-1, 12), st.floats(-1, 12))
def test_between_is_half_open(start, end):
    recording = Recording(time=np.arange(11.0), columns={"a": np.arange(11.0)})
    expected = [t for t in range(11) if start <= t < end]
    if expected:
        part = recording.between(start, end)
        assert part.time.tolist() == part["a"].tolist() == expected
    else:
        with pytest.raises(LeglabError, match="no sample in"):
            recording.between(start, end)


def test_sampling_period_is_exact_over_the_whole_recording():
    time = np.round(np.arange(1000) / 610.35, 6)
    assert Recording(time=time, columns={}).sampling_period == pytest.approx(1 / 610.35, rel=1e-6)


def test_sampling_period_needs_uniform_samples():
    with pytest.raises(LeglabError, match=r"0\.003 s between rows 2 and 3, usual are 0\.001 s"):
        _ = Recording(time=[0, 0.001, 0.002, 0.005, 0.006], columns={}).sampling_period
    with pytest.raises(LeglabError, match="one sample"):
        _ = make(1).sampling_period


def test_equality():
    assert make(seed=1) == make(seed=1)
    assert make(seed=1) != make(seed=2)
    assert make(5) != make(6)
    assert make().with_columns({"a": np.full(10, np.nan)}) == make().with_columns(
        {"a": np.full(10, np.nan)}
    )
    assert make() != "recording"


def test_travels_between_processes():
    recording = make(seed=3)
    copy = pickle.loads(pickle.dumps(recording))
    assert copy == recording
    assert not copy.time.flags.writeable


_SLIDE = """<mujoco><option timestep="{}" integrator="{}"/><worldbody><body>
<joint name="slide" type="slide"/><geom size="0.1" mass="1"/></body></worldbody>
<actuator><motor joint="slide"/></actuator></mujoco>"""


@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicit", "implicitfast", "discrete"])
def test_commands_of_a_simulation_act_as_early_as_its_integrator_has_them(integrator):
    """x = (t + lead)² / 2 of a unit force on a unit mass; a machine has no lead."""
    timestep, steps = 2e-3, 1000
    text = _SLIDE.format(timestep, integrator).replace("<option", '<option gravity="0 0 0"')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.ctrl[0] = 1.0
    mujoco.mj_step(model, data, nstep=steps)
    made = {"timestep": timestep, "integrator": integrator.lower()}
    recording = Recording(
        time=timestep * np.arange(steps), columns={}, metadata={"simulation": made}
    )
    travelled = 0.5 * (data.time + recording.command_lead) ** 2
    assert travelled == pytest.approx(data.qpos[0], rel=1e-6)


@pytest.mark.parametrize(
    "told",
    [
        None,
        "0.001",
        {"timestep": 1e-3},
        {"timestep": "long", "integrator": "euler"},
        {"timestep": -1e-3, "integrator": "euler"},
        {"timestep": 1e3, "integrator": "euler"},
        {"timestep": 1e-3, "integrator": "mine"},
    ],
)
def test_the_lead_of_commands_is_unknown_without_a_known_simulation(told):
    recording = Recording(time=1e-3 * np.arange(9), columns={}, metadata={"simulation": told})
    assert recording.command_lead is None
