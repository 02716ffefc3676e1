"""The task of an environment: follow a reference while the machine changes."""

import collections
from collections.abc import Mapping

import numpy as np
from dm_control.rl.control import FLAT_OBSERVATION_KEY, Task
from dm_env import specs

from leglab.base.errors import SimulationError
from leglab.base.scenario import Scenario
from leglab.control.torque import TorqueLoop
from leglab.environment.episodes import Episode, Episodes
from leglab.environment.observations import observation_scales
from leglab.environment.physics import LegPhysics
from leglab.environment.plan import Plan, checked_action
from leglab.environment.rewards import Transition
from leglab.machine.simulation import Simulation
from leglab.runs.loop import Loop
from leglab.runs.preparation import reference_joints


class TrackingTask(Task):
    """Tracking task; actions are valve commands, corrections of a controller's, or joint torques.

    Args:
        plan: Settings of the environment.
        simulation: The machine, which the physics shares.
        episodes: Source of random episodes.
        flat: Whether the environment joins an observation into one array.

    Attributes:
        episode: The present episode.
        diverged: Whether the simulation blew up.
        torque_limit: Torque [N m] of an action of 1, (joints,); None if actions are not torques.
    """

    def __init__(
        self, plan: Plan, simulation: Simulation, episodes: Episodes, *, flat: bool
    ) -> None:
        self._plan, self._simulation, self._episodes = plan, simulation, episodes
        self._flat = flat
        self._scales = observation_scales(plan.preparation) if plan.normalize else None
        sheets = plan.cylinders
        self._torque = None if sheets is None else TorqueLoop(sheets, plan.period)
        self.torque_limit = None if self._torque is None else self._torque.limit
        self._joints = reference_joints(plan.preparation.nominal)
        self._zero = np.zeros(len(self._joints))
        self._command = self._previous = self._action = self._zero
        self.episode: Episode | None = None
        self._first: Episode | None = self._episodes.next()
        self._begin(self._first)

    @property
    def time(self) -> float:
        """Time since the start of the episode [s]."""
        return self._simulation.data.time

    @property
    def scenario(self) -> Scenario:
        """Scenario of the present episode."""
        return self._loop.scenario

    def reseed(self, seed: int) -> None:
        """Restarts the sequence of episodes from another seed, beginning with the next episode."""
        self._episodes.reseed(seed)
        self._first = None

    def initialize_episode(self, physics: LegPhysics) -> None:
        """Puts the machine into the initial state of the next episode and measures it."""
        # The constructor has begun the first episode, for the specifications; it is begun again.
        self._begin(self._first or self._episodes.next())
        self._first = None
        physics.drive(self._loop.advance)

    def before_step(self, action: np.ndarray, physics: LegPhysics) -> None:
        """Sets the valve commands.

        Raises:
            LeglabError: The action has another shape or is not finite.
        """
        self._action = checked_action(action, self._zero.shape).clip(-1.0, 1.0)
        scale = self._plan.residual_scale
        wish = self._action if scale is None else self._wish + scale * self._action
        if self._torque is not None:
            wish = self._torque.of(self._action * self._torque.limit, self._period.measurement)
        self._previous = self._command
        self._command = wish.clip(-1.0, 1.0)
        self._loop.act(self._command)

    def after_step(self, physics: LegPhysics) -> None:
        """Measures; keeps the last observation if the simulation blew up."""
        try:
            self._simulation.check()
        except SimulationError:
            self.diverged = True
        else:
            self._measure()

    def get_observation(self, physics: LegPhysics) -> dict[str, np.ndarray]:
        """Returns measurements, reference and commands; see docs/guides/environments.md."""
        return collections.OrderedDict(self._observation)

    def get_reward(self, physics: LegPhysics) -> float:
        """Returns the reward of the step; 0 if the simulation blew up."""
        if self.diverged:
            return 0.0
        return float(self._plan.reward(self.transition()))

    def get_termination(self, physics: LegPhysics) -> float | None:
        """Returns discount 0 if the simulation blew up or an error exceeds the limit; else None."""
        if self.diverged:
            return 0.0
        error = self._simulation.position() - self._period.reference.position
        return 0.0 if np.abs(error).max() > self._plan.error_limit else None

    def transition(self) -> Transition:
        """Returns the transition of the last step."""
        return Transition(
            time=self.time,
            position=self._simulation.position(),
            velocity=self._simulation.velocity(),
            reference=self._period.reference,
            command=self._command,
            previous_command=self._previous,
            action=self._action,
        )

    def action_spec(self, physics: LegPhysics) -> specs.BoundedArray:
        """Returns the specification of an action: one number in [-1, 1] per joint."""
        names = "\t".join(joint.name for joint in self._joints)
        return specs.BoundedArray(self._zero.shape, float, -1.0, 1.0, name=names)

    def observation_spec(self, physics: LegPhysics) -> Mapping[str, specs.Array]:
        """Returns shapes and bounds of the parts of an observation.

        In SI units only commands and references are bounded, the latter by the joints' limits.
        """
        low, high = np.array([(joint.lower, joint.upper) for joint in self._joints]).T
        speed = np.array([joint.velocity_limit for joint in self._joints])
        bounds: dict[str, _Bounds] = {
            "reference_position": (low, high),
            "reference_velocity": (-speed, speed),
            "reference_preview": (low, high),
            "previous_command": (-1.0, 1.0),
            "controller_command": (-1.0, 1.0),
        }
        if self._scales is not None:
            bounds = {name: (-scale.limit, scale.limit) for name, scale in self._scales.items()}
        observed = self._observation.items()
        named = collections.OrderedDict((k, _spec(k, v, bounds.get(k))) for k, v in observed)
        return _flat_spec(named) if self._flat else named

    def _begin(self, episode: Episode) -> None:
        if episode == self.episode:
            self._loop.reset()
        else:
            if self.episode is not None:
                self._loop.close()
            controlled = self._plan.residual_scale is not None
            self._loop: Loop = self._plan.loop(episode, self._simulation, controlled=controlled)
            self.episode = episode
        self.diverged = False
        if self._torque is not None:
            self._torque.reset()
        self._action = self._command = self._previous = self._zero
        self._measure()

    def _measure(self) -> None:
        self._period = period = self._loop.observe()
        measurement, point = period.measurement, period.reference
        observation = collections.OrderedDict(
            position=measurement.position.copy(), velocity=measurement.velocity.copy()
        )
        if measurement.pressure_a is not None and measurement.pressure_b is not None:
            observation["pressure_a"] = measurement.pressure_a.copy()
            observation["pressure_b"] = measurement.pressure_b.copy()
            observation["supply_pressure"] = np.array([measurement.supply_pressure])
        observation.update(
            reference_position=point.position.copy(),
            reference_velocity=point.velocity.copy(),
            reference_acceleration=point.acceleration.copy(),
            reference_preview=self._loop.reference_ahead(self._plan.ahead),
            previous_command=self._command.copy(),
        )
        if period.command is not None:
            self._wish = self._loop.checked(period.command)
            observation["controller_command"] = self._wish.clip(-1.0, 1.0)
            feedforward = self._loop.diagnostics().get("feedforward")
            if feedforward is not None:
                observation["feedforward"] = feedforward.copy()
        if self._scales is not None:
            for name, value in observation.items():
                observation[name] = self._scales[name](value)
        self._observation = observation


_Bounds = tuple[np.ndarray | float, np.ndarray | float]


def _spec(name: str, value: np.ndarray, bounds: _Bounds | None) -> specs.Array:
    if bounds is None:
        return specs.Array(value.shape, value.dtype, name=name)
    low, high = (np.broadcast_to(end, value.shape) for end in bounds)
    return specs.BoundedArray(value.shape, value.dtype, low, high, name=name)


def ends(spec: specs.Array) -> list[np.ndarray]:
    """Returns the lower and upper bounds of a specification, infinite if it has no bounds."""
    found = getattr(spec, "minimum", -np.inf), getattr(spec, "maximum", np.inf)
    return [np.broadcast_to(end, spec.shape) for end in found]


def _flat_spec(named: Mapping[str, specs.Array]) -> Mapping[str, specs.Array]:
    parts = zip(*map(ends, named.values()), strict=True)
    low, high = (np.concatenate([np.ravel(end) for end in part]) for part in parts)
    kind = next(iter(named.values())).dtype
    spec = specs.BoundedArray(low.shape, kind, low, high, name=FLAT_OBSERVATION_KEY)
    return collections.OrderedDict({FLAT_OBSERVATION_KEY: spec})
