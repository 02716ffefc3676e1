"""Faults of encoders and pressure sensors, as custom numerics of the MJCF for `machine.sensors`."""

from collections.abc import Iterator

import mujoco
import numpy as np

from leglab.diagnosis.effects.base import EffectParameter, TableEffect, Values, register_effect
from leglab.diagnosis.effects.cylinder import CylinderEffect
from leglab.diagnosis.effects.joints import JointEffect, SizedRow, travel
from leglab.diagnosis.plant import paths
from leglab.diagnosis.plant.model import CHAMBERS, Change, Machine
from leglab.machine.sensors import delayed_sensor

# Standard deviation of offsets of good pressure sensors [Pa]. Scales have no tolerance, because two
# more unknowns take 8 % of a diagnosis's time, and a scale's error, 0.5 % of 80 bar, is smaller.
_TOLERANCE = 5e4


class SensorFault(TableEffect):
    """Base of faults with a parameter for each sensor, an offset (nominally 0) or a scale (1).

    A joint has one sensor, its encoder; a cylinder has a sensor in each chamber, named after the
    first joint that the cylinder drives.
    """

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Subtracts the offset from measured values, or divides measured values by the scale."""
        for joint, sensor, offset, scale in self._faults(change.machine, element, values):
            for undo, gain in paths.undo(offset, scale):
                change.correct(f"{joint}_{sensor}", undo, noise_gain=gain)

    def write(self, change: Change, element: str, values: Values) -> None:
        """Adds the fault to the scale s and offset o: measured = s (scale x true + offset) + o."""

        def edit(spec: mujoco.MjSpec) -> None:
            for joint, sensor, offset, scale in self._faults(change.machine, element, values):
                names = paths.numerics(joint, sensor)
                old = paths.number_of(spec, names[0], 0.0), paths.number_of(spec, names[1], 1.0)
                if offset:
                    paths.set_number(spec, names[0], old[0] + old[1] * offset)
                elif scale != 1.0:
                    paths.set_number(spec, names[1], old[1] * scale)

        change.edit((self.name, element), edit)

    def _faults(
        self, machine: Machine, element: str, values: Values
    ) -> Iterator[tuple[str, str, float, float]]:
        """Yields joint, sensor ("position" or a chamber), offset and scale."""
        on_cylinder = isinstance(self, CylinderEffect)
        joint = machine.driven[element][0] if on_cylinder else element
        sensors = CHAMBERS if on_cylinder else ("position",)
        for parameter, sensor in zip(self.parameters(machine, element), sensors, strict=True):
            value = values[parameter.name]
            offset, scale = (0.0, value) if parameter.nominal == 1.0 else (value, 1.0)
            yield joint, sensor, offset, scale


@register_effect
class EncoderOffset(SensorFault, JointEffect):
    """The encoder's zero has shifted."""

    name = "encoder_offset"
    group = "sensing"
    physics = "measured = true + offset"
    source = "mounting error of an encoder"
    excitation = "positions over a range in which gravity, lever or springs change"
    rows = (
        SizedRow(
            "offset", "{length}", (-0.06, -0.01, 0.01, 0.06), lower=-0.5, upper=0.5, size=travel
        ),
    )


@register_effect
class EncoderScale(SensorFault, JointEffect):
    """The encoder counts too much or too little."""

    name = "encoder_scale"
    group = "sensing"
    physics = "measured = scale x true, from the joint's zero"
    source = "gear ratio, magnet or potentiometer nonlinearity: some per cent"
    excitation = "large and fast motion"
    rows = (
        EffectParameter(
            "scale", "1", nominal=1.0, lower=0.5, upper=2.0, trials=(0.9, 0.98, 1.02, 1.1)
        ),
    )


@register_effect
class SensorDelay(JointEffect):
    """Measured positions are late."""

    name = "sensor_delay"
    group = "sensing"
    physics = "measured(t) = true(t - delay); commands and pressures are on time"
    source = "fieldbus cycles and filters of encoders: 1 to 20 ms"
    excitation = "fast motion"
    rows = (EffectParameter("delay", "s", upper=0.06, trials=(0.001, 0.004, 0.016)),)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Shifts measured positions forward in time, interpolating between samples."""
        if values["delay"]:
            change.correct(f"{element}_position", paths.undo_delay(values["delay"]))

    def write(self, change: Change, element: str, values: Values) -> None:
        """Adds the delay to the joint's `jointpos` sensor, which is inserted if missing."""

        def edit(spec: mujoco.MjSpec) -> None:
            sensor = spec.sensor(delayed_sensor(element))
            if sensor is None:
                sensor = spec.add_sensor(
                    name=delayed_sensor(element),
                    type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                    objtype=mujoco.mjtObj.mjOBJ_JOINT,
                    objname=element,
                )
            sensor.delay = float(sensor.delay) + values["delay"]
            sensor.nsample = int(np.ceil(sensor.delay / spec.option.timestep)) + 1

        if values["delay"]:
            change.edit((self.name, element), edit)


@register_effect
class PressureSensorOffset(SensorFault, CylinderEffect):
    """The zero of a pressure sensor has shifted."""

    name = "pressure_sensor_offset"
    group = "sensing"
    physics = "measured = true + offset, of each chamber's sensor"
    source = "zero drift of industrial transmitters: 0.1 to 0.5 % of 250 bar a year, 1 bar"
    excitation = "pressures of both chambers under different loads and openings"
    rows = tuple(
        EffectParameter(name, "Pa", lower=-4e6, upper=4e6, trials=(2e5,), tolerance=_TOLERANCE)
        for name in ("offset_a", "offset_b")
    )


@register_effect
class PressureSensorScale(SensorFault, CylinderEffect):
    """A pressure sensor shows too much or too little."""

    name = "pressure_sensor_scale"
    group = "sensing"
    physics = "measured = scale x true, of each chamber's sensor"
    source = "span error of transmitters 0.25 to 1 %; a wrong range or shunt far more"
    excitation = "pressures over a wide range in both chambers"
    rows = tuple(
        EffectParameter(name, "1", nominal=1.0, lower=0.3, upper=3.0, trials=(1.04,))
        for name in ("scale_a", "scale_b")
    )
