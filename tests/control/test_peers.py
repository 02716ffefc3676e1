"""The peers `adrc` and `ilc`: closed forms of their laws, their tuning, and what they reject."""

from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

from leglab import RunSettings
from leglab.base.scale import rms
from leglab.commissioning.adrc_gains import ADRC, JointMargins, plant_gain
from leglab.commissioning.adrc_gains import tuned_gains as tuned_bandwidths
from leglab.commissioning.gains_file import GAINS as TUNED
from leglab.commissioning.ilc_gains import CONTRACTION, ILC, closed_loops
from leglab.commissioning.pd_gains import sampled_plant, stored_gains
from leglab.control import contract
from leglab.control.extended_state_observer import DisturbanceGains, DisturbanceRejection
from leglab.control.iterative_learning import (
    IterativeLearning,
    LearningFilter,
    _kernels,
    learning_function,
    q_filter,
)
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation, load_model
from leglab.runs.loop import Loop
from leglab.runs.preparation import prepared

PERIOD, LATENCY = 0.002, 0.001
GAINS = DisturbanceGains(
    control_bandwidth=np.array([20.0, 7.0]),
    observer_bandwidth=np.array([60.0, 35.0]),
    plant_gain=np.array([10.0, 12.0]),
    order=np.array([1, 2]),
)
DIRECTION = np.array([1.0, -1.0])


def integrators(disturbance, count, *, law):
    """Errors (count, 2) of joints behind hold and latency, in closed form.

    The first has e' = f - b_0 u, the second e'' = f - b_0 u.
    """
    rate, second = DIRECTION * GAINS.plant_gain, GAINS.order == 2
    error, speed, sent, seen = np.zeros(2), np.zeros(2), np.zeros(2), []

    def moved(time, driven):
        return time * np.where(second, speed + 0.5 * time * driven, driven)

    for k in range(count):
        # The measurement was taken `LATENCY` ago, while the last command held.
        measured = error + moved(-LATENCY, disturbance(k) - rate * sent)
        seen.append(error.copy())
        sent = law(measured)
        driven = disturbance(k) - rate * sent
        error = error + moved(PERIOD, driven)
        speed = speed + second * PERIOD * driven
    return np.array(seen)


def rejection():
    return DisturbanceRejection(GAINS, DIRECTION, period=PERIOD, latency=LATENCY)


@pytest.mark.parametrize("joint", [0, 1])
def test_poles_are_the_stated_bandwidths(joint):
    """Observer and law on the plant that they assume, by python-control."""
    law, order = rejection().linear(joint), int(GAINS.order[joint])
    rate = (DIRECTION * GAINS.plant_gain)[joint]
    chain = control.ss(np.eye(order, k=1), -rate * np.eye(order)[:, -1:], np.eye(order)[:1], 0)
    plant = sampled_plant(chain, PERIOD, LATENCY)
    loop = control.ss(law.a, law.b[:, None], law.c[None], law.d, PERIOD)
    closed = control.feedback(loop * plant, control.ss([], [], [], 1, PERIOD), sign=1)
    poles = list(control.poles(closed))

    def take(pole, tolerance):
        nearest = min(poles, key=lambda p: abs(p - pole))
        assert abs(nearest - pole) < tolerance
        poles.remove(nearest)

    # A multiple pole is told to a root of the rounding only.
    for _ in range(order + 1):
        take(np.exp(-GAINS.observer_bandwidth[joint] * PERIOD), 2e-4 if order == 1 else 1e-3)
    # The law acts on the estimate moved on to the command: a held chain of integrators.
    w_c, held = GAINS.control_bandwidth[joint], control.c2d(chain, PERIOD, "zoh")
    feedback = np.array([[w_c]] if order == 1 else [[w_c**2, 2 * w_c]]) / rate
    for pole in np.linalg.eigvals(held.A + held.B @ feedback):
        take(pole, 2e-4)
    np.testing.assert_allclose(poles, 0.0, atol=1e-3)


def test_a_constant_disturbance_is_estimated_and_undone():
    law = rejection()
    flow = np.array([0.5, -0.2])
    errors = integrators(lambda k: flow, 1500, law=law)
    assert np.abs(errors).max() > 1e-3
    np.testing.assert_allclose(errors[-1], 0.0, atol=1e-9)
    np.testing.assert_allclose(law.disturbance, flow, rtol=1e-6)


