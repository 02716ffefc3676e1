"""Faults of pressure sensors, put beside the model as `machine.sensors` reads them."""

import mujoco

from leglab.diagnosis.effects.base import EffectParameter, Values, register_effect
from leglab.diagnosis.effects.cylinder import CylinderEffect
from leglab.diagnosis.plant.model import CHAMBERS, Change, Machine
from leglab.diagnosis.plant.paths import number_of, set_number, undo_offset, undo_scale
from leglab.machine.sensors import PRESSURE_OFFSET, PRESSURE_SCALE

# Good sensors differ by so much [Pa]. Their gains get no tolerance: two more tangents in every
# linearisation cost a diagnosis 8 % of its time, and 0.5 % of 80 bar is less than this.
_TOLERANCE = 5e4
# Sensors are called after the first joint that a cylinder drives.
_SIDES = tuple(zip(("a", "b"), CHAMBERS, strict=True))


@register_effect
class PressureSensorOffset(CylinderEffect):
    """The zero of a pressure sensor has shifted."""

    name = "pressure_sensor_offset"
    group = "sensing"
    physics = "measured = true + offset, of each chamber's sensor"
    source = "zero drift of industrial transmitters: 0.1 to 0.5 % of 250 bar a year, 1 bar"
    excitation = "pressures of both chambers under different loads and openings"
    rows = tuple(
        EffectParameter(
            f"offset_{side}", "Pa", lower=-4e6, upper=4e6, trials=(2e5,), tolerance=_TOLERANCE
        )
        for side, _ in _SIDES
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Subtracts the offsets from what was measured."""
        joint = change.machine.driven[element][0]
        for side, chamber in _SIDES:
            if offset := values[f"offset_{side}"]:
                change.correct(f"{joint}_{chamber}", undo_offset(offset))

    def write(self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Values) -> None:
        """Adds the numerics, to those that are there: measured = scale x (true + offset) + old."""
        for side, chamber in _SIDES:
            if offset := values[f"offset_{side}"]:
                place = {"joint": machine.driven[element][0], "chamber": chamber}
                name = PRESSURE_OFFSET.format(**place)
                scale = number_of(spec, PRESSURE_SCALE.format(**place), 1.0)
                set_number(spec, name, number_of(spec, name, 0.0) + scale * offset)


@register_effect
class PressureSensorScale(CylinderEffect):
    """A pressure sensor shows too much or too little."""

    name = "pressure_sensor_scale"
    group = "sensing"
    physics = "measured = scale x true, of each chamber's sensor"
    source = "span error of transmitters 0.25 to 1 %; a wrong range or shunt far more"
    excitation = "pressures over a wide range in both chambers"
    rows = tuple(
        EffectParameter(f"scale_{side}", "1", nominal=1.0, lower=0.3, upper=3.0, trials=(1.04,))
        for side, _ in _SIDES
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Divides what was measured by the factors."""
        joint = change.machine.driven[element][0]
        for side, chamber in _SIDES:
            scale = values[f"scale_{side}"]
            if scale != 1.0:
                change.correct(f"{joint}_{chamber}", undo_scale(scale), noise_gain=1.0 / scale)

    def write(self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Values) -> None:
        """Adds the numerics, times those that are there."""
        for side, chamber in _SIDES:
            scale = values[f"scale_{side}"]
            if scale != 1.0:
                place = {"joint": machine.driven[element][0], "chamber": chamber}
                name = PRESSURE_SCALE.format(**place)
                set_number(spec, name, number_of(spec, name, 1.0) * scale)
