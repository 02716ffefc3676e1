"""Learned parts (static forces on joints, command offsets of cylinders) and their library."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from leglab.diagnosis.effects.hypothesis import Key, Library
from leglab.diagnosis.effects.joints import insert
from leglab.diagnosis.plant.model import Change, Machine, Measured, Variant
from leglab.diagnosis.plant.moments import commands_at, forces_at, states_at
from leglab.diagnosis.remainder.splines import CubicSpline
from leglab.machine.parameters import RESIDUAL, RESIDUAL_VARIABLES

_NO_BOUND = 1e9


@dataclass(frozen=True, kw_only=True)
class Periodicity:
    """Repetition of a learned part over the joint's position."""

    length: float  #: rad or m
    interval: tuple[float, float]  #: 95 % confidence interval of `length`
    amplitudes: tuple[float, ...]  #: Amplitudes of the harmonics, the fundamental first


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A learned static force on a joint, or command offset of a cylinder."""

    element: str
    joint: str  #: Joint on whose motion the part depends
    actuator: str  #: Actuator on whose command the part depends; empty if none drives the joint
    oil: bool  #: Whether the part is a command offset of a cylinder, otherwise a force
    terms: Mapping[str, CubicSpline]  #: Additive splines by variable
    period: Periodicity | None = None  #: Repetition over the position; None if not periodic
    bound: float = _NO_BOUND  #: Largest magnitude of the sum of the terms

    @property
    def name(self) -> str:
        """Name of the plugin instance; `Machine.free_name` numbers it if it is taken."""
        return f"{self.element}_remainder"

    def at(self, inputs: Mapping[str, np.ndarray]) -> np.ndarray:
        """Computes the force or offset from an array of inputs per variable, all of one shape."""
        total = np.sum([spline(inputs[v]) for v, spline in self.terms.items()], axis=0)
        return np.clip(total, -self.bound, self.bound)

    def config(self, *, neutral: bool = False) -> dict[str, float | str]:
        """Returns the attributes of its plugin instance; if `neutral`, all coefficients are 0."""
        out: dict[str, float | str] = {"cylinder" if self.oil else "joint": self.element}
        if "command" in self.terms and not self.oil:
            out["actuator"] = self.actuator
        for variable in [v for v in RESIDUAL_VARIABLES if v in self.terms]:
            spline = self.terms[variable]
            weights = np.zeros_like(spline.coefficients) if neutral else spline.coefficients
            out[f"{variable}_knots"] = _numbers(spline.knots)
            out[f"{variable}_coefficients"] = _numbers(weights)
        if not neutral and self.bound < _NO_BOUND:
            out["bound"] = float(f"{self.bound:.6g}")
        return out

    def apply(self, change: Change) -> None:
        """Adds the part to a change; parts with the same knots share a compiled model."""
        config = self.config(neutral=True)
        name = change.machine.free_name(self.name)
        key = ("insert", RESIDUAL, name, *sorted(config.items()))
        change.edit(key, lambda spec: insert(spec, RESIDUAL, name, config))
        change.set_parameter(name, "bound", self.bound)
        for variable, spline in self.terms.items():
            for number, value in enumerate(spline.coefficients.tolist()):
                change.set_parameter(name, f"{variable}_{number}", value)
        if "load" in self.terms and not self.oil:
            change.start(name, "load", partial(self._load, change.machine))

    def _load(
        self, machine: Machine, measured: Measured, variant: Variant, plugin: np.ndarray
    ) -> np.ndarray:
        """Computes the actuator force on the joint at window starts, (windows,)."""
        model, k = variant.model, measured.samples
        states = states_at(machine, model, measured, k, plugin)
        found = forces_at(model, states, commands_at(machine, measured, k))
        return found.load[:, int(model.joint(self.joint).dofadr[0])]

    def write(self, spec: mujoco.MjSpec, machine: Machine) -> None:
        """Adds the part's plugin instance to a specification of a machine."""
        insert(spec, RESIDUAL, machine.free_name(self.name), self.config())


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values.tolist())


class LearnedLibrary(Library):
    """A library of effects that adds learned parts to the change of every hypothesis."""

    def __init__(self, library: Library, parts: Sequence[Part]) -> None:
        self.__dict__.update(library.__dict__)
        self.parts = tuple(parts)

    def change(
        self, hypothesis: Mapping[Key, np.ndarray], machine: Machine, *, written: bool = False
    ) -> Change:
        """Returns the change of the machine by a hypothesis and by the learned parts."""
        change = super().change(hypothesis, machine, written=written)
        for part in self.parts:
            part.apply(change)
        return change
