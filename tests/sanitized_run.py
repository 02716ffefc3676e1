"""Moves the leg while its oil, seals and valves change: what `tests/sanitize.py` watches.

`python -m tests.sanitized_run` steps the machine alone, `... controlled` runs scenarios with the
learning controller too.
"""

import os
import sys
from pathlib import Path

import numpy as np

from leglab._native import hydraulics
from leglab.machine.simulation import Simulation, load_model

CHANGES = {
    "internal_leakage": 1e-11,
    "external_leakage": 1e-12,
    "entrained_air": 0.05,
    "oil_temperature": 5.0,
    "lap": 0.06,
    "hysteresis": 0.06,
    "edge_exponent": 2.0,
    "play": 1e-3,
    "supply_pressure": 6e6,
}


def check_build() -> None:
    """Ends the process if sanitizers were asked for and the modules have none."""
    wanted = os.environ.get("LEGLAB_SANITIZED")
    if wanted and Path(wanted) not in Path(hydraulics.__file__).parents:
        sys.exit(f"{hydraulics.__file__} is not the build in {wanted}")


def move(steps: int = 150) -> None:
    """Steps the leg by random commands while parameters of all elements change."""
    simulation = Simulation(load_model("leg"))
    rng = np.random.default_rng(1)
    changes = list(CHANGES.items())
    for step in range(steps):
        if step % 10 == 5 and changes:
            name, value = changes.pop()
            for element in simulation.elements:
                if simulation.has(element, name):
                    simulation.set_parameter(element, name, value)
        simulation.data.ctrl[:] = rng.uniform(-1.2, 1.2, simulation.model.nu)
        simulation.step()
    assert not changes
    assert np.isfinite(simulation.data.plugin_state).all()


def control() -> None:
    """Runs the learning controllers on the knee bench and the leg."""
    from leglab import RunSettings, run_scenario

    for scenario, controller, model in (
        ("seal_wear", "bsnn_arx", "leg"),
        ("valve_wear", "bsnn_arx_pressure", "knee_bench"),
        ("air_in_oil", "arx", "knee_bench"),
        ("cold_oil", "bsnn_arx_paper", "knee_bench"),
        ("sensor_dropout", "bsnn_arx", "knee_bench"),
    ):
        asked = RunSettings(scenario=scenario, controller=controller, model=model, duration=0.3)
        assert not run_scenario(asked).history.failure


if __name__ == "__main__":
    check_build()
    move()
    if "controlled" in sys.argv:
        control()
    print("moved")
