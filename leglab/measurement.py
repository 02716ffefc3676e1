"""What sensors make of the true state: resolution, noise, latency, velocity from positions."""

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from leglab.configuration import Configuration
from leglab.errors import LeglabError


class SensorConfiguration(Configuration):
    """Sensors and timing of the control loop.

    Defaults are those of the knee bench's recordings (encoder of 17 bits).

    Attributes:
        control_period: Time from one command to the next [s].
        latency: Age of a measurement when its command takes effect [s], at most one period.
        encoder_counts: Encoder counts a turn; 0 for infinite resolution.
        position_noise: RMS noise of a position [rad].
        pressure_noise: RMS noise of a pressure [Pa].
        velocity_cutoff: Of the first-order filter behind the position difference [Hz].
    """

    control_period: float = Field(default=2e-3, gt=0, le=0.1)
    latency: float = Field(default=1e-3, ge=0)
    encoder_counts: int = Field(default=131072, ge=0)
    position_noise: float = Field(default=2e-5, ge=0)
    pressure_noise: float = Field(default=1.5e4, ge=0)
    velocity_cutoff: float = Field(default=60.0, gt=0)


class LoopTiming(NamedTuple):
    """Whole time steps in a control period: from command to sample, and from sample to command."""

    to_sample: int
    to_command: int

    @property
    def steps(self) -> int:
        """Time steps in a control period."""
        return self.to_sample + self.to_command


def loop_timing(config: SensorConfiguration, timestep: float) -> LoopTiming:
    """Splits a control period into whole time steps.

    Raises:
        LeglabError: If period or latency is no multiple of the time step, or the latency is longer.
    """
    steps = round(config.control_period / timestep)
    late = round(config.latency / timestep)
    for name, count in (("control_period", steps), ("latency", late)):
        value = getattr(config, name)
        if abs(value - count * timestep) > 1e-9 or (name == "control_period" and count < 1):
            raise LeglabError(
                f"{name} = {value:g} s; allowed: a multiple of the model's timestep {timestep:g} s"
            )
    if late > steps:
        raise LeglabError(
            f"latency = {config.latency:g} s; allowed: at most control_period = "
            f"{config.control_period:g} s"
        )
    return LoopTiming(to_sample=steps - late, to_command=late)


def velocity_filter_coefficient(period: float, cutoff_hz: float) -> float:
    """Coefficient a of v[k] += a ((q[k] - q[k-1])/T - v[k-1]), first order with the cutoff."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * period)


def velocity_delay(period: float, cutoff_hz: float) -> float:
    """Age of a velocity estimate [s]: half a period of the difference, and the filter's lag.

    The lag of v[k] += a (x[k] - v[k-1]) on a ramp is T (1 - a)/a.
    """
    a = velocity_filter_coefficient(period, cutoff_hz)
    return period / 2 + period * (1 - a) / a


def position_uncertainty(config: SensorConfiguration) -> float:
    """RMS error of a measured position [rad]: noise, and rounding to counts by 1/sqrt(12)."""
    if config.encoder_counts == 0:
        return config.position_noise
    step = 2.0 * math.pi / config.encoder_counts
    return math.hypot(config.position_noise, step / math.sqrt(12.0))


def quantise(position: np.ndarray, counts: int) -> np.ndarray:
    """Rounds positions [rad] to encoder counts; 0 counts a turn stand for infinite resolution."""
    if counts == 0:
        return position
    rounded = np.rint(position * (counts / (2.0 * math.pi)))
    rounded *= 2.0 * math.pi / counts
    return rounded


def held(reading: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Repeats the last reading wherever one was lost; both (n,), the first is never lost."""
    index = np.where(lost, 0, np.arange(len(reading)))
    return reading[np.maximum.accumulate(index)]
