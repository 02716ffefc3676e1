"""improved.xml carries what was found, sensor and command faults included, and is read back."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leglab import RunSettings, run_scenario
from leglab.diagnosis import improve
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.plant.paths import take_out
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.verdict.output import write_model as write_lines
from leglab.diagnosis.verdict.verdict import diagnose
from leglab.machine.plugin import to_xml
from leglab.machine.sensors import EncoderFaults, PressureFaults
from rigs import PENDULUM, Truth
from tests.helpers.native_models import every_plugin
from tests.helpers.patched_models import reloaded_error
from tests.helpers.unpleasant import of_bench, of_kinds


def write_model(problem, hypothesis, folder):
    """improved.xml of a hypothesis."""
    return write_lines(problem, hypothesis, folder)[0]


FAULTS = {
    ("command_delay", "knee_valve"): np.array([0.0063]),
    ("encoder_offset", "knee"): np.array([0.03]),
    ("encoder_scale", "knee"): np.array([1.04]),
    ("sensor_delay", "knee"): np.array([0.004]),
    ("pressure_sensor_offset", "knee_valve"): np.array([3e5, -4e5]),
    ("pressure_sensor_scale", "knee_valve"): np.array([1.06, 0.95]),
}
OFFSET = 0.05


@pytest.fixture(scope="module")
def problem():
    settings = DiagnosisSettings(effects=tuple(name for name, _ in FAULTS), threads=1)
    return set_up("knee_bench", of_bench("nominal"), ("walk",), settings)


@pytest.fixture(scope="module")
def shifted():
    """Verdict on recordings whose encoder has slipped."""
    slipped = {
        name: recording.with_columns({"knee_position": recording["knee_position"] + OFFSET})
        for name, recording in of_bench("nominal").items()
    }
    settings = DiagnosisSettings(effects=("encoder_offset", "valve_bias"), threads=1)
    return slipped, *diagnose("knee_bench", slipped, held_out=("walk",), settings=settings)


@pytest.mark.parametrize("faults", [*([key] for key in FAULTS), list(FAULTS)], ids=str)
def test_path_faults_are_read_back_from_the_patched_model(problem, tmp_path, faults):
    hypothesis = Hypothesis({key: FAULTS[key] for key in faults})
    path = write_model(problem, hypothesis, tmp_path)
    # Compared in corrected units; the file keeps every digit of a numeric and six of a delay.
    assert reloaded_error(problem, hypothesis, path) < 0.05
    assert reloaded_error(problem, Hypothesis(), path) > 20.0


def test_a_patched_model_is_patched_once_more(problem, tmp_path):
    """Found in two steps, faults are the same as found at once: scale after offset after scale."""
    once, twice = tmp_path / "once", tmp_path / "twice"
    once.mkdir()
    twice.mkdir()
    path = write_model(problem, Hypothesis(FAULTS), once)
    settings = DiagnosisSettings(effects=tuple(name for name, _ in FAULTS), threads=1)
    again = set_up(path, of_bench("nominal"), ("walk",), settings)
    # Whole samples: two linear interpolations are not one.
    whole = Hypothesis({**FAULTS, ("command_delay", "knee_valve"): np.array([0.006])})
    assert reloaded_error(again, whole, write_model(again, whole, twice)) < 0.05
    faults = EncoderFaults.of(mujoco.MjModel.from_xml_path(str(twice / "improved.xml")), ["knee"])
    # measured = 1.04 (1.04 true + 0.03) + 0.03
    assert faults.scale == pytest.approx(1.04**2)
    assert faults.offset == pytest.approx(1.04 * 0.03 + 0.03)
    assert faults.delay == pytest.approx(0.008)
    faults = PressureFaults.of(mujoco.MjModel.from_xml_path(str(twice / "improved.xml")), ["knee"])
    assert faults.scale == pytest.approx([1.06**2, 0.95**2])
    assert faults.offset == pytest.approx([1.06 * 3e5 + 3e5, -0.95 * 4e5 - 4e5])


def test_the_patched_model_reproduces_the_claimed_gap(shifted, tmp_path):
    slipped, result, found = shifted
    assert [effect.name for effect in result.effects] == ["encoder_offset"]
    assert result.effects[0].parameters[0].value == pytest.approx(OFFSET, abs=2e-3)
    assert result.gap.before > 20.0 * result.gap.after
    path = improve.write_improved(found, tmp_path)
    patched = set_up(
        path, slipped, ("walk",), DiagnosisSettings(effects=("valve_bias",), threads=1)
    )
    gap = np.sqrt(np.mean(patched.residual(Hypothesis())[patched.held] ** 2))
    assert gap == pytest.approx(result.gap.after, rel=0.05)


def test_the_patched_model_runs_in_a_closed_loop(shifted, tmp_path):
    """The encoder of the run is off as the diagnosis says, and the leg with it."""
    _, result, found = shifted
    offset = result.effects[0].parameters[0].value
    path = improve.write_improved(found, tmp_path)
    wanted = RunSettings(scenario="nominal", model="knee_bench", duration=1.0)
    true = []
    for model in ("knee_bench", str(path)):
        run = run_scenario(replace(wanted, model=model))
        shown = run.recording["knee_position"] - run.recording["knee_truth"]
        assert np.median(shown) == pytest.approx(offset if model == str(path) else 0.0, abs=1e-5)
        true.append(run.recording["knee_truth"])
    assert np.mean((true[0] - true[1])[-100:]) == pytest.approx(offset, rel=0.1)


def test_pressure_sensors_of_a_patched_model_are_off_in_a_closed_loop(problem, tmp_path):
    key = "pressure_sensor_offset", "knee_valve"
    path = write_model(problem, Hypothesis({key: np.array([3e5, -4e5])}), tmp_path)
    wanted = RunSettings(scenario="nominal", model="knee_bench", duration=0.5)
    plain, patched = (
        run_scenario(replace(wanted, model=model)).recording for model in ("knee_bench", str(path))
    )
    # No controller sees the pressures here: the motion and the drawn noise are the same.
    np.testing.assert_array_equal(plain["knee_position"], patched["knee_position"])
    for chamber, offset in (("a", 3e5), ("b", -4e5)):
        column = f"knee_pressure_{chamber}"
        np.testing.assert_allclose(patched[column] - plain[column], offset, atol=1e-6)


def test_a_controller_sees_what_the_pressure_sensors_show():
    model = Machine("knee_bench").spec()
    model.add_numeric(name="knee_pressure_b_scale", data=[0.9], size=1)
    model.add_numeric(name="knee_pressure_b_offset", data=[1e5], size=1)
    faults = PressureFaults.of(model.compile(), ["knee"])
    assert faults
    np.testing.assert_allclose(faults.seen(np.array([5e6, 4e6])), [5e6, 3.7e6])
    assert not PressureFaults.of(Machine("knee_bench").base.model, ["knee"])


def test_command_paths_of_a_file_are_taken_out_in_their_order():
    xml = """
    <mujoco>
      <extension><plugin plugin="leglab.command_path"><instance name="path">
        <config key="actuator" value="drive"/><config key="delay" value="0.002"/>
        <config key="gain" value="2"/><config key="bias" value="0.1"/>
        <config key="dead_band" value="0.3"/><config key="actuator_gain" value="0.9"/>
      </instance></plugin></extension>
      <worldbody><body><joint name="hinge"/><geom size="0.1" mass="1"/></body></worldbody>
      <actuator><motor name="drive" joint="hinge"/></actuator>
    </mujoco>"""
    Machine("knee_bench")  # registers the plugins
    spec = mujoco.MjSpec.from_string(xml)
    samples = np.array([0.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    for function in take_out(spec)[0]["drive"]:
        samples = function(samples, 1e-3)
    np.testing.assert_allclose(samples, [0.0, 0.0, 0.0, 1.8, 1.8, -1.6])
    (plugin,) = spec.plugins
    assert dict(plugin.config) == {"actuator": "drive", "actuator_gain": "0.9"}


def test_a_late_encoder_shows_what_was_between_samples():
    faults = EncoderFaults(
        offset=np.array([0.5, 0.0]), scale=np.array([2.0, 1.0]), delay=np.array([0.003, 0.0])
    )
    assert faults
    positions = np.array([[0.0, 9.0], [1.0, 8.0], [4.0, 7.0]])
    np.testing.assert_allclose(faults.seen(positions, 2, 2e-3), [2.0 * 0.5 + 0.5, 7.0])
    np.testing.assert_allclose(faults.seen(positions[:1], 0, 2e-3), [0.5, 9.0])
    healthy = EncoderFaults(offset=np.zeros(2), scale=np.ones(2), delay=np.zeros(2))
    assert not healthy


@pytest.mark.slow("whole diagnosis of a bench")
def test_a_single_cause_without_a_name_is_doubted_and_learned():
    """A machine that is as its model but for one torque is no machine that differs everywhere."""
    truth, kinds = Truth(ripple=(0.4, 1.1, 0.5)), ("multisine", "fast", "slow")
    logs = of_kinds(PENDULUM, truth, kinds, seconds=4.0)
    known = ("viscous_friction", "coulomb_friction", "force_offset")
    settings = DiagnosisSettings(effects=known, threads=1)
    result, found = diagnose(PENDULUM.model, logs, held_out=("slow",), settings=settings)
    assert (result.verdict, result.effects) == ("unexplained", ())
    model = improve.improved_model(found)
    assert model.learned.startswith("a torque that repeats every 1.1 rad of the hinge, 0.4 N m")
    levels = model.remainder.problem.noise_levels(model.hypothesis)[found.problem.judged]
    assert np.sqrt(levels.mean()) < 0.1 * result.gap.before
    (left,) = result.with_model("improved.xml", model.learned, model.errors).remaining
    assert left.learned < 0.1 * left.after


def test_a_model_that_was_attached_keeps_its_paths_and_joints(tmp_path):
    """Names in settings of plugins lack the prefix of the elements that they mean."""
    alone = mujoco.MjSpec.from_string(every_plugin())
    alone.compile()
    parent = mujoco.MjSpec()
    for option in ("timestep", "integrator"):
        setattr(parent.option, option, getattr(alone.option, option))
    child = mujoco.MjSpec.from_string(to_xml(alone))
    parent.attach(child, prefix="left_", frame=parent.worldbody.add_frame())
    parent.compile()
    (tmp_path / "robot.xml").write_text(to_xml(parent))
    machine = Machine(tmp_path / "robot.xml")
    assert list(machine.carried[0]) == ["left_drive"]
    assert set(machine.base.joint_of.values()) == {"left_hinge"}
    assert machine.spring_of("left_hinge") == "left_hinge_spring"


def test_parameters_go_back_while_the_others_make_up_for_them():
    """Against least squares; what errors hardly show goes first, then two that cancel."""
    rng = np.random.default_rng(0)
    columns, before = rng.normal(size=(50, 5)), 0.1 * rng.normal(size=50)
    columns[:, 1] = 1e-3 * rng.normal(size=50) - columns[:, 0]
    columns[:, 2:4] *= (1e-3, 10.0)
    away = np.array([1.0, 1.0, 0.5, 2.0, 0.3])
    paths = list(improve._going_back(before, columns, away))
    gone = [{2}, {0, 2}, {0, 1, 2}, {0, 1, 2, 4}, {0, 1, 2, 3, 4}]
    for path, back in zip(paths, gone, strict=True):
        kept = [i for i in range(5) if i not in back]
        rows = np.vstack([columns, -np.diag(away)])
        right = -np.r_[before, away] - rows[:, sorted(back)].sum(axis=1)
        free = np.linalg.lstsq(rows[:, kept], right)[0]
        assert path[kept] == pytest.approx(np.clip(free, 0.0, 1.0))
