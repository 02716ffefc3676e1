"""Faults of a joint's position sensor, put beside the model as `machine.sensors` reads them."""

import mujoco
import numpy as np

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, Values, register_effect
from leglab.diagnosis.effects.joints import JointEffect, JointRow
from leglab.diagnosis.plant.model import Change, Machine
from leglab.diagnosis.plant.paths import number_of, set_number, undo_delay, undo_offset, undo_scale
from leglab.machine.sensors import ENCODER_OFFSET, ENCODER_SCALE, delayed_sensor


@register_effect
class EncoderOffset(JointEffect):
    """The encoder's zero has shifted."""

    name = "encoder_offset"
    group = "sensing"
    physics = "measured = true + offset"
    source = "mounting error of an encoder"
    excitation = "positions over a range in which gravity, lever or springs change"
    rows = (
        JointRow(
            "offset",
            "{length}",
            (-0.06, -0.01, 0.01, 0.06),
            lower=-0.5,
            upper=0.5,
            size=joints.travel,
        ),
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Subtracts the offset from what was measured."""
        if values["offset"]:
            change.correct(f"{element}_position", undo_offset(values["offset"]))

    def write(self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Values) -> None:
        """Adds the numeric, to one that is there: measured = scale x (true + offset) + old."""
        name = ENCODER_OFFSET.format(joint=element)
        scale = number_of(spec, ENCODER_SCALE.format(joint=element), 1.0)
        set_number(spec, name, number_of(spec, name, 0.0) + scale * values["offset"])


@register_effect
class EncoderScale(JointEffect):
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

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Divides what was measured by the factor."""
        scale = values["scale"]
        if scale != 1.0:
            change.correct(f"{element}_position", undo_scale(scale), noise_gain=1.0 / scale)

    def write(self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Values) -> None:
        """Adds the numeric, times one that is there."""
        name = ENCODER_SCALE.format(joint=element)
        set_number(spec, name, number_of(spec, name, 1.0) * values["scale"])


@register_effect
class SensorDelay(JointEffect):
    """Positions are shown late."""

    name = "sensor_delay"
    group = "sensing"
    physics = "measured(t) = true(t - delay); commands and pressures are on time"
    source = "fieldbus cycles and filters of encoders: 1 to 20 ms"
    excitation = "fast motion"
    rows = (EffectParameter("delay", "s", upper=0.06, trials=(0.001, 0.004, 0.016)),)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Brings the measured positions forward, interpolating between samples."""
        if values["delay"]:
            change.correct(f"{element}_position", undo_delay(values["delay"]))

    def write(self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Values) -> None:
        """Adds a `jointpos` sensor with MuJoCo's own delay, or to that of one that is there."""
        delay = values["delay"]
        if not delay:
            return
        sensor = spec.sensor(delayed_sensor(element))
        if sensor is None:
            sensor = spec.add_sensor(
                name=delayed_sensor(element),
                type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=element,
            )
        sensor.delay = float(sensor.delay) + delay
        sensor.nsample = int(np.ceil(sensor.delay / spec.option.timestep)) + 1
