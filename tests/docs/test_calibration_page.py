"""Tables of docs/guides/calibration.md: what controllers ask for."""

from dataclasses import fields

import pytest

import leglab.controllers  # noqa: F401  registers the controllers
from leglab.base.registry import FactoryRegistry
from leglab.base.settings import Configuration
from leglab.control import Foreknowledge, Measurement, NominalMachine, controller_names
from leglab.control.contract import CONTROLLERS

pytestmark = pytest.mark.slow("our own figures")
YARDSTICKS = {"exact_inverse", "frozen", "oracle"}
CHANGES = {field.name for field in fields(Foreknowledge)}


@pytest.fixture
def page():
    import calibration_tables

    return calibration_tables


@pytest.mark.parametrize("name", controller_names())
def test_only_yardsticks_know_of_the_changes_of_a_run(name, page):
    assert bool(page.told(name) & CHANGES) == (name in YARDSTICKS)


@pytest.mark.parametrize("name", controller_names())
def test_pressures_are_used_by_those_that_say_so_alone(name, page):
    used = {kind for kind in page.measured(name) if "pressure" in kind}
    assert bool(used) == bool(getattr(CONTROLLERS.get(name).factory, "uses_pressures", False))
    assert "position" in page.measured(name)


def test_what_is_told_is_what_is_asked_for(page):
    assert page.told("pd") == {"direction", "position_gain", "velocity_gain", "setpoint"}
    assert "valve_maps.command" in page.told("static_feedforward")
    assert "valve_maps.velocity" in page.told("bsnn_arx_paper")
    assert "valve_maps.command" not in page.told("bsnn_arx_paper")
    assert "reference_period" in page.told("ilc")
    assert "reference_period" not in page.told("adrc")


def test_everything_that_can_be_known_has_a_row(page):
    rows = {name.partition(".")[0]: meaning for name, _, meaning in page.told_rows()}
    machine = set(NominalMachine.__annotations__)
    readings = set(Measurement._fields) - {"time"}
    assert rows.keys() == machine | CHANGES | readings | {"fault_bank", "reference_period"}
    assert all(rows.values())


class Asking:
    """Asks for one entry of the data sheets and looks at one pressure."""

    def __init__(self, setup, config):
        self.supply = setup.machine.cylinders.supply_pressure
        self.change = setup.foreknowledge.first_change

    def reset(self, measurement):
        pass

    def command(self, measurement, reference):
        return measurement.pressure_a / self.supply


def test_a_controller_that_asks_for_more_is_noted(page, monkeypatch):
    registry = FactoryRegistry("controller")
    registry.register("asking", summary="asks", configuration=Configuration)(Asking)
    monkeypatch.setattr(page, "CONTROLLERS", registry)
    assert page.told("asking") == {"cylinders", "cylinders.supply_pressure", "first_change"}
    assert page.measured("asking") == {"pressure_a"}
