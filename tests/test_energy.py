"""Nothing is lost: from the supply to the mechanism, over ten seconds of walking."""

import numpy as np
import pytest

import leglab.controllers  # noqa: F401
from leglab.commissioning.calibration import settle
from leglab.commissioning.setup import controller_setup
from leglab.control import Measurement, ReferencePoint, make_controller
from leglab.energy import EnergyBooks
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation, load_model
from leglab.references import make_reference
from leglab.runs.preparation import reference_joints

PERIOD = 2e-3


@pytest.mark.parametrize(("model", "timestep"), [("leg", 1e-3), ("knee_bench", 5e-4)])
def test_energy_balance_of_ten_seconds_of_walking(model, timestep):
    simulation = Simulation(load_model(model, timestep=timestep))
    settle(simulation)
    reference = make_reference("walking_stride", reference_joints(simulation))
    controller = make_controller("pd", controller_setup(simulation, model, SensorConfiguration()))
    times = np.arange(round(10 / PERIOD)) * PERIOD
    books = EnergyBooks(simulation)
    for time, *point in zip(times, *reference.sample(times), strict=True):
        measurement = Measurement(time, simulation.position(), simulation.velocity())
        command = controller.command(measurement, ReferencePoint(*point))
        simulation.data.ctrl[:] = np.clip(command, -1, 1)
        books.step(round(PERIOD / timestep))
    balance = books.balance()
    assert balance.supply > 1000
    # Asked: 1 %. The scheme is off by some 1e-5, so that 1e-3 would show any missing term.
    assert abs(balance.hydraulic_residual) < 1e-3
    assert abs(balance.residual) < 1e-3


def test_the_balance_notices_a_missing_term():
    simulation = Simulation(load_model("knee_bench"))
    settle(simulation)
    books = EnergyBooks(simulation)
    simulation.data.ctrl[:] = 0.2
    books.step(500)
    simulation.data.qvel[:] += 5.0  # some joules out of nowhere
    balance = books.balance()
    assert abs(balance.residual) > 1e-3
