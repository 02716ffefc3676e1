import numpy as np
import pytest
from pydantic import BaseModel, Field

from leglab import RunSettings
from leglab.base.errors import LeglabError
from leglab.base.registry import FactoryRegistry
from leglab.base.settings import Configuration
from leglab.control import (
    ControllerSetup,
    Measurement,
    NominalMachine,
    ReferencePoint,
    check_command,
    contract,
    controller_names,
    controller_summary,
    make_controller,
    register_controller,
)
from leglab.runs.loop import Loop

SETUP = ControllerSetup(
    joints=("hip", "knee"), control_period=0.002, machine=NominalMachine(position_gain=3.0)
)


class Gains(Configuration):
    gain: float = Field(default=1.5, gt=0)


class Proportional:
    def __init__(self, setup, config):
        self.gain = config.gain
        self.machine_gain = setup.machine.position_gain

    def reset(self, measurement):
        pass

    def command(self, measurement, reference):
        return self.gain * (reference.position - measurement.position)

    def diagnostics(self):
        return {}


@pytest.fixture(autouse=True)
def _own_registry(monkeypatch):
    monkeypatch.setattr(contract, "CONTROLLERS", FactoryRegistry("controller"))
    register_controller("proportional", summary="a gain", configuration=Gains)(Proportional)


def test_made_by_name():
    assert controller_names() == ("proportional",)
    assert controller_summary("proportional") == "a gain"
    controller = make_controller("proportional", SETUP, {"gain": 2})
    measurement = Measurement(0.0, np.array([0.1, 0.2]), np.zeros(2))
    reference = ReferencePoint(np.array([0.2, 0.2]), np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(controller.command(measurement, reference), [0.2, 0])
    assert controller.machine_gain == 3.0
    assert make_controller("proportional", SETUP).gain == 1.5


@pytest.mark.parametrize(
    ("name", "config", "message"),
    [
        ("propotional", {}, "unknown controller 'propotional'.*did you mean 'proportional'"),
        ("proportional", {"gian": 1}, "setting of controller 'proportional' 'gian': .* 'gain'"),
        ("proportional", {"gain": 0}, "controller 'proportional': setting 'gain' is 0: input shou"),
    ],
)
def test_bad_names_and_settings(name, config, message):
    with pytest.raises(LeglabError, match=message):
        make_controller(name, SETUP, config)


def test_missing_machine_data():
    setup = ControllerSetup(
        joints=("knee",), control_period=0.002, machine=NominalMachine(latency=1)
    )
    with pytest.raises(
        LeglabError, match="needs 'position_gain' of the machine, which gives latency"
    ):
        make_controller("proportional", setup)


def test_setup_is_checked_and_frozen():
    with pytest.raises(LeglabError, match="must be distinct"):
        ControllerSetup(joints=("knee", "knee"), control_period=0.002)
    for period in (0, float("nan"), float("inf")):
        with pytest.raises(LeglabError, match="control_period"):
            ControllerSetup(joints=("knee",), control_period=period)
    with pytest.raises(AttributeError):
        SETUP.joints = ("hip",)
    with pytest.raises(LeglabError, match="unknown property of a nominal machine 'gian'"):
        NominalMachine(gian=1)


def test_good_commands_pass_as_they_are():
    command = np.array([0.5, -1.5])
    assert check_command(command, SETUP, "pd", 0.0) is command
    # Too large to be squared, yet finite: the valve saturates it.
    with np.errstate(over="ignore"):
        assert check_command(np.array([1e200, 0]), SETUP, "pd", 0.0)[0] == 1e200


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (np.zeros(3), r"'pd' gave shape \(3,\) at 1.5 s, allowed is an array of shape \(2,\)"),
        (np.zeros((2, 1)), r"gave shape \(2, 1\)"),
        ([0.0, 0.0], "gave list"),
        (None, "gave NoneType"),
        (np.array([0, np.nan]), "gave nan for joint 'knee' at 1.5 s"),
        (np.array([-np.inf, 0]), "gave -inf for joint 'hip'"),
    ],
)
def test_bad_commands_are_named(command, message):
    with pytest.raises(LeglabError, match=message):
        check_command(command, SETUP, "pd", 1.5)


class Held:
    """Holds the valves; reports nothing and has no settings."""

    def __init__(self, setup):
        self.command_of_all = np.zeros(len(setup.joints))

    def reset(self, measurement):
        """Starts a run."""

    def command(self, measurement, reference):
        """Valve commands."""
        return self.command_of_all


def test_reports_and_settings_are_optional():
    register_controller("held", summary="holds")(Held)
    assert isinstance(make_controller("held", SETUP), Held)
    with pytest.raises(LeglabError, match="'held' has no settings, but 'gain' was given"):
        make_controller("held", SETUP, {"gain": 1.0})
    one = ControllerSetup(joints=("knee",), control_period=0.002)
    loop = Loop(
        RunSettings(scenario="nominal", model="knee_bench", duration=0.1), controller=Held(one)
    )
    assert np.all(loop.run().command == 0.0)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"command": None}, "has no method 'command'; needed are reset"),
        ({"reset": lambda self: None}, r"reset takes \(self\); needed is reset\(measurement\)"),
    ],
)
def test_a_class_that_is_no_controller_is_refused_when_it_is_registered(broken, message):
    wrong = type("Wrong", (Held,), broken)
    with pytest.raises(LeglabError, match=message):
        register_controller("wrong", summary="wrong")(wrong)


def test_settings_that_take_any_name_are_refused():
    class Loose(BaseModel):
        gain: float = 1.0

    with pytest.raises(
        LeglabError, match="configuration is .*Loose; allowed: a subclass of leglab"
    ):
        register_controller("loose", summary="loose", configuration=Loose)