def test_the_response_to_a_disturbance_shrinks_with_the_observers_bandwidth():
    """A ramp of disturbance leaves an error that falls as the bandwidths say."""

    def left(factor):
        gains = replace(GAINS, observer_bandwidth=factor * GAINS.observer_bandwidth)
        law = DisturbanceRejection(gains, DIRECTION, period=PERIOD, latency=LATENCY)
        return np.abs(integrators(lambda k: np.full(2, k * PERIOD), 3000, law=law)[-1])

    # Steady errors of a ramp of slope 1 in continuous time. The observer lags by 1/w_o^2 in e and
    # 2/w_o in f; of second order by 1/w_o^3, 3/w_o^2 in e' and 3/w_o in f.
    for factor in (1.0, 2.0):
        w_o, w_c = factor * GAINS.observer_bandwidth, GAINS.control_bandwidth
        one = 2 / (w_o * w_c) + 1 / w_o**2
        two = 3 / (w_o * w_c**2) + 6 / (w_o**2 * w_c) + 1 / w_o**3
        np.testing.assert_allclose(left(factor), np.where(GAINS.order == 1, one, two), rtol=0.15)


def test_a_cut_command_does_not_wind_up():
    """With the valve at its limit the observer knows what was sent, and recovers at once."""
    limit = 0.01

    def run(told):
        law = rejection()

        def limited(error):
            wish = law(error)
            sent = np.clip(wish, -limit, limit)
            if told:
                law.sent(sent)
            return sent

        push = np.array([0.3, 0.3])
        return integrators(lambda k: push * (k < 200), 3000, law=limited)

    def after(errors):
        return np.abs(errors[-1]).max()

    assert after(run(told=True)) < 1e-6
    assert np.abs(run(told=False)).max() > 1.02 * np.abs(run(told=True)).max()


def test_lost_readings_leave_the_estimate_alone():
    law = rejection()
    integrators(lambda k: np.array([0.5, -0.2]), 1000, law=law)
    before = law.disturbance.copy()
    assert np.isfinite(law(np.array([np.nan, 0.0]))).all()
    assert law.disturbance[0] == before[0]


@pytest.mark.slow("our own figures")
@pytest.mark.parametrize("model", ["knee_bench", "leg"])
def test_stored_bandwidths_keep_the_margins_of_pd(model):
    sensors = SensorConfiguration()
    simulation = Simulation(load_model(model))
    gains = ADRC.gains(model, simulation, sensors)
    for joint in range(len(simulation.joints)):
        simulation.reset()
        own = DisturbanceGains(**{name: value[[joint]] for name, value in vars(gains).items()})
        gain, phase, response = JointMargins(simulation, joint, sensors)(own)
        assert gain >= 5.99, simulation.joints[joint]
        assert phase >= 44.9, simulation.joints[joint]
        assert np.isfinite(response)


def test_stored_bandwidths_are_what_tuning_gives():
    sensors = SensorConfiguration()
    simulation = Simulation(load_model("knee_bench"))
    stored = ADRC.gains("knee_bench", simulation, sensors)
    tuned = tuned_bandwidths(simulation, 0, sensors)
    for name, value in vars(tuned).items():
        np.testing.assert_allclose(getattr(stored, name), value, rtol=1e-3)


FILTER = LearningFilter(
    cutoff=np.array([40.0, 60.0]),
    lead=np.array([0.0, 0.0]),
    speed_per_command=np.array([10.0, 12.0]),
)
CROSSOVER = np.array([30.0, 25.0])


def learner(stride=0.8):
    return IterativeLearning(
        FILTER, CROSSOVER, DIRECTION, stride=stride, period=PERIOD, tolerance=1e-3
    )


