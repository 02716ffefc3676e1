"""Adaptive feed-forward with a bank of faults, each with a map that shortens learning after it."""

import math
from collections import deque
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from leglab.base.errors import ModelError
from leglab.causes.fault_names import FaultEvent, FaultTrend
from leglab.control import ControllerSetup, Measurement, register_controller
from leglab.control.feedforward.fault_monitor import (
    FaultMonitor,
    MonitorConfiguration,
    ProposedMap,
)
from leglab.control.feedforward.health import HealthConfiguration, HealthMonitor
from leglab.control.feedforward.thresholds import AFTER, STRIDE
from leglab.controllers.bsnn_arx import AdaptiveConfiguration, AdaptiveController

# Number of latest sample blocks on which a new contender (proposed map) is first compared with the
# learner, because older samples are from the machine before its change.
_BLOCKS = 4

# Prior odds of a map with a valve state from `_STATES` or `plays`, against the learner's map.
_UNNAMED = 0.03

# Valve states that are tried after every change, in addition to `plays`; columns as in
# `AdaptiveFeedforward.valves`. 0.02 is the default lap; 1/3 more command offsets 1/4 less flow.
_STATES = np.array(
    [
        (0.02, 0.0, 0.0, 0.0, 0.0),
        (-0.02, 0.0, 0.0, 0.0, 0.0),
        (0.0, 0.02, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 1 / 3, 0.0),
        (0.0, 0.0, 0.0, 0.0, 1 / 3),
    ]
)


class _Proposed(NamedTuple):
    """Contenders (maps that compete with the learner's map) for one proposed fault."""

    number: int  # index of the contender with the fault's parameter shift
    state: int | None  # index of the contender with the fault's valve state
    parameters: np.ndarray  # last proposed parameters of contender `number`, (joints, parameters)
    shift: np.ndarray  # `parameters` less the parameters of the map before the change


class BankConfiguration(AdaptiveConfiguration):
    """Settings of `bsnn_arx`, and of the monitor that names faults.

    Attributes:
        monitor: How changes are noticed and named.
        health: How slow wear is followed.
        left_out: Faults of the bank that are not used, to see what an unknown one does.
        corrects: Whether what faults do is used as far as it predicts; without, the monitor names
            only.
        plays: Widths of hysteresis that are looked for [valve command].
    """

    monitor: MonitorConfiguration = Field(default_factory=MonitorConfiguration)
    health: HealthConfiguration = Field(default_factory=HealthConfiguration)
    left_out: tuple[str, ...] = Field(default=())
    corrects: bool = Field(default=True)
    plays: tuple[Annotated[float, Field(gt=0, le=1)], ...] = Field(
        default=(0.02, 0.04, 0.06, 0.08, 0.12)
    )


