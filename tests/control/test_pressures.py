"""`bsnn_arx_pressure` in the closed loop: what pressures tell at once, and what it needs."""

from dataclasses import replace

import numpy as np
import pytest

from leglab import RunSettings
from leglab.base.errors import LeglabError
from leglab.control import Measurement, make_controller
from leglab.runs.loop import Loop

NAME = "bsnn_arx_pressure"


def run(controller, **settings):
    """The loop, and what it left behind."""
    loop = Loop(RunSettings(**{"controller": controller, "duration": 8.0, **settings}))
    history = loop.run()
    assert not history.failure, history.failure
    return loop, history


def test_a_fallen_supply_pressure_is_no_damage_where_it_is_measured():
    errors = {}
    for controller in ("bsnn_arx", NAME):
        _, history = run(controller, scenario="supply_drop")
        after = (history.time >= 4.0) & (history.time < 5.2)
        errors[controller] = float(np.sqrt(np.mean(history.error[after] ** 2)))
    assert errors[NAME] < errors["bsnn_arx"] / 3


def test_the_load_map_learns_what_the_pressures_show():
    loop, _ = run(NAME, scenario="nominal", model="knee_bench", duration=6.0)
    adaptation = loop.controller.adaptation
    assert adaptation.loads.diagnostics(0)["learned"] > 1000
    assert np.abs(adaptation.loads.parameters).max() > 0.01


def test_without_pressures_there_is_one_line():
    loop = Loop(RunSettings(scenario="nominal", controller=NAME, model="knee_bench"))
    controller = make_controller(NAME, replace(loop._setup), {})
    one = np.zeros(1)
    with pytest.raises(LeglabError, match=f"controller '{NAME}' needs measured pressures"):
        controller.reset(Measurement(0.0, one, one))


def test_the_forward_route_is_refused():
    loop = Loop(RunSettings(scenario="nominal", controller="pd", model="knee_bench"))
    with pytest.raises(LeglabError, match="route"):
        make_controller(NAME, loop._setup, {"route": "forward"})
