"""Wrong input to the plugins: one line with element, attribute, value and what is allowed."""

import re

import mujoco
import pytest

from leglab.base.errors import LeglabError
from leglab.machine.plugin import elements, load_error
from tests.helpers.native_models import backlash, command_path, pendulum
from tests.helpers.plugin_models import compiled, instance, slides, valve


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
        (pendulum(backlash(width=-1)), ["'play'", "'width' = -1", "[0, 10] rad"]),
        (pendulum(backlash(joint="hing")), ["'joint' = 'hing'", "allowed: hinge"]),
        (pendulum(backlash(), actuator=""), ["'hinge' has no native actuator", "motor"]),
        (pendulum(backlash(), joint=""), ["'motor_inertia' = 0", "'hinge' has no armature"]),
        (
            pendulum(backlash(), actuator='<damper name="drive" joint="hinge" ctrlrange="0 1"/>'),
            ["'hinge' has a gain that is not fixed"],
        ),
        (
            pendulum(instance("leglab.command_path", "path", actuator="drvie")),
            ["'actuator' = 'drvie' names no actuator", "allowed: drive"],
        ),
        (pendulum(command_path(gain=1e3)), ["'gain' = 1000", "[-100, 100]"]),
        (pendulum(command_path(max_delay=-1)), ["'max_delay' = -1", "[0, 1] s"]),
        (
            pendulum(
                command_path(), actuator='<muscle name="drive" joint="hinge" lengthrange="-1 1"/>'
            ),
            ["actuator 'drive' has", "fixed nor affine", "allowed: motor"],
        ),
        (
            pendulum(
                command_path(),
                actuator='<motor name="drive" joint="hinge" delay="0.002" nsample="4"/>',
            ),
            ["actuator 'drive' has a delay of its own"],
        ),
        (pendulum(backlash(), integrator="RK4"), ["'RK4'", "Euler, implicit, implicitfast"]),
        (pendulum(command_path(), integrator="RK4"), ["'RK4'"]),
    ],
)
def test_wrong_model(xml, words):
    message = refusal(xml)
    assert all(word in message for word in words), message


def on_joint(kind, plugin, **attributes):
    """A mass on a hinge or a slide with one plugin beside the joint."""
    xml = slides("", extension=instance(plugin, "p", joint="rod", **attributes))
    return xml.replace('type="slide"', f'type="{kind}"')


@pytest.mark.parametrize(
    ("plugin", "name", "value", "hinge", "slide"),
    [
        ("leglab.spring_damper", "k1", 1e7, "N m/rad", "N/m"),
        ("leglab.spring_damper", "k2", 1e7, "N m/rad^3", "N/m^3"),
        ("leglab.spring_damper", "quadratic_damping", -1, "N m s^2/rad^2", "N s^2/m^2"),
        ("leglab.spring_damper", "force_offset", 1e7, "N m", "N"),
        ("leglab.spring_damper", "rest_position", 1e3, "rad", "m"),
        ("leglab.joint_friction", "viscous", 1e7, "N m s/rad", "N s/m"),
        ("leglab.joint_friction", "stribeck_velocity", -1, "rad/s", "m/s"),
        ("leglab.joint_friction", "wear_rate", -1, "1/rad", "1/m"),
        ("leglab.backlash", "motor_inertia", -1, "kg m^2", "kg"),
        ("leglab.residual", "bound", -1, "N m", "N"),
    ],
)
def test_the_unit_is_that_of_the_joint(plugin, name, value, hinge, slide):
    for kind, unit in (("hinge", hinge), ("slide", slide)):
        message = refusal(on_joint(kind, plugin, **{name: value}))
        assert f"'{name}' = {value:g} is out of range" in message
        assert message.endswith(f"] {unit}"), message
    if plugin == "leglab.backlash":  # an instance needs an actuator; the table is the same
        return
    for kind, unit in (("hinge", hinge), ("slide", slide)):
        model, _ = compiled(on_joint(kind, plugin))
        table = elements(model)["p"][1]
        assert table.entry(name).unit == unit
        with pytest.raises(LeglabError, match=re.escape(f"] {unit}") + "$"):
            table.parameters[name].check(value, "p")


@pytest.mark.parametrize(("kind", "force", "place"), [("hinge", "N m", "rad"), ("slide", "N", "m")])
def test_values_that_do_not_go_together_are_told_in_the_unit_of_the_joint(kind, force, place):
    assert f"'static' = 1 {force}; allowed: at least coulomb = 2" in refusal(
        on_joint(kind, "leglab.joint_friction", coulomb=2, static=1)
    )
    assert f"'stop_lower' = 1 {place}; allowed: less than stop_upper = 0" in refusal(
        on_joint(kind, "leglab.spring_damper", stop_lower=1, stop_upper=0)
    )


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
