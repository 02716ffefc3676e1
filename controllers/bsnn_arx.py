"""The deployed adaptive feed-forward beside PD: the machine's inverse map, learned as it moves."""

import math
from typing import Literal

import numpy as np
from pydantic import Field, field_validator

from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.feedforward.adaptive import AdaptationSettings, AdaptiveFeedforward
from leglab.control.feedforward.inverse_map import InverseMap, MotionRange
from leglab.control.feedforward.valve_table import ValveTable
from leglab.controllers.pd import Pd, PdConfiguration
from leglab.identification import ChangeDetection, Rls


class AdaptiveConfiguration(PdConfiguration):
    """Settings of every controller that learns the inverse map.

    Attributes:
        stop_time: Adaptation stops then [s]; None for never.
        window: Samples over which measured motion is smoothed; odd.
        interval: Control periods from one learned sample to the next.
        initial_gain: F(0), in squared units of scaled parameters against scaled error.
        change_gain: Gain to which F is opened on a detected change.
        change_ratio: Of quick and slow mean squared error at which a change is declared.
        change_windows: Learned samples in the quick and in the slow mean.
        hold_off: Learned samples without another alarm after one.
        memory: N_0 of variable forgetting [learned samples].
        noise: Error of the model [share of full speed] that is no reason to forget; 0 takes the
            change detector's slow mean.
        least_memory: Lambda never falls so far that less than so many learned samples a parameter
            are remembered.
        restore_interval: Learned samples from one parameter to the next that is drawn back to the
            calibration by as much as was forgotten since its last turn; 0 for never.
        restore_gain: Variance of the parameters about the calibration by which they are drawn.
        route: "inverse" learns what flow a motion takes; "forward" learns what speed a flow gives
            and solves for the flow.
        velocity_splines: Splines of velocity; 0 for a linear map.
        position_splines: Splines of position; 0 for a linear term.
        limit: Largest feed-forward [valve command].
        rate_limit: Fastest change of the feed-forward [1/s].
        least_speed: Nothing is learned while all joints are slower, as a share of their full speed.
        supervised: Whether the calibrated map takes over where it predicts better.
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
    supervised: bool = Field(default=True)

    @field_validator("window")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("allowed are odd numbers")
        return value


@register_controller(
    "bsnn_arx",
    summary="the machine's inverse map, learned online with opening gains, beside PD",
    configuration=AdaptiveConfiguration,
)
class AdaptiveController:
    """u = map(r, r', r'', r''') + PD on the reference as old as the measurement it is held against.

    The map starts as the nominal valve map and learns from what the machine did with the commands
    it was sent. See `leglab.control.feedforward`.
    """

    name = "bsnn_arx"

    def __init__(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> None:
        self._feedback = Pd(setup, config)
        self.adaptation = self._adaptation(
            setup, config, self._rls(config), self._stop_time(setup, config), config.supervised
        )

    def _adaptation(
        self,
        setup: ControllerSetup,
        config: AdaptiveConfiguration,
        rls: Rls,
        stop_time: float,
        supervised: bool,
    ) -> AdaptiveFeedforward:
        maps = setup.machine.valve_maps
        latency = setup.machine.latency
        ranges = MotionRange(
            lower=np.array([m.position[0] for m in maps]),
            upper=np.array([m.position[-1] for m in maps]),
            speed=np.array([m.velocity[-1] for m in maps]),
        )
        return AdaptiveFeedforward(
            InverseMap(
                ranges,
                rls,
                velocity_splines=config.velocity_splines,
                position_splines=config.position_splines,
                least_memory=config.least_memory,
            ),
            ValveTable.of(maps, np.asarray(setup.machine.direction)),
            self._feedback.position_gain,
            self._feedback.velocity_gain,
            AdaptationSettings(
                control_period=setup.control_period,
                latency=latency,
                velocity_delay=latency + setup.machine.velocity_delay,
                window=config.window,
                interval=config.interval,
                stop_time=stop_time,
                limit=config.limit,
                rate_limit=config.rate_limit,
                least_speed=config.least_speed,
                forward=config.route == "forward",
                supervised=supervised,
            ),
        )

    @staticmethod
    def _rls(config: AdaptiveConfiguration) -> Rls:
        gain = max(config.initial_gain, config.change_gain)
        return Rls(
            initial_gain=config.initial_gain,
            forgetting="variable",
            memory=config.memory,
            noise_variance=config.noise**2,
            gain_bound=10 * gain,
            restore_interval=config.restore_interval,
            restore_gain=config.restore_gain,
            change=ChangeDetection(
                ratio=config.change_ratio,
                gain=config.change_gain,
                fast_window=config.change_windows[0],
                slow_window=config.change_windows[1],
                hold_off=config.hold_off,
            ),
        )

    def _stop_time(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> float:
        return math.inf if config.stop_time is None else config.stop_time

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the nominal map."""
        self.adaptation.reset()

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Valve commands, (joints,)."""
        return self.adaptation.step(measurement, reference)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Feed-forward, feedback, error of the model, and 1 where the nominal map stands in."""
        return self.adaptation.report
