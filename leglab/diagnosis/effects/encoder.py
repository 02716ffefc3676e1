"""Faults of a joint's position encoder."""

from collections.abc import Mapping

import numpy as np

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.machine import Machine


@register
class EncoderOffset(Effect):
    """The encoder's zero has shifted."""

    name = "encoder_offset"
    group = "sensing"
    physics = "measured = true + offset"
    source = "mounting error of an encoder"
    excitation = "positions over a range in which gravity, lever or springs change"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All joints."""
        return machine.joints

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The offset."""
        del machine, element
        return (
            EffectParameter(
                name="offset",
                unit="rad or m",
                nominal=0.0,
                lower=-0.5,
                upper=0.5,
                trials=(-0.06, -0.01, 0.01, 0.06),
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
