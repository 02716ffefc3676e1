"""Batch of machines: control periods run in C++ threads, all else is computed with arrays.

Each machine is a separate closed loop (`leglab.runs.loop.Loop`) with its own episode, scenario,
specimen and noise. Its results equal those of the same episode run alone, to the bit; only the time
steps of all machines are run together (`leglab._native.batch`).
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from leglab._native.batch import Batch as Core
from leglab._native.identification import Team
from leglab.base.errors import ModelError, SettingsError
from leglab.control import (
    Controller,
    ControllerSetup,
    Measurement,
    NominalMachine,
    ReferencePoint,
    make_controller,
)
from leglab.control.contract import CONTROLLERS, diagnostics_of
from leglab.control.feedforward.adaptive import step_together
from leglab.control.torque import TorqueLoop
from leglab.controllers.bsnn_arx import AdaptiveController
from leglab.environment.episodes import Episode, Episodes
from leglab.environment.observations import Scale, flat_scale, observation_scales
from leglab.environment.plan import Plan, checked_action
from leglab.environment.rewards import Transition
from leglab.machine.sensors import loop_timing, velocity_filter_coefficient
from leglab.machine.simulation import SPEED_LIMIT, Simulation
from leglab.runs.loop import Loop
from leglab.runs.preparation import Preparation

# Names of the controller settings that have one value per joint.
_PER_JOINT = ("position_gain", "velocity_gain")


@dataclass(slots=True)
class BatchMachine:
    """One machine of a batch: simulation, source of episodes, and the present episode."""

    simulation: Simulation
    episodes: Episodes
    loop: Loop | None = None
    episode: Episode | None = None


class Batch:
    """Machines that are stepped together by whole control periods.

    Arrays have one row per machine and change with the next step.

    Args:
        plan: Settings of the environment.
        episodes: Sources of random episodes, one per machine.
        threads: Number of threads that step machines; None for one per core.

    Attributes:
        count: Number of machines.
        joints: Names of the joints.
        observation: As of `LegEnv` with `flat_observation=True`, float32, (machines, size).
        limits: Bounds of an observation's values, infinite without a bound, (size,).
        torque_limit: Torque [N m] of an action of 1, (joints,); None if actions are not torques.
        command: Commands that were sent last, in [-1, 1], (machines, joints).
        error: True tracking error, position less reference [rad], (machines, joints).
        steps: Control periods since the start of the episodes, (machines,).
        terminated: Mask: the simulation blew up or an error exceeded the limit, (machines,).
        truncated: Mask: the duration of the episode is over, (machines,).

    Raises:
        LeglabError: A setting does not fit, or the model itself defines sensor faults.
    """

    def __init__(self, plan: Plan, episodes: Sequence[Episodes], *, threads: int | None) -> None:
        self._plan, self._scale, preparation = plan, plan.residual_scale, plan.preparation
        self._machines = [BatchMachine(preparation.machine(), each) for each in episodes]
        for machine in self._machines:  # sensor outputs are not used
            machine.simulation.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self.period = plan.period
        self.count, self.joints = len(self._machines), preparation.nominal.joints
        shape = self.count, len(self.joints)
        self.position, self.velocity = np.zeros(shape), np.zeros(shape)
        self.true_position, self.true_velocity = np.zeros(shape), np.zeros(shape)
        self.reference = ReferencePoint(np.zeros(shape), np.zeros(shape), np.zeros(shape))
        hydraulic = len(preparation.nominal.hydraulic_joints)
        self._pressure = np.zeros((self.count, 2 * hydraulic + bool(hydraulic)))
        self.command, self.previous = np.zeros(shape), np.zeros(shape)
        self.action, self._wish, self._forward = (np.zeros(shape) for _ in range(3))
        self.error = np.zeros(shape)
        self.steps = np.zeros(self.count, dtype=np.int64)
        self._due = np.full(self.count, np.inf)
        self.diverged = np.zeros(self.count, dtype=bool)
        self.terminated, self.truncated = self.diverged.copy(), self.diverged.copy()
        threads = threads or len(os.sched_getaffinity(0))
        self._begin_controller(preparation, threads)
        self.torque_limit: np.ndarray | None = None
        if plan.cylinders is not None:
            self.torque_limit = TorqueLoop(plan.cylinders, self.period).limit
            all_joints = np.tile(np.arange(len(plan.cylinders.stroke)), self.count)
            self._torque = TorqueLoop(plan.cylinders.joints(all_joints), self.period)
        sizes = self._sizes(hydraulic)
        self._raw = np.zeros((self.count, sum(sizes.values())), dtype=np.float32)
        self.observation = self._raw
        self.limits = np.full(self._raw.shape[1], np.inf, dtype=np.float32)
        self._scaled: Scale | None = None
        if plan.normalize:
            self._scaled = flat_scale(observation_scales(preparation), sizes)
            self.limits = np.asarray(self._scaled.limit)
        self._core = self._made_core(preparation, threads)

    def _made_core(self, preparation: Preparation, threads: int) -> Core:
        """Makes the core, which steps the machines and writes into the arrays of the batch."""
        sensors, nominal = preparation.sensors, preparation.nominal
        slots = [nominal.slots(name) for name in ("pressure_a", "pressure_b")]
        timing = loop_timing(sensors, nominal.model.opt.timestep)
        gain = velocity_filter_coefficient(self.period, sensors.velocity_cutoff) / self.period
        return Core(
            machines=self.count,
            threads=threads,
            timing={
                "to_sample": timing.to_sample,
                "to_command": timing.to_command,
                "speed_limit": SPEED_LIMIT,
                "counts": sensors.encoder_counts,
                "gain": gain,
                "keep": 1.0 - gain * self.period,
            },
            qpos=np.asarray(nominal.qpos_index, dtype=np.int64),
            dof=np.asarray(nominal.dof_index, dtype=np.int64),
            centre=nominal.centre,
            half=nominal.half,
            pressures=np.concatenate(slots).astype(np.int64),
            supply=nominal.supply_slot if nominal.hydraulic_joints else -1,
            preview=self._plan.ahead,
            out={
                "position": self.position,
                "velocity": self.velocity,
                "pressure": self._pressure,
                "true_position": self.true_position,
                "true_velocity": self.true_velocity,
                "reference_position": self.reference.position,
                "reference_velocity": self.reference.velocity,
                "reference_acceleration": self.reference.acceleration,
                "observation": self._raw,
                "diverged": self.diverged,
            },
        )

    @property
    def time(self) -> np.ndarray:
        """Time since the start of the episodes [s], (machines,)."""
        return self.steps * self.period

    def loop(self, machine: int) -> Loop:
        """Returns the closed loop of a machine in its present episode."""
        loop = self._machines[machine].loop
        assert loop is not None
        return loop

    def reseed(self, machine: int, seed: int) -> None:
        """Sets the seed from which a machine's episodes are drawn, beginning with its next one."""
        self._machines[machine].episodes.reseed(seed)

    def reset(self, chosen: np.ndarray) -> None:
        """Starts the next episode of some machines.

        Args:
            chosen: Mask of the machines to reset, (machines,) of bool.
        """
        for i in np.flatnonzero(chosen).tolist():
            self._begin(i)
        self.steps[chosen] = 0
        self.terminated[chosen] = self.truncated[chosen] = False
        if self.torque_limit is not None:
            self._torque.reset(np.repeat(chosen, len(self.joints)))
        for values in (self.command, self.previous, self.action):
            values[chosen] = 0.0
        self._command_of_controllers(chosen, first=True)
        self._complete()
        self.error = self.true_position - self.reference.position

    def step(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Runs one control period; machines whose episode was over begin the next one instead.

        Args:
            action: Actions, clipped to [-1, 1], (machines, joints).

        Returns:
            Rewards, (machines,), 0 for machines whose episode begins, and the mask of these.

        Raises:
            LeglabError: The action has another shape, or is not finite.
        """
        values = checked_action(action, self.command.shape)
        rests = self.terminated | self.truncated
        moves = ~rests
        if rests.any():
            self.reset(rests)
        self.action = np.where(moves[:, None], values, self.action).clip(-1.0, 1.0)
        wish = self.action if self._scale is None else self._wish + self._scale * self.action
        if self.torque_limit is not None:
            wish = self._command_of_torques(self.action * self.torque_limit, rests)
        self.previous, self.command = self.command, wish.clip(-1.0, 1.0)
        self.command[rests] = self.previous[rests]
        self.steps[moves] += 1
        # The time is computed as in `Loop`, so that both round it equally.
        late = self._due <= self.steps * self.period
        self._core.step(commands=self.command, late=late, rests=rests)
        for i in np.flatnonzero(late & moves & ~self.diverged).tolist():
            self._change(i)
            self._core.measure(i)
        self._command_of_controllers(moves & ~self.diverged, first=False)
        self._complete()
        self.error = self.true_position - self.reference.position
        np.copyto(
            self.terminated,
            self.diverged | (np.abs(self.error).max(axis=1) > self._plan.error_limit),
            where=moves,
        )
        np.copyto(
            self.truncated, ~self.terminated & (self.steps >= self._plan.periods), where=moves
        )
        reward = np.asarray(self._plan.reward(self.transition()), dtype=float)
        if reward.shape != (self.count,):
            text = f"the reward of a batch has shape {reward.shape}, allowed is "
            raise SettingsError(text, given=reward.shape, allowed=f"({self.count},)")
        return np.where(moves & ~self.diverged, reward, 0.0), rests

    def transition(self) -> Transition:
        """Returns the transition of the last step; arrays have a row per machine."""
        return Transition(
            time=self.time,
            position=self.true_position,
            velocity=self.true_velocity,
            reference=self.reference,
            command=self.command,
            previous_command=self.previous,
            action=self.action,
        )

    def _begin(self, number: int) -> None:
        """Starts the next episode of a machine and takes the first measurement."""
        machine = self._machines[number]
        episode = machine.episodes.next()
        if machine.loop is not None and episode == machine.episode:
            machine.loop.reset()
        else:
            if machine.loop is not None:
                machine.loop.close()
            controlled = self._scale is not None and self._shared is None
            machine.loop = self._plan.loop(episode, machine.simulation, controlled=controlled)
            machine.episode = episode
        loop = machine.loop
        sampled = loop.machine
        assert sampled is not None
        if not sampled.exact:
            raise ModelError(
                "the model gives its sensors faults of their own, which a batch does not know: "
                "use leglab.environment.load"
            )
        noise = sampled.pressure_noise(loop.count)
        encoders = sampled.encoders
        # The first reading is taken before the first change, as in `SampledMachine`.
        self._core.start(
            machine=number,
            model=machine.simulation.model._address,
            data=machine.simulation.data._address,
            noise=encoders.noise,
            shift=encoders.shift,
            lost=encoders.lost,
            pressure_noise=noise,
            position=loop.wanted.position,
            velocity=loop.wanted.velocity,
            acceleration=loop.wanted.acceleration,
        )
        self.steps[number] = 0
        self._change(number)
        self._core.measure(number)

    def _change(self, number: int) -> None:
        """Applies those changes of a machine's scenario that are due in the present period."""
        sampled = self.loop(number).machine
        assert sampled is not None
        now = int(self.steps[number])
        sampled.schedule.apply(now * self.period)
        sampled.encoders.hold(now)
        self._due[number] = sampled.schedule.next

    def _begin_controller(self, preparation: Preparation, threads: int) -> None:
        """Makes one controller for all machines or a team of threads, if the controller allows."""
        self._shared: Controller | None = None
        self._team: Team | None = None
        self._feedforward = False
        if self._scale is None:
            return
        settings = self._machines[0].episodes.base.settings
        factory, _ = CONTROLLERS.configured(settings.controller, settings.controller_config)
        if getattr(factory, "joint_wise", False):
            own = preparation.controller_setup
            config = {
                name: tuple(value) * self.count if name in _PER_JOINT and value else value
                for name, value in settings.controller_config.items()
            }
            many = ControllerSetup(
                joints=tuple(f"{i}/{joint}" for i in range(self.count) for joint in own.joints),
                control_period=own.control_period,
                machine=ManyMachines(own.machine, self.count),
            )
            self._shared = make_controller(settings.controller, many, config)
            self._feedforward = "feedforward" in diagnostics_of(self._shared)
        else:
            probe = Loop(settings, preparation=preparation)
            probe.observe()
            self._feedforward = "feedforward" in probe.diagnostics()
            kind = type(probe.controller)
            # The C++ core computes the control period, unless a subclass overrides `command`.
            if issubclass(kind, AdaptiveController) and kind.command is AdaptiveController.command:
                self._team = Team(threads)
                self._adaptive: dict[int, AdaptiveController] = {}
                self._looks = kind.look is not AdaptiveController.look
            probe.close()

    def _command_of_controllers(self, chosen: np.ndarray, *, first: bool) -> None:
        """Computes the controllers' commands in the present period."""
        if self._scale is None:
            return
        if self._shared is not None:
            measurement = Measurement(math.nan, self.position.ravel(), self.velocity.ravel())
            point = ReferencePoint(*(part.ravel() for part in self.reference))
            wish = self._shared.command(measurement, point)
            self._wish = wish.reshape(self.command.shape)
            if self._feedforward:
                told = diagnostics_of(self._shared)["feedforward"]
                self._forward = told.reshape(self.command.shape)
            return
        if self._team is not None:
            self._command_of_team(self._team, np.flatnonzero(chosen), first)
            return
        for i in np.flatnonzero(chosen).tolist():
            loop = self.loop(i)
            controller = loop.controller
            assert controller is not None
            measurement = self._measurement(i)
            if first:
                controller.reset(measurement)
            elif hasattr(controller, "sent"):
                controller.sent(self.command[i])
            point = ReferencePoint(*(part[i] for part in self.reference))
            self._wish[i] = loop.checked(controller.command(measurement, point))
            if self._feedforward:
                self._forward[i] = diagnostics_of(controller)["feedforward"]

    def _command_of_team(self, team: Team, chosen: np.ndarray, first: bool) -> None:
        """Computes the commands of controllers with a C++ core, in threads."""
        time = self.time
        if first:
            for i in chosen.tolist():
                controller = self.loop(i).controller
                assert isinstance(controller, AdaptiveController)
                controller.reset(self._measurement(i))
                self._adaptive[i] = controller
        members = [self._adaptive[i] for i in chosen.tolist()]
        if self._looks:
            for controller, now in zip(members, time[chosen].tolist(), strict=True):
                controller.look(now)
        motion, out = (self.position, self.velocity), (self._wish, self._forward)
        learning = [controller.adaptation for controller in members]
        measured = time, *motion, self._pressure
        step_together(team, learning, chosen, self.command, measured, self.reference, out)

    def _measurement(self, i: int) -> Measurement:
        """Returns the measurement for the controller of machine `i`, as rows of the arrays."""
        row, hydraulic = self._pressure[i], self._pressure.shape[1] // 2
        pressures = (row[:hydraulic], row[hydraulic:-1], float(row[-1])) if hydraulic else ()
        now = float(self.steps[i] * self.period)
        return Measurement(now, self.position[i], self.velocity[i], *pressures)

    def _complete(self) -> None:
        """Writes the last columns of the observation: commands and the controller's outputs."""
        joints = len(self.joints)
        parts = [self.command]
        if self._scale is not None:
            parts.append(self._wish.clip(-1.0, 1.0))
            if self._feedforward:
                parts.append(self._forward)
        columns = self._raw[:, -joints * len(parts) :]
        # After a simulation has blown up, its last observation is kept.
        fine = ~self.diverged[:, None]
        np.copyto(columns, np.concatenate(parts, axis=1), where=fine, casting="same_kind")
        if self._scaled is not None:
            self.observation = self._scaled(self._raw)

    def _sizes(self, hydraulic: int) -> dict[str, int]:
        """Returns the number of values of each part of an observation, in the parts' order."""
        joints = len(self.joints)
        found = {"position": joints, "velocity": joints}
        if hydraulic:
            found |= {"pressure_a": hydraulic, "pressure_b": hydraulic, "supply_pressure": 1}
        wanted = ("reference_position", "reference_velocity", "reference_acceleration")
        found |= dict.fromkeys(wanted, joints)
        found |= {"reference_preview": len(self._plan.ahead) * joints, "previous_command": joints}
        if self._scale is not None:
            found["controller_command"] = joints
        if self._feedforward:
            found["feedforward"] = joints
        return found

    def _command_of_torques(self, torque: np.ndarray, rests: np.ndarray) -> np.ndarray:
        """Computes valve commands from torques [N m], (machines, joints), and the last readings."""
        joints = len(self.joints)
        wish = self._torque.command(
            torque.ravel(),
            self.position.ravel(),
            self.velocity.ravel(),
            np.stack([self._pressure[:, :joints].ravel(), self._pressure[:, joints:-1].ravel()]),
            np.repeat(self._pressure[:, -1], joints),
            np.repeat(rests, joints),
        )
        return wish.reshape(torque.shape)


class ManyMachines(NominalMachine):
    """Nominal machine with the joints of several equal machines, for joint-wise controllers.

    Args:
        one: Nominal machine to repeat.
        count: Number of repetitions.
    """

    def __init__(self, one: NominalMachine, count: int) -> None:
        super().__init__()
        self._one, self._count = one, count

    def find(self, name: str) -> Any:
        """Repeats a property of one machine for the joints of all machines."""
        match name:
            case "direction":
                return np.tile(self._one.direction, self._count)
            case "position_gain" | "velocity_gain" | "valve_maps":
                return list(getattr(self._one, name)) * self._count
            case "setpoint":
                one = self._one.setpoint
                return None if one is None else np.tile(one, (1, self._count))
        return super().find(name)
