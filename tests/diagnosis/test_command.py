"""Whole diagnoses by the command, of every regime: improved.xml is there and loads in MuJoCo."""

import numpy as np
import pytest

from benchmarks.self_test.command import diagnosed
from benchmarks.self_test.exact import Case, make
from leglab import Recording
from leglab.base.errors import SimulationError
from rigs import PENDULUM, Truth
from rigs.rough_bench import rough_case
from tests.helpers.unpleasant import of_kinds


def exact():
    recordings, _ = make(Case(kind="single", number=0, effects=("valve_deadband",)), 9001)
    return {"model": "knee_bench", "recordings": recordings, "effects": ("valve_deadband",)}


def rough():
    made = rough_case(5, ("internal_leakage",), duration=4.0)
    found = {"recordings": made.recordings, "healthy": made.healthy}
    return {"model": "knee_bench", "effects": ("internal_leakage", "payload"), **found}


def native():
    logs = of_kinds(PENDULUM, Truth(offset=0.5), ("multisine", "fast"), seconds=4.0)
    return {"model": PENDULUM.model, "recordings": logs, "effects": ("force_offset", "armature")}


@pytest.mark.slow("whole diagnoses by the command")
@pytest.mark.parametrize("case", [exact, rough, native])
def test_the_command_writes_a_model_that_loads(case):
    given = case()
    content = diagnosed(**given)
    assert content["missing"] is None
    assert content["model"] == "improved.xml"
    assert [e["name"] for e in content["effects"]] == [given["effects"][0]]


def test_a_result_that_the_command_does_not_give_is_lost():
    time = 0.002 * np.arange(50)
    nothing = Recording(time=time, columns={"knee_position": 0.0 * time})
    with pytest.raises(SimulationError, match="ends with status 2: error: .*knee_valve_command"):
        diagnosed("knee_bench", {"one": nothing})


@pytest.mark.slow("a whole diagnosis by the command")
def test_a_state_with_which_the_error_grows_is_named():
    def joined(good, bad):
        shift = good.time[-1] + 0.5
        columns = {name: np.append(good[name], bad[name]) for name in good.columns}
        columns["mode"] = np.repeat([1.0, 2.0], [len(good), len(bad)])
        return Recording(time=np.append(good.time, bad.time + shift), columns=columns)

    kinds = ("multisine", "fast")
    good, bad = (of_kinds(PENDULUM, Truth(offset=x), kinds, seconds=6.0) for x in (0.0, 0.5))
    logs = {name: joined(good[name], bad[name]) for name in good}
    content = diagnosed(PENDULUM.model, logs, effects=("armature",))
    assert any("times that of the other windows while mode = 2" in n for n in content["notes"])
