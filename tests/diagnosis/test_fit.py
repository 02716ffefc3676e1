"""`leglab fit`: parameters of the user's choice, with bounds and covariance."""

import json
from html import unescape

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from leglab import data
from leglab.base.errors import SettingsError
from leglab.base.recording import Recording
from leglab.cli.app import app
from leglab.diagnosis.fit import Wanted, fit
from rigs import PENDULUM, Truth
from tests.helpers.unpleasant import of_kinds

DAMPING = 0.08  # of the rig's model [N m s/rad]


@pytest.fixture(scope="module")
def logs():
    """Of a pendulum with twice its damping and a constant force."""
    truth = Truth(viscous_factor=2.0, offset=0.3)
    return of_kinds(PENDULUM, truth, ("multisine", "fast", "slow"), seconds=4.0)


@pytest.fixture
def files(logs, tmp_path):
    paths = [tmp_path / f"{name}.parquet" for name in logs]
    for path, log in zip(paths, logs.values(), strict=True):
        data.write(log, path)
    return list(map(str, paths))


def test_intervals_hold_the_truth_and_the_command_writes_it(files, tmp_path):
    out = tmp_path / "out"
    wanted = ["--parameter", "hinge:viscous_friction", "--parameter", "hinge:force_offset=-1:1"]
    told = CliRunner().invoke(
        app, ["fit", str(PENDULUM.model), *files, *wanted, "--held-out", "fast", "--out", str(out)]
    )
    assert told.exit_code == 0, told.output
    content = json.loads((out / "diagnosis.json").read_text())
    assert content["verdict"] == "fitted"
    estimates = {e["name"]: p for e in content["effects"] for p in e["parameters"].values()}
    for name, true in (("viscous_friction", 2 * DAMPING), ("force_offset", 0.3)):
        low, high = estimates[name]["interval"]
        assert low <= true <= high
        assert high - low < 0.05 * true
    assert content["gap"]["after"] < 1.3
    names = ["hinge:viscous_friction.damping", "hinge:force_offset.force"]
    assert content["covariance"]["parameters"] == names
    spread = np.sqrt(np.diag(content["covariance"]["matrix"]))
    assert (spread > 0.0).all()
    damping = mujoco.MjModel.from_xml_path(str(out / "improved.xml")).dof_damping[0]
    assert damping == pytest.approx(estimates["viscous_friction"]["value"], rel=1e-4)
    page = (out / "diagnosis.html").read_text()
    assert "Correlation of the estimates" in page
    assert "<title>Fit of pendulum" in page
    assert "\N{REPLACEMENT CHARACTER}" not in page
    assert "\n".join(content["changed"][2:]) in unescape(page)
    for text in (page, told.output):
        assert "onfidence" not in text
        assert "recalibrated" not in text


def test_an_interval_holds_the_truth_in_a_log_of_mujoco_that_says_nothing_of_its_step(tmp_path):
    """Its commands act half a step early."""
    steps, every, noise = 2500, 4, 1e-4
    file = tmp_path / "model.xml"
    text = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="hinge" axis="0 1 0"
      damping="%g" frictionloss="0.1"/><geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02"
      mass="1"/></body></worldbody><actuator><motor name="m" joint="hinge"/></actuator></mujoco>"""
    file.write_text(text % 0.1)
    model = mujoco.MjModel.from_xml_string(text % 0.2)
    logs = {}
    for seed in (0, 1):
        random, state, rows = np.random.default_rng(seed), mujoco.MjData(model), []
        rates, phases = random.uniform(0.2, 3.0, 8), random.uniform(0.0, 2.0 * np.pi, 8)
        for step in range(steps):
            if step % every == 0:
                waves = np.sin(2.0 * np.pi * rates * state.time + phases)
                state.ctrl[0] = 0.4 * waves.sum() * min(1.0, 2.0 * state.time)
                seen = state.qpos[0] + noise * random.standard_normal()
                rows.append((state.time, state.ctrl[0], seen))
            mujoco.mj_step(model, state)
        time, command, position = np.array(rows).T
        columns = {"m_command": command, "hinge_position": position}
        logs[str(seed)] = Recording(time=time, columns=columns)
    found = fit(file, logs, [Wanted.parse("hinge:viscous_friction")], held_out=()).result
    (damping,) = found.effects[0].parameters
    low, high = damping.interval
    assert low < 0.2 < high < low + 0.02


def test_an_effect_that_is_not_fitted_widens_the_interval(logs):
    wanted = [Wanted.parse("hinge:viscous_friction"), Wanted.parse("hinge:force_offset")]
    both, alone = (
        fit(PENDULUM.model, logs, some, held_out=()).result.covariance[1][0, 0]
        for some in (wanted, wanted[:1])
    )
    assert alone > 25.0 * both


def test_bounds_hold_and_are_told(logs):
    fitted = fit(PENDULUM.model, logs, [Wanted.parse("hinge:force_offset=0:0.1")], held_out=())
    ((value,),) = fitted.hypothesis.values()
    assert value == pytest.approx(0.1, rel=1e-3)
    (estimate,) = fitted.result.effects[0].parameters
    assert 0.0 <= estimate.interval[0] < estimate.interval[1] <= 0.1
    assert "hinge:force_offset.force ended at a bound" in fitted.result.notes


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("hinge", "is no parameter"),
        (":armature", "is no parameter"),
        ("hinge:armature=1", "is no parameter"),
        ("hinge:armature=", "is no parameter"),
        ("hinge:armature=2:1", "the lower bound is not below the upper one"),
        ("hinge:armature=0:nan", "the lower bound is not below the upper one"),
    ],
)
def test_what_is_no_parameter_is_refused(text, told):
    with pytest.raises(SettingsError, match=f"{told}; allowed: ELEMENT:NAME"):
        Wanted.parse(text)


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("elbow:armature", "an element of .*hinge"),
        ("hinge:coulom", "of hinge: armature.inertia"),
        ("hinge:cogging", "several parameters; allowed: of hinge: cogging.sine, cogging.cosine"),
        ("hinge:armature=-2:-1", "within \\[0, "),
    ],
)
def test_unknown_parameters_are_told_what_there_is(logs, text, allowed):
    with pytest.raises(SettingsError, match=allowed):
        fit(PENDULUM.model, logs, [Wanted.parse(text)])


def test_a_parameter_is_fitted_once(logs):
    names = ("armature", "armature.inertia"), ("frictionloss", "coulomb_friction")
    for pair in names:  # an attribute of MJCF stands for the effect
        twice = [Wanted.parse(f"hinge:{name}") for name in pair]
        with pytest.raises(SettingsError, match="given more than once; allowed: once"):
            fit(PENDULUM.model, logs, twice)
