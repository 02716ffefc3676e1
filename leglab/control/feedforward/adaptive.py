"""Adaptive feed-forward from an inverse map (motion to flow) learned online, with safeguards."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import Field, field_validator

from leglab._native.identification import Feedforward, Team
from leglab.base.settings import Configuration
from leglab.control import Measurement, ReferencePoint
from leglab.control.feedforward.inverse_map import ACCELERATION, JERK, InverseMap
from leglab.control.feedforward.motion import smoothing_kernel
from leglab.control.feedforward.thresholds import DISCREPANCY
from leglab.control.feedforward.valve_table import ValveTable
from leglab.identification import ChangeDetection, Rls, SplineNarx

# Names of the signals that the C++ core writes each period, in the rows after the command's row.
_REPORTED = ("feedforward", "feedback", "model_error", "fallback")

# Passed to the core for a contender (competing map) that assumes the valve state of `learner`.
_AS_USED = np.empty((0, 5))

# Tuning constants, by their names in the C++ core.
_CONSTANTS = {
    # Acceleration [rad/s^2] above which a position reading is rejected; in walking the knee has 63.
    "greatest_acceleration": 1000.0,
    # Supervisor: it replaces the learned map by the calibrated map while the learned map errs more.
    "trust_time": 0.5,  # time constant of the mean squared errors of both maps [s]
    "margin": 1.05,  # ratio of RMS errors, learned over calibrated map, above which it replaces
    "noise": 0.2e-3,  # RMS tracking error [rad] below which it never replaces the learned map
    # The slow map is a running mean of the learned map. Snapshots of their difference predict the
    # flow. Only the share of the difference that the measured flow confirms is used in the
    # feed-forward (`csrc/feedforward/proof.h`).
    "proof_time": 0.15,  # averaging time of the share [s]
    "proof_horizon": 0.02,  # time between two snapshots [s]
    "proof_doubt": 0.06,  # weight of a prior share of 1, in mean squared errors of the slow map
    "proof_noise": 0.0005,  # difference used without confirmation [share of full speed]
    # Smallest step back of a command that counts as a reversal [1]; larger than feedback noise.
    "turn": 0.002,
    # Time constant with which the assumed valve state adapts [s]: half a stride, in which each
    # command reverses a few times.
    "state_time": 0.5,
    "state_step": 0.01,  # step of the valve state for the finite difference of the flow [1]
    # Contenders: maps that learn in parallel, weighted by their prediction errors.
    "contest_time": 0.08,  # averaging time of their squared errors [s]
    "contest_gather": 0.25,  # averaging time of the log ratios of mean errors [s]; 1/4 of a stride
    "contest_errors": 4.0,  # number of independent errors in each of these averages
    # Ratio of mean squared errors, contender over `learner`, above which the contender is excluded.
    # It exceeds 1, since `learner` has just learned this motion and a true contender may err more.
    "contest_window": 6.0,
    "acceleration": ACCELERATION,
    "jerk": JERK,
}


class LearningConfiguration(Configuration):
    """Settings of learning and of safeguards for the use of the map; the core reads these names.

    Attributes:
        stop_time: Time at which adaptation stops [s]; None for never.
        window: Number of samples over which measured motion is smoothed; odd.
        interval: Control periods from one learned sample to the next.
        initial_gain: F(0), in squared units of scaled parameters against scaled error.
        change_gain: Gain to which F is raised on a detected change.
        change_ratio: Ratio of quick to slow mean squared error at which a change is declared.
        change_windows: Numbers of learned samples in the quick and in the slow mean.
        hold_off: Number of learned samples after an alarm without another alarm.
        memory: N_0 of variable forgetting [learned samples].
        noise: Error of the model [share of full speed] that counts as noise in variable forgetting;
            0 takes the change detector's slow mean.
        least_memory: Least number of learned samples per parameter that forgetting keeps.
        restore_interval: Number of learned samples after which the next parameter is drawn back to
            the calibration by as much as was forgotten since its last time; 0 for never.
        restore_gain: Variance of the parameters about the calibration to which they are drawn back.
        route: "inverse" learns the flow for a motion; "forward" learns the speed by a flow and
            solves for the flow.
        velocity_splines: Number of splines of velocity; 0 for a linear map.
        position_splines: Number of splines of position; 0 for a linear term.
        limit: Largest feed-forward [valve command].
        rate_limit: Fastest change of the feed-forward [1/s].
        least_speed: Nothing is learned while all joints are slower, as a share of their full speed.
        settle_time: Time constant of a slow mean of the parameters [s]. The learned departure from
            this mean is used in proportion to how well it has predicted; with 0, all of it is.
        supervised: Whether the calibrated map takes over at joints where it predicts better.
    """

    stop_time: float | None = Field(default=None, ge=0)
    window: int = Field(default=15, ge=7, le=201)
    interval: int = Field(default=2, ge=1, le=100)
    initial_gain: float = Field(default=3.0, gt=0)
    change_gain: float = Field(default=3.0, gt=0)
    change_ratio: float = Field(default=6.0, gt=1)
    change_windows: tuple[int, int] = Field(default=(40, 1500))
    hold_off: int = Field(default=1000, ge=0)
    memory: float = Field(default=2000.0, ge=1)
    noise: float = Field(default=0.0005, ge=0)
    least_memory: float = Field(default=10.0, ge=2)
    restore_interval: int = Field(default=1, ge=0)
    restore_gain: float = Field(default=100.0, gt=0)
    route: Literal["inverse", "forward"] = Field(default="inverse")
    velocity_splines: int = Field(default=12, ge=0, le=100)
    position_splines: int = Field(default=5, ge=0, le=100)
    limit: float = Field(default=0.95, gt=0, le=1)
    rate_limit: float = Field(default=50.0, gt=0)
    least_speed: float = Field(default=1e-3, ge=0)
    settle_time: float = Field(default=0.4, ge=0)
    supervised: bool = Field(default=True)

    @field_validator("window")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("allowed are odd numbers")
        return value

    @property
    def rls(self) -> Rls:
        """Settings of the recursive least squares that learns the map."""
        gain = max(self.initial_gain, self.change_gain)
        return Rls(
            initial_gain=self.initial_gain,
            forgetting="variable",
            memory=self.memory,
            noise_variance=self.noise**2,
            gain_bound=10 * gain,
            restore_interval=self.restore_interval,
            restore_gain=self.restore_gain,
            change=ChangeDetection(
                ratio=self.change_ratio,
                gain=self.change_gain,
                fast_window=self.change_windows[0],
                slow_window=self.change_windows[1],
                hold_off=self.hold_off,
            ),
        )


class AdaptiveFeedforward:
    """Feed-forward of all joints, added to PD: the calibrated valve map at the learned flow.

    A learned sample is the motion in the middle of the smoothing window and the flow at that time:
    the speed that the calibrated valve map gives for the sent commands, smoothed like the motion.
    The learner's output is this flow less the measured speed; it represents leakage, compression,
    and losses by load and oil. The map is evaluated at the reference, advanced by the time from a
    command to its effect; a further delay of valve and oil is learned as a dependence on
    acceleration and jerk. The core is C++ (`csrc/feedforward`); tests compare it with NumPy.

    Args:
        inverse_map: Structure of the learner.
        table: Calibrated valve maps, with which learning starts.
        position_gain: Gain of the feedback [1/rad], (joints,); sets how fast position errors decay.
        velocity_gain: Gain of the feedback [s/rad], (joints,).
        config: Settings of learning and safeguards.
        loads: Structure of the map from motion to load; None without pressures.
        sheets: Data sheets of the cylinders by the names of `csrc/feedforward/pressure_valve.h`,
            (joints,) or (joints, p) each; None without pressures.
        valve_states: Whether `propose` accepts maps that assume another valve state.
        control_period: [s].
        latency: Age of a position measurement when its command takes effect [s].
        velocity_delay: Age of a velocity estimate when its command takes effect [s].

    Attributes:
        learner: The learned map.
        loads: The learned map from motion to load [share of the piston's force at nominal supply
            pressure]; None without pressures.
        report: Values of the last period, by name, each (joints,): `feedforward` and `feedback`
            [valve command], `model_error` of the last sample [share of full speed], and `fallback`,
            1 if the calibrated map is used. The next period overwrites the arrays.
    """

    def __init__(
        self,
        inverse_map: InverseMap,
        table: ValveTable,
        position_gain: np.ndarray,
        velocity_gain: np.ndarray,
        config: LearningConfiguration,
        *,
        loads: InverseMap | None = None,
        sheets: Mapping[str, np.ndarray] | None = None,
        valve_states: bool = False,
        control_period: float,
        latency: float,
        velocity_delay: float,
    ) -> None:
        self._map, self._load_map, self._valve_states = inverse_map, loads, valve_states
        width = table.end - table.start
        self._core = Feedforward(
            {
                **config.model_dump(),
                **vars(table),
                **_CONSTANTS,
                "control_period": control_period,
                "stop_time": math.inf if config.stop_time is None else config.stop_time,
                "saturation": config.limit,
                "forward": config.route == "forward",
                "contest_floor": config.noise**2,
                "state_doubt": DISCREPANCY,
                "state_noise": config.noise,
                "centre": (table.start + table.end) / 2,
                "half_range": width / 2,
                "products": inverse_map.products,
                "kernel": smoothing_kernel(config.window, control_period),
                "lead": control_period - latency,
                "position_delay": latency,
                "velocity_delay": velocity_delay,
                # Calibration ends a little before the joint's stops; learning goes a bit further.
                "learn_lower": table.start - 0.02 * width,
                "learn_upper": table.end + 0.02 * width,
                "bandwidth": np.abs(position_gain) * table.full_speed / table.command_per_share(),
                "position_gain": position_gain,
                "velocity_gain": velocity_gain,
                **(sheets or {}),
            }
        )
        self._out = np.zeros((1 + len(_REPORTED), inverse_map.joints))
        self.report = dict(zip(_REPORTED, self._out[1:], strict=True))
        self.reset()

    def reset(self) -> None:
        """Forgets everything learned, so that the feed-forward is the calibrated map's again."""
        self.learner, self.contenders = self._map.learner(), list[SplineNarx]()
        self._with_valves: list[bool] = []
        self.loads = None if self._load_map is None else self._load_map.learner()
        self._slopes = self._map.learner() if self._valve_states else None
        loads, slopes = (None if m is None else m._bank for m in (self.loads, self._slopes))
        self._core.reset(self.learner._bank, loads, slopes)
        self._core.keep(0)
        self._out[:] = 0.0

    def freeze(self) -> None:
        """Stops learning until the next `reset`."""
        self._core.freeze()

    def propose(
        self, learner: SplineNarx, odds: float, error: float, valves: np.ndarray | None = None
    ) -> None:
        """Adds a contender: a map that learns in parallel and is weighted by its prediction error.

        Args:
            learner: The map, of the same structure as `self.learner`.
            odds: Prior odds of this map against `self.learner`.
            error: Mean squared error of the map on the latest samples, divided by that of
                `self.learner`.
            valves: Valve state that the map assumes, (joints, 5); None for `self.valves`.
        """
        self._core.propose(
            learner._bank, math.log(odds), error, _AS_USED if valves is None else valves
        )
        self.contenders.append(learner)
        self._with_valves.append(valves is not None)

    def revise(
        self, contender: int, shift: np.ndarray, error: float, valves: np.ndarray | None = None
    ) -> None:
        """Adds a shift (joints, parameters) to a contender's parameters; `error` as in `propose`.

        `valves` is the new valve state of a contender that was proposed with one.
        """
        learner = self.contenders[contender]
        learner.parameters = learner.parameters + shift.reshape(learner.parameters.shape)
        self._core.revise(contender, error, _AS_USED if valves is None else valves)

    @property
    def valves(self) -> np.ndarray:
        """Valve state that `learner` assumes, (joints, 5).

        Columns: shift of the null, dead band on each side, width of the play [valve command], and
        relative increase of positive and of negative commands.
        """
        return np.array(self._core.valves())

    def shares(self) -> np.ndarray:
        """Returns the weights of `learner` and contenders in the map in use, (1 + contenders,)."""
        return np.array(self._core.shares())

    def narrow(self, best: int) -> None:
        """Keeps `learner` and the contender with index `best` in `shares`; drops all others.

        A contender with a valve state replaces `learner`, which cannot learn a valve state.
        """
        if best == 0 or self._with_valves[best - 1]:
            self.settle(best)
        else:
            self._core.only(best - 1)

    def settle(self, best: int) -> None:
        """Makes the map with index `best` in `shares` the `learner`; drops all other maps."""
        if best > 0:
            self.learner._bank.set_state(self.contenders[best - 1]._bank.state())
        if self.contenders:
            self._core.settle(best)
            self.contenders, self._with_valves = [], []

    def keep(self, samples: int) -> None:
        """Stores samples until the next `reset`, at most `samples` between two calls of `kept`."""
        shape = (samples, self._map.joints, self.learner.parameters.shape[-1] + 3)
        self._kept = np.empty(shape)
        self._core.keep(samples)

    def kept_count(self) -> int:
        """Returns the number of samples kept since the last call of `kept`."""
        return self._core.kept()

    def kept(self) -> np.ndarray:
        """Returns the samples kept since the last call, (samples, joints, parameters + 3).

        The last axis contains the regressor, the output [share of full speed], the a-priori error
        and the number 1; all entries are zero if the joint did not learn the sample.
        """
        count = self._core.take_kept(self._kept)
        return self._kept[:count].copy()

    def step(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Learns from a measurement and computes the valve commands; call it once a period.

        If `sheets` were passed, the measurement must have pressures. The feedback compares a
        measurement with the reference at the time of the measurement. If this is NaN, the command
        is the feed-forward alone. The learner assumes that the command is sent clipped to [-1, 1].
        The next period overwrites the returned array, (joints,).
        """
        time, position, velocity, pressure_a, pressure_b, supply = measurement
        if self.loads is None or supply is None:
            self._core.step(time, position, velocity, *reference, self._out)
        else:
            self._core.step(
                time, position, velocity, *reference, self._out, pressure_a, pressure_b, supply
            )
        return self._out[0]

    def sent(self, command: np.ndarray) -> None:
        """Records the commands sent, (joints,); needed if they differ from the result of `step`."""
        self._core.sent(command)


def step_together(
    team: Team,
    members: Sequence[AdaptiveFeedforward],
    machines: np.ndarray,
    sent: np.ndarray,
    measurement: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    reference: ReferencePoint,
    out: tuple[np.ndarray, np.ndarray],
) -> None:
    """Calls `AdaptiveFeedforward.step` of several machines, in threads.

    Args:
        team: The threads.
        members: Feed-forwards of the machines that are stepped, one each.
        machines: Indices of these machines in the arrays below, (members,) of int64.
        sent: The commands that were sent last, (machines, joints).
        measurement: Time (machines,), positions and velocities (machines, joints), pressures of
            cap sides, rod sides and supply (machines, 2 joints + 1), or an empty array.
        reference: Reference points of all machines, arrays (machines, joints).
        out: Arrays that receive commands and feed-forwards, (machines, joints) each.
    """
    time, position, velocity, pressures = measurement
    team.step(
        [member._core for member in members],
        [member._out for member in members],
        machines,
        time,
        sent,
        position,
        velocity,
        *reference,
        pressures,
        *out,
    )