def test_kernels_are_the_filters():
    """Impulse responses against the functions that they are made of."""
    half, shift = 400, 0.3 * PERIOD
    smoothing, learning = _kernels(
        cutoff=50.0,
        lead=0.004,
        speed_per_command=10.0,
        crossover=30.0,
        period=PERIOD,
        half=half,
        shift=shift,
    )
    time = PERIOD * np.arange(-half, half + 1)
    for frequency in (0.0, 7.0, 33.0, 61.0, 85.0, 150.0):
        wave = np.exp(1j * frequency * time)
        passed = q_filter(np.array(frequency), 50.0) * np.exp(1j * frequency * shift)
        function = learning_function(
            np.array(frequency), lead=0.004, speed_per_command=10.0, crossover=30.0
        )
        assert smoothing @ wave == pytest.approx(complex(passed), abs=3e-3)
        assert learning @ wave == pytest.approx(
            complex(passed * function), abs=3e-3 * abs(complex(function))
        )


@pytest.mark.parametrize("stride", [0.8, 0.8013])
def test_errors_contract_by_what_the_law_says(stride):
    """On the plant that it assumes each stride leaves 1 - gamma of an error that Q passes."""
    learning = learner(stride)
    rate = DIRECTION * FILTER.speed_per_command
    count = round(12 * stride / PERIOD)
    decay = np.exp(-CROSSOVER * PERIOD)
    error, errors = np.zeros(2), np.empty((count, 2))
    for k in range(count):
        phase = 2 * np.pi * k * PERIOD / stride
        reference = np.array([0.4 * np.sin(phase), 0.3 * np.cos(phase)])
        flow = np.array([0.2 * np.sin(phase) + 0.1, 0.1 * np.cos(2 * phase)])
        correction = learning.correction(reference)
        learning.take(error, correction)
        errors[k] = error
        # e' = flow - b_0 c - w_x e, held over a period.
        level = (flow - rate * correction) / CROSSOVER
        error = level + decay * (error - level)
    starts = [round(j * stride / PERIOD) for j in range(12)]
    strides = np.array([rms(errors[start : start + 400], axis=0) for start in starts])
    ratios = strides[5:9] / strides[4:8]
    # A held command acts half a period late, which a lead of zero does not make good.
    np.testing.assert_allclose(ratios, 0.5, atol=0.03)


def test_nothing_is_learned_where_the_reference_does_not_repeat():
    learning = learner()
    for k in range(3000):
        time = k * PERIOD
        wave = np.sin(2 * np.pi * time / 0.8)
        reference = np.array([wave, wave * (1.0 if time < 3.6 else np.cos(time))])
        correction = learning.correction(reference)
        learning.take(np.full(2, 1e-3), correction)
        if time < 1.6 or time > 3.9:
            assert not correction.any(), time
        if 3.0 < time < 3.6:
            assert learning.repeats
            assert (correction * DIRECTION > 0).all()


def test_frozen_it_repeats_what_it_has():
    learning = learner()
    given = []
    for k in range(4000):
        wave = np.sin(2 * np.pi * k / 400)
        correction = learning.correction(np.array([wave, wave]))
        learning.take(np.full(2, 1e-3 * wave), correction)
        given.append(correction.copy())
        if k == 2400:
            learning.freeze()
    np.testing.assert_allclose(given[3000:3400], given[2600:3000], rtol=1e-12)
    assert np.abs(given[3000:3400]).max() > 1e-3


@pytest.mark.slow("our own figures")
@pytest.mark.parametrize("model", ["knee_bench", "leg"])
def test_stored_filters_contract_on_every_linearised_plant(model):
    sensors = SensorConfiguration()
    simulation = Simulation(load_model(model))
    filters = ILC.gains(model, simulation, sensors)
    gains = stored_gains(model, simulation, sensors)
    frequency = np.geomspace(0.2, 1000.0, 700)
    for joint, name in enumerate(simulation.joints):
        simulation.reset()
        loops = closed_loops(simulation, joint, sensors, gains[joint], frequency)
        speed = float(filters.speed_per_command[joint])
        function = learning_function(
            frequency,
            lead=float(filters.lead[joint]),
            speed_per_command=speed,
            crossover=gains[joint][0] * speed,
        )
        left = np.abs(q_filter(frequency, float(filters.cutoff[joint])) * (1 - function * loops))
        assert left.max() <= 1.01 * CONTRACTION, name
        wider = q_filter(frequency, 1.3 * float(filters.cutoff[joint]))
        assert np.abs(wider * (1 - function * loops)).max() > CONTRACTION, name


