"""Where the hydraulic energy of a run goes: the books of all cylinders and of the mechanism."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.machine.simulation import Simulation

_BOOKS = ("supply", "valve", "leakage", "friction", "stored", "load")


@dataclass(frozen=True, kw_only=True)
class EnergyBalance:
    """Energies since the books were opened [J].

    Attributes:
        supply: Taken from the supply, less what was given to the tank.
        valve: Lost at the metering edges.
        leakage: Lost in the gaps.
        friction: Lost in seals and end stops.
        stored: Put into compression, the integral of p V/beta dp.
        load: Work of the cylinders on the mechanism.
        mechanical: Change of kinetic and potential energy of the mechanism.
        dissipated: Lost in joint dampers, net of what springs hold.
        constraint: Taken out by joint limits and contact.
    """

    supply: float
    valve: float
    leakage: float
    friction: float
    stored: float
    load: float
    mechanical: float
    dissipated: float
    constraint: float

    @property
    def hydraulic_residual(self) -> float:
        """What the cylinders' books miss, over the energy supplied."""
        spent = self.valve + self.leakage + self.friction + self.stored + self.load
        return (self.supply - spent) / self.supply

    @property
    def residual(self) -> float:
        """What the whole balance misses, from the supply to the mechanism, over the supply."""
        spent = self.valve + self.leakage + self.friction + self.stored
        spent += self.mechanical + self.dissipated + self.constraint
        return (self.supply - spent) / self.supply


class EnergyBooks:
    """Opens the books of a simulation; call `step` instead of `Simulation.step`."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._slots = {name: simulation.slots(f"energy_{name}") for name in _BOOKS}
        self._start = self._hydraulic()
        self._start_mechanical = self._mechanical()
        self._passive = self._constraint = 0.0

    def step(self, count: int = 1) -> None:
        """Advances by single time steps and adds up the work of passive and constraint forces."""
        data, timestep = self._simulation.data, self._simulation.model.opt.timestep
        for _ in range(count):
            before = data.qvel.copy()
            self._simulation.step()
            # Forces of the step are still in `data`; they act over the mean velocity.
            path = 0.5 * timestep * (before + data.qvel)
            self._passive += float(data.qfrc_passive @ path)
            self._constraint += float(data.qfrc_constraint @ path)

    def balance(self) -> EnergyBalance:
        """The balance until now."""
        now = self._hydraulic()
        return EnergyBalance(
            **{name: now[name] - self._start[name] for name in _BOOKS},
            mechanical=self._mechanical() - self._start_mechanical,
            dissipated=-self._passive,
            constraint=-self._constraint,
        )

    def _hydraulic(self) -> dict[str, float]:
        state = self._simulation.data.plugin_state
        return {name: float(np.sum(state[slots])) for name, slots in self._slots.items()}

    def _mechanical(self) -> float:
        # On a copy: evaluating energies must not touch the run.
        model = self._simulation.model
        data = mujoco.MjData(model)
        mujoco.mj_copyData(data, model, self._simulation.data)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy.sum())
