"""Wrong input to the plugins: one line with element, attribute, value and what is allowed."""

import mujoco
import pytest

from leglab.base.errors import LeglabError
from leglab.machine.plugin import load_error
from tests.plugin_models import compiled, instance, slides, valve


def refusal(xml):
    """The one line a user sees."""
    with pytest.raises((ValueError, mujoco.FatalError)) as caught:
        compiled(xml)
    error = load_error(caught.value, "model.xml")
    assert isinstance(error, LeglabError)
    message = str(error)
    assert "\n" not in message
    assert message.startswith("model.xml")
    return message


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"boore": 0.016}, ["'v'", "boore", "choose one of", "did you mean 'bore'"]),
        ({"bore": None}, ["'v'", "'bore' is missing", "[0.001, 0.5] m"]),
        ({"bore": "wide"}, ["'v'", "'bore' = 'wide'", "not a number", "[0.001, 0.5] m"]),
        ({"bore": "nan"}, ["'bore' = 'nan'", "not a number"]),
        ({"internal_leakage": -1}, ["'internal_leakage' = -1", "[0, 1e-09] m^3/s/Pa"]),
        ({"oil_temperature": 300}, ["'oil_temperature' = 300", "[-40, 150] degC"]),
        ({"dead_volume_a": 0}, ["'v'", "'dead_volume_a' = 0", "(0, 0.01] m^3"]),
        ({"dead_volume_b": 0}, ["'v'", "'dead_volume_b' = 0", "(0, 0.01] m^3"]),
        ({"supply_pressure": -1e5}, ["'supply_pressure' = -100000", "[0, 1e+08] Pa"]),
        ({"tank_pressure": -1}, ["'tank_pressure' = -1", "[0, 1e+07] Pa"]),
        ({"initial_pressure_a": -5}, ["'initial_pressure_a' = -5", "Pa"]),
        ({"rod": 0.016}, ["'v'", "'rod' = 0.016 m", "less than bore = 0.016"]),
        ({"static": 50}, ["'static' = 50 N", "at least coulomb = 100"]),
        ({"viscosity_100": 1e-4}, ["'viscosity_100'", "less than viscosity_40"]),
        ({"substeps": 2.5}, ["'substeps' = 2.5", "whole number"]),
        ({"supply": "pump"}, ["'v'", "'supply' = 'pump'", "leglab.supply instance"]),
    ],
)
def test_wrong_cylinder_attribute(attributes, words):
    message = refusal(slides(valve("v", **attributes)))
    assert all(word in message for word in words), message


def sensor(actuator, quantity):
    return (
        f'<plugin name="gauge" plugin="leglab.sensor"><config key="actuator" value="{actuator}"/>'
        f'<config key="quantity" value="{quantity}"/></plugin>'
    )


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        (
            slides(valve("v"), sensor=sensor("w", "pressure_a")),
            ["'gauge'", "'actuator' = 'w'", "leglab.cylinder actuator"],
        ),
        (
            slides(valve("v"), sensor=sensor("v", "presure_a")),
            ["'gauge'", "presure_a", "pressure_b, piston_position"],
        ),
        (slides(valve("v", joint="rodd")), ["'v'", "'rodd'"]),
        (slides(valve("v").replace('joint="rod"', 'tendon="knee"')), ["'v'", "'knee'"]),
        (
            slides(
                valve("v"),
                extra='<tendon><spatial><site site="a"/><site site="b"/></spatial></tendon>',
            ),
            ["'a'", "not found"],
        ),
        (
            slides("", extension=instance("leglab.spring_damper", "s", joint="x", k1=1)),
            ["'s'", "'joint' = 'x'", "allowed: rod"],
        ),
        (
            slides("", extension=instance("leglab.spring_damper", "s", k1=1)),
            ["'s'", "'joint' is missing"],
        ),
        (
            slides("", extension=instance("leglab.joint_friction", "f", joint="rod", coulomb=3)),
            ["'f'", "'static' = 0", "at least coulomb = 3"],
        ),
        (
            slides("", extension=instance("leglab.supply", "u", supply_pressure=-1)),
            ["'u'", "'supply_pressure' = -1", "[0, 1e+08] Pa"],
        ),
        (
            slides(valve("v")).replace('integrator="implicitfast"', 'integrator="RK4"'),
            ["'v'", "'RK4'", "Euler, implicit, implicitfast"],
        ),
        (
            slides(valve("v"), timestep=2e-3),
            ["'v'", "0.002 s", "allowed 1", "use at most 0.00155 s"],
        ),
        (slides(valve("v"), mass=2.0, timestep=5e-4), ["'v'", "w_h h = 1.02", "allowed 1"]),
    ],
)
def test_wrong_model(xml, words):
    message = refusal(xml)
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: setattr(m.opt, "timestep", 5e-3), ["0.005 s", "too long"]),
        (lambda m: setattr(m.opt, "integrator", mujoco.mjtIntegrator.mjINT_RK4), ["'RK4'"]),
    ],
)
def test_options_changed_after_loading_are_refused_as_well(change, words):
    model, data = compiled(slides(valve("v")))
    mujoco.mj_step(model, data)
    change(model)
    with pytest.raises(mujoco.FatalError) as caught:
        mujoco.mj_step(model, data)
    assert all(word in str(caught.value) for word in ["'v'", *words])
