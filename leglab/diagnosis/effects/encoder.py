"""Faults of a joint's position sensor."""

from collections.abc import Mapping

import mujoco
import numpy as np

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.model import Change, Machine
from leglab.diagnosis.paths import number_of, undo_delay, undo_offset, undo_scale
from leglab.machine.sensors import ENCODER_OFFSET, ENCODER_SCALE, delayed_sensor


class EncoderEffect(Effect):
    """Base: sits on all joints, and is written beside the model, see `leglab.machine.sensors`."""

    group = "sensing"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All joints."""
        return machine.joints


@register
class EncoderOffset(EncoderEffect):
    """The encoder's zero has shifted."""

    name = "encoder_offset"
    physics = "measured = true + offset"
    source = "mounting error of an encoder"
    excitation = "positions over a range in which gravity, lever or springs change"

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The offset."""
        travel = 1.0 if joints.unit(machine, element) == "rad" else 0.2
        return (
            EffectParameter(
                name="offset",
                unit=joints.unit(machine, element),
                nominal=0.0,
                lower=-0.5 * travel,
                upper=0.5 * travel,
                trials=tuple(share * travel for share in (-0.06, -0.01, 0.01, 0.06)),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Subtracts the offset from what was measured."""
        if values["offset"]:
            change.correct(f"{element}_position", undo_offset(values["offset"]))

    def write(
        self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Mapping[str, float]
    ) -> None:
        """Adds the numeric, to one that is there: measured = scale x (true + offset) + old."""
        del machine
        name = ENCODER_OFFSET.format(joint=element)
        scale = number_of(spec, ENCODER_SCALE.format(joint=element), 1.0)
        _set_numeric(spec, name, number_of(spec, name, 0.0) + scale * values["offset"])


@register
class EncoderScale(EncoderEffect):
    """The encoder counts too much or too little."""

    name = "encoder_scale"
    physics = "measured = scale x true, from the joint's zero"
    source = "gear ratio, magnet or potentiometer nonlinearity: some per cent"
    excitation = "large and fast motion"

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The factor."""
        del machine, element
        return (
            EffectParameter(
                name="scale",
                unit="1",
                nominal=1.0,
                lower=0.5,
                upper=2.0,
                trials=(0.9, 0.98, 1.02, 1.1),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Divides what was measured by the factor."""
        scale = values["scale"]
        if scale != 1.0:
            change.correct(f"{element}_position", undo_scale(scale), noise_gain=1.0 / scale)

    def write(
        self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Mapping[str, float]
    ) -> None:
        """Adds the numeric, times one that is there."""
        del machine
        name = ENCODER_SCALE.format(joint=element)
        _set_numeric(spec, name, number_of(spec, name, 1.0) * values["scale"])


@register
class SensorDelay(EncoderEffect):
    """Positions are shown late."""

    name = "sensor_delay"
    physics = "measured(t) = true(t - delay); commands and pressures are on time"
    source = "fieldbus cycles and filters of encoders: 1 to 20 ms"
    excitation = "fast motion"

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The delay."""
        del machine, element
        return (
            EffectParameter(
                name="delay",
                unit="s",
                nominal=0.0,
                lower=0.0,
                upper=0.06,
                trials=(0.001, 0.004, 0.016),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Brings the measured positions forward, interpolating between samples."""
        if values["delay"]:
            change.correct(f"{element}_position", undo_delay(values["delay"]))

    def write(
        self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Mapping[str, float]
    ) -> None:
        """Adds a `jointpos` sensor with MuJoCo's own delay, or to that of one that is there."""
        del machine
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


def _set_numeric(spec: mujoco.MjSpec, name: str, value: float) -> None:
    numeric = spec.numeric(name)
    if numeric is None:
        spec.add_numeric(name=name, data=[value], size=1)
    else:
        numeric.data = [value]
