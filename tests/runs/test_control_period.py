"""What one control period does with arrays, against NumPy: readings, commands, records."""

import contextlib

import mujoco
import numpy as np
import pytest

from leglab._native.loop import Drives, Readings, Rows
from leglab.machine.plugin import headless
from leglab.machine.sensors import (
    Encoders,
    SensorConfiguration,
    held,
    quantise,
    velocity_filter_coefficient,
)
from leglab.machine.simulation import Simulation, load_model

JOINTS, COUNT = 3, 60


@pytest.mark.parametrize("counts", [0, 131072, 1000])
def test_readings_and_velocities_are_those_of_numpy(counts):
    rng = np.random.default_rng(counts)
    sensors = SensorConfiguration(encoder_counts=counts)
    true, noise = rng.normal(size=(COUNT, 5)), 0.01 * rng.normal(size=(COUNT, JOINTS))
    index, positions = np.array([4, 0, 2]), np.zeros(5)
    positions[:] = true[0]
    encoders = Encoders(
        ("a", "b", "c"), sensors, positions=positions, index=index, noise=noise, seed=3
    )
    encoders.set_parameter("a", "encoder_offset", 0.2)
    encoders.set_parameter("c", "encoder_dropout", 0.5)
    got, speed = np.empty((2, COUNT, JOINTS))
    for k in range(COUNT):
        positions[:] = true[k]
        encoders.sample()
        encoders.read(k)
        got[k], speed[k] = encoders.position, encoders.velocity

    expected = quantise(true[:, index] + noise + [0.2, 0.0, 0.0], counts)
    assert 10 < encoders.lost[:, 2].sum() < 50
    expected[:, 2] = held(expected[:, 2], encoders.lost[:, 2])
    np.testing.assert_array_equal(got, expected)

    a = velocity_filter_coefficient(sensors.control_period, sensors.velocity_cutoff)
    start = quantise(true[0, index] + noise[0], counts)  # read before the faults
    velocity = np.zeros(JOINTS)
    for k, step in enumerate(np.diff(expected, axis=0, prepend=start[None])):
        velocity = velocity + a * (step / sensors.control_period - velocity)
        np.testing.assert_allclose(speed[k], velocity, rtol=1e-9, atol=1e-9)


def test_drives_take_finite_arrays_only_clip_and_scale_them():
    ctrl = np.zeros(3)
    send = Drives(ctrl, np.zeros(3), np.ones(3)).send
    assert send(np.array([0.5, -3.0, 2.0]))
    np.testing.assert_array_equal(ctrl, [0.5, -1.0, 1.0])
    assert send(np.arange(6.0)[::2] / 10)
    np.testing.assert_array_equal(ctrl, [0.0, 0.2, 0.4])
    for wrong in (
        np.array([0.1, np.nan, 0.1]),
        np.array([0.1, np.inf, 0.1]),
        np.zeros(2),
        np.zeros((3, 1)),
        np.zeros((1, 3)),
        [0.1, 0.1, 0.1],
        None,
        0.1,
    ):
        assert not send(wrong), wrong
        np.testing.assert_array_equal(ctrl, [0.0, 0.2, 0.4])
    scaled = Drives(ctrl, np.array([1.0, 0.0, -2.0]), np.array([3.0, 10.0, 0.5])).send
    assert scaled(np.array([0.5, -3.0, 2.0]))
    np.testing.assert_array_equal(ctrl, [2.5, -10.0, -1.5])


def test_rows_gather_and_stay_inside():
    source, rows = np.arange(4.0), np.zeros((2, 3))
    take = Rows(source, np.array([3, 0, 0]), rows).take
    take(1)
    source[3] = 7.0
    take(0)
    np.testing.assert_array_equal(rows, [[7, 0, 0], [3, 0, 0]])
    with pytest.raises(IndexError):
        take(2)
    with pytest.raises(IndexError):
        Rows(source, np.array([4]), np.zeros((2, 1)))
    with pytest.raises(ValueError, match="rows of another length"):
        Rows(source, np.array([0, 1]), np.zeros((2, 1)))


def test_readings_refuse_arrays_that_do_not_fit():
    fitting = {
        "positions": np.zeros(4),
        "joints": np.array([0, 1]),
        "noise": np.zeros((5, 2)),
        "shift": np.zeros((5, 2)),
        "lost": np.zeros((5, 2), dtype=bool),
        "counts": 0,
        "gain": 1.0,
        "keep": 0.5,
        "position": np.zeros(2),
        "velocity": np.zeros(2),
    }
    with pytest.raises(IndexError):
        Readings(**fitting).read(5)
    for name, wrong in (
        ("shift", np.zeros((4, 2))),
        ("lost", np.zeros((5, 1), dtype=bool)),
        ("velocity", np.zeros(3)),
    ):
        with pytest.raises(ValueError, match="different shapes"):
            Readings(**{**fitting, name: wrong})
    with pytest.raises(IndexError):
        Readings(**{**fitting, "joints": np.array([0, 4])})


def test_headless_steps_give_the_same_bits_and_put_everything_back():
    def run(quiet: bool) -> tuple[np.ndarray, Simulation]:
        simulation = Simulation(load_model("leg"))
        simulation.data.ctrl[:] = 0.05
        simulation.data.sensordata[:] = np.nan
        if quiet:
            with headless(simulation.model):
                simulation.step(200)
        else:
            simulation.step(200)
        data = simulation.data
        return np.concatenate([data.qpos, data.qvel, data.plugin_state]), simulation

    loud, quiet = run(False), run(True)
    np.testing.assert_array_equal(loud[0], quiet[0])
    assert np.isnan(quiet[1].data.sensordata).all()
    assert not np.isnan(loud[1].data.sensordata).any()
    step = mujoco.mjtTimer.mjTIMER_STEP
    assert loud[1].data.timer[step].duration > 0.0
    assert quiet[1].data.timer[step].duration == 0.0
    machine = quiet[1]
    assert machine.model.opt.disableflags == loud[1].model.opt.disableflags
    machine.step()
    assert machine.data.timer[step].duration > 0.0
    assert not np.isnan(machine.data.sensordata).any()


def test_headless_puts_flags_back_after_an_error():
    model = load_model("knee_bench")
    flags = model.opt.disableflags
    with pytest.raises(ZeroDivisionError), headless(model):
        _ = 1 / 0
    assert model.opt.disableflags == flags


def test_the_clock_is_back_when_the_last_of_overlapping_runs_ends():
    simulation, other = (Simulation(load_model("knee_bench")) for _ in range(2))
    flags = simulation.model.opt.disableflags
    duration = simulation.data.timer[mujoco.mjtTimer.mjTIMER_STEP]
    with contextlib.ExitStack() as late:
        first = late.enter_context(contextlib.ExitStack())
        first.enter_context(headless(simulation.model))
        late.enter_context(headless(other.model))
        first.close()
        simulation.step()
        assert duration.duration == 0.0
    assert simulation.model.opt.disableflags == other.model.opt.disableflags == flags
    simulation.step()
    assert duration.duration > 0.0
