"""Cylinders that cannot sit where a model has them are refused with one line."""

from pathlib import Path

import pytest

import leglab.models
from leglab.base.errors import LeglabError, ModelError
from leglab.machine.simulation import Simulation, load_model

_BENCH = (Path(leglab.models.__path__[0]) / "knee_bench.xml").read_text()


def machine(tmp_path, *changes: tuple[str, str]) -> Simulation:
    text = _BENCH
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "bench.xml"
    file.write_text(text)
    return Simulation(load_model(file))


def test_anchors_beyond_the_stroke_are_refused_with_angle_length_and_stroke(tmp_path):
    middle = '"mid_length" value="0.27718582981545115"', '"mid_length" value="0.34"'
    with pytest.raises(ModelError) as raised:
        machine(tmp_path, middle)
    assert str(raised.value) == (
        "cylinder 'knee_valve' with joint 'knee' at 1.8 rad: its anchors are 0.2542 m apart; "
        "allowed: 0.3 to 0.38 m (mid_length 0.34 m, stroke 0.08 m)"
    )


def test_a_lever_arm_through_zero_is_refused(tmp_path):
    range_ = 'range="0 1.8"', 'range="0 2.1"'
    longer = '"stroke" value="0.080"', '"stroke" value="0.120"'
    with pytest.raises(ModelError, match="lever arm on joint 'knee' passes zero near 1.84 rad"):
        machine(tmp_path, range_, longer)


def test_errors_of_mujoco_are_told_without_what_it_says_of_shapes(tmp_path):
    file = tmp_path / "bench.xml"
    file.write_text(_BENCH.replace('timestep="0.0005"', 'timestep="0.004"'))
    with pytest.raises(LeglabError, match=r"use at most 0.00357 s$"):
        load_model(file, visual=False)
    assert load_model(file, timestep=5e-4).opt.timestep == 5e-4
