"""Faults of a joint's position sensor."""

from collections.abc import Mapping

import mujoco
import numpy as np

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.machine import Machine


class EncoderEffect(Effect):
    """Base: sits on all joints, and is written beside the model as a numeric.

    A model has no place for what its sensors do wrong, so the patched one gets a custom numeric
    `<joint>_<effect>`; the delay becomes that of a `jointpos` sensor.
    """

    group = "sensing"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All joints."""
        return machine.joints

    def write(
        self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Mapping[str, float]
    ) -> None:
        """Adds the numeric."""
        del machine
        (value,) = values.values()
        spec.add_numeric(name=f"{element}_{self.name}", data=[value], size=1)


@register
class EncoderOffset(EncoderEffect):
    """The encoder's zero has shifted."""

    name = "encoder_offset"
    physics = "measured = true + offset"
    source = "mounting error of an encoder"
    excitation = "positions over a range in which gravity, lever or springs change"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Joints whose position matters: a free slide is the same everywhere."""
        return machine.joints

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
        offset = values["offset"]

        def undo(samples: np.ndarray, period: float) -> np.ndarray:
            del period
            return samples - offset

        if offset:
            change.correct(f"{element}_position", undo)


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

        def undo(samples: np.ndarray, period: float) -> np.ndarray:
            del period
            return samples / scale

        if scale != 1.0:
            change.correct(f"{element}_position", undo, noise_gain=1.0 / scale)


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
        delay = values["delay"]

        def undo(samples: np.ndarray, period: float) -> np.ndarray:
            index = np.arange(samples.size)
            return np.interp(index + delay / period, index, samples)

        if delay:
            change.correct(f"{element}_position", undo)

    def write(
        self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Mapping[str, float]
    ) -> None:
        """Adds a `jointpos` sensor with MuJoCo's own delay."""
        del machine
        if values["delay"]:
            spec.add_sensor(
                name=f"{element}_delayed_position",
                type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=element,
                delay=values["delay"],
                nsample=int(np.ceil(values["delay"] / spec.option.timestep)) + 1,
            )