def errors_of(controller, **settings):
    """RMS errors [mrad] in whole strides before, and at the end after, a change at half time."""
    run = RunSettings(
        controller=controller, **{"scenario": "seal_wear", "duration": 20, **settings}
    )
    loop = Loop(run)
    history = loop.run()
    assert not history.failure, history.failure
    half = history.time[-1] / 2

    def error(start, end):
        return 1e3 * rms(history.error[(history.time >= start) & (history.time < end)])

    return error(half - 2.4, half), error(2 * half - 2.4, 2 * half), history


def test_both_undo_what_static_feedforward_leaves():
    known = errors_of("static_feedforward")
    learned = errors_of("ilc")
    assert learned[0] < 0.3 * known[0]
    assert learned[1] < 0.25 * known[1]
    rejected = errors_of("adrc")
    assert rejected[1] < 0.8 * known[1]


def test_ilc_is_static_feedforward_where_nothing_repeats():
    history = errors_of("ilc", scenario="nominal", reference="random_stride", duration=8)[2]
    assert not history.diagnostics["repeats"].any()
    assert not history.diagnostics["correction"].any()


_MOTOR = '<motor joint="slide" ctrlrange="-20 20"/>'
_SLIDE = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
<joint name="slide" type="slide" axis="1 0 0" damping="2" range="-0.5 0.5"/>
<geom size="0.1" mass="2" contype="0" conaffinity="0"/></body></worldbody>
<actuator>{}</actuator></mujoco>"""


@pytest.mark.parametrize(
    "actuator",
    [
        _MOTOR,
        '<velocity joint="slide" kv="30" ctrlrange="-3 3"/>',
        '<position joint="slide" kp="200" kv="20" ctrlrange="-1 1"/>',
    ],
)
def test_adrc_behind_a_force_is_of_second_order(actuator, tmp_path):
    """A law of first order leaves fifty to three hundred times the error of `pd`."""
    model = tmp_path / "slide.xml"
    model.write_text(_SLIDE.format(actuator))
    errors = []
    for controller in ("adrc", "pd"):
        settings = {"controller": controller, "model": str(model), "duration": 4.0}
        history = Loop(RunSettings(scenario="nominal", **settings)).run()
        assert not history.failure
        errors.append(rms(history.error))
    assert errors[0] < 1.5 * errors[1]


@pytest.mark.parametrize(
    "actuator",
    [
        _MOTOR,
        '<general joint="slide" ctrlrange="-20 20" dyntype="filter" dynprm="0.01"/>',
    ],
)
def test_a_command_of_one_gives_full_force_over_mass_with_a_filter_too(actuator, tmp_path):
    model = tmp_path / "slide.xml"
    model.write_text(_SLIDE.format(actuator))
    simulation = Simulation(load_model(str(model)), keyframe=None)
    assert plant_gain(simulation, 0) == (pytest.approx(20.0 / 2.0), 2)


def test_a_new_controller_brings_its_gains_without_a_shared_record(monkeypatch, tmp_path):
    """They are tuned for the nominal machine when somebody asks, once; the contract names none."""
    (tmp_path / "gains.toml").touch()
    asked = []

    def tune(model, simulation, sensors):
        asked.append(model)
        return [{"cutoff": 2.0, "lead": 0.0, "speed_per_command": 1.0}]

    mine = replace(ILC, path=tmp_path / "gains.toml", tune=tune)
    monkeypatch.setattr(TUNED, "_entries", {**TUNED._entries})
    TUNED.add("mine", mine, tune)
    machine = prepared(RunSettings(scenario="", model="knee_bench")).controller_setup.machine
    assert machine.tuned["mine"].cutoff.tolist() == [2.0]
    assert machine.tuned["mine"] is machine.tuned["mine"]
    assert asked == ["knee_bench"]
    assert set(TUNED.names()) == {"adaptive_backstepping", "adrc", "ilc", "mine"}
    text = Path(contract.__file__).read_text()
    assert not [name for name in TUNED.names() if f"{name}_gains" in text or f"`{name}`" in text]