@register_controller(
    "bsnn_arx_bank",
    summary="is bsnn_arx that names what broke, uses what that fault does as far as it predicts, "
    "and learns the rest",
    configuration=BankConfiguration,
)
class BankController(AdaptiveController):
    """`bsnn_arx` that, after a change, weights the maps of likely faults by how well they predict.

    See `leglab.control.feedforward.fault_monitor` and `csrc/feedforward/contenders.h`.
    """

    name = "bsnn_arx_bank"
    valve_states = True

    def __init__(self, setup: ControllerSetup, config: BankConfiguration) -> None:
        if setup.fault_bank is None:
            raise ModelError(f"controller {self.name!r} needs a bank of faults of the machine")
        super().__init__(setup, config)
        bank = setup.fault_bank()
        if config.left_out:
            bank = bank.without(config.left_out)
        period = setup.control_period * config.interval
        stride = setup.reference_period
        pace = stride / STRIDE if stride and math.isfinite(stride) else 1.0
        given = {"sample_period": period, "pace": pace}
        self.monitor = FaultMonitor(bank, setup.joints, config.monitor, **given)
        self.health = HealthMonitor(bank, setup.joints, config.health, **given)
        self._after = pace * AFTER
        # Weight of the latest block in the moving average of the maps' shares over a stride.
        self._latest = min(1.0, period * config.monitor.block / (pace * STRIDE))
        self._config = config
        self._states = np.zeros((len(config.plays) + len(_STATES), 5))
        self._states[: len(config.plays), 2] = config.plays
        self._states[len(config.plays) :] = _STATES
        self._report = {**self.adaptation.report, **self.monitor.report, **self.health.report}
        self._corrects, self._stopped = config.corrects, False

    @property
    def events(self) -> list[FaultEvent]:
        """Changes detected since `reset`, with their names."""
        return self.monitor.events

    @property
    def trends(self) -> list[FaultTrend]:
        """Slow wear reported since `reset`."""
        return self.health.trends

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the nominal map."""
        super().reset(measurement)
        self.monitor.reset()
        self.health.reset()
        self._told = 0
        self.adaptation.keep(2 * self._config.monitor.block)
        self._stopped = self._tried = False
        self._closed: float | None = None
        self._proposed: dict[tuple[str, str], _Proposed] = {}
        self._shares = np.zeros(1)
        self._recent: deque[np.ndarray] = deque(maxlen=_BLOCKS)

    def freeze(self) -> None:
        """Stops adapting until the next `reset`."""
        super().freeze()
        self._stopped = True

    def look(self, time: float) -> None:
        """Runs the monitors and updates the contenders if a block of samples is complete."""
        if self.adaptation.kept_count() < self._config.monitor.block or self._stopped:
            return
        learner = self.adaptation.learner
        parameters = np.atleast_2d(learner.parameters)
        samples = self.adaptation.kept()
        self._recent.append(samples)
        proposals = self.monitor.take(time, samples, parameters)
        self._follow(time, samples, parameters)
        if not self._corrects:
            return
        self._end(time)
        if proposals is not None and not self._tried:
            self._tried = True
            now = self.adaptation.valves
            for state in (*([-now] if now.any() else []), *self._states):
                self._join(self.monitor.before, _UNNAMED, 1.0, valves=now + state)
        for proposal in proposals or ():
            self._propose(proposal)

    def _end(self, time: float) -> None:
        """Ends the contest of maps once the monitor has finished examining a change.

        First the best map and `learner` are kept, later only the best map. It has the largest share
        averaged over a stride, because within a stride different maps may lead.
        """
        if not self.adaptation.contenders:
            self._shares = np.zeros(1)
            return
        shares = self.adaptation.shares()
        usual = np.pad(self._shares, (0, len(shares) - len(self._shares)))
        self._shares = usual + self._latest * (shares - usual)
        if self.monitor.busy and self._closed is None:
            return
        best = int(np.argmax(self._shares))
        if self._closed is None:
            self.adaptation.narrow(best)
            self._closed = time
        if self.monitor.busy or time > self._closed + self._after:
            self.adaptation.settle(best)
        if not self.adaptation.contenders:
            for proposed in self._proposed.values():
                if proposed.state == best - 1:
                    self.monitor.absorb(proposed.shift)
            self._proposed.clear()
            self._tried, self._closed = False, None

    def _propose(self, proposal: ProposedMap) -> None:
        """Adds the contenders of a fault, or revises them if they exist already."""
        adaptation, error = self.adaptation, self._error(proposal.parameters)
        before, valves = self.monitor.before, None
        if proposal.valves is not None:
            valves = adaptation.valves + proposal.valves
        last = self._proposed.get(proposal.key)
        number = len(adaptation.contenders) if last is None else last.number
        state = None if valves is None else number + 1
        shift = proposal.parameters - before
        self._proposed[proposal.key] = _Proposed(number, state, proposal.parameters, shift)
        if last is None:
            self._join(proposal.parameters, proposal.odds, error, proposal.gain)
            if valves is not None:
                self._join(before, proposal.odds, error, proposal.gain, valves)
            return
        shares = adaptation.shares()[1:]
        # A contender that was excluded because it predicted badly is not revised.
        if shares[number] > 0.0:
            moved = proposal.parameters - last.parameters
            now = adaptation.contenders[number].parameters.reshape(moved.shape) + moved
            adaptation.revise(number, moved, self._error(now))
        if state is not None:
            # Another fault size changes the valve state, so an excluded contender restarts.
            now = adaptation.contenders[state].parameters.reshape(before.shape)
            moved = (shares[state] == 0.0) * (before - now)
            adaptation.revise(state, moved, error, valves)

    def _join(
        self,
        parameters: np.ndarray,
        odds: float,
        error: float,
        gain: np.ndarray | None = None,
        valves: np.ndarray | None = None,
    ) -> None:
        """Adds a contender; arguments as in `ProposedMap` and `AdaptiveFeedforward.propose`."""
        learner = self.adaptation.learner.copy()
        learner.parameters = parameters.reshape(learner.parameters.shape)
        for joint in range(len(parameters)):
            # The learner's change detector must not raise the gain that is set below.
            learner.hold_alarm(joint)
            share = 1.0 if gain is None else float(gain[joint])
            if np.isfinite(share):
                opened = self._config.change_gain * max(share, 1e-9)
                learner.set_gain(opened * np.eye(parameters.shape[1]), joint)
        self.adaptation.propose(learner, odds, error, valves)

    def _error(self, parameters: np.ndarray) -> float:
        """Computes a map's mean squared error over the learner's, on the latest samples."""
        samples = np.concatenate(self._recent)
        regressor, found = samples[..., :-3], samples[..., -3]
        error = np.where(samples[..., -1] > 0, found - (regressor * parameters).sum(axis=2), 0.0)
        return float((error**2).sum() / max((samples[..., -2] ** 2).sum(), 1e-300))

    def _follow(self, time: float, samples: np.ndarray, parameters: np.ndarray) -> None:
        """Passes samples to the health monitor, except while an abrupt change is being examined."""
        if self.monitor.busy:
            self.health.drop()
            return
        if len(self.events) > self._told:
            self._told = len(self.events)
            self.health.renew()
        self.health.take(time, samples, parameters)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns the diagnostics of `bsnn_arx` and the reports of fault and health monitor."""
        return self._report
