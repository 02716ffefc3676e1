"""What sensors make of the true state: resolution, noise, latency, velocity from positions."""

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from leglab.configuration import Configuration
from leglab.encoders import EncoderFaults
from leglab.errors import LeglabError, unknown_name
from leglab.parameters import Parameter


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


_FAULTS = {
    row.name: row
    for row in (
        Parameter(
            name="encoder_offset",
            unit="rad",
            nominal=0.0,
            minimum=-math.pi,
            maximum=math.pi,
            minimum_allowed=True,
            description="added to every reading, as after a slip of the encoder on its shaft",
            offset=0,
        ),
        Parameter(
            name="encoder_dropout",
            unit="1",
            nominal=0.0,
            minimum=0.0,
            maximum=1.0,
            minimum_allowed=True,
            description="share of readings that are lost; the last one is repeated",
            offset=1,
        ),
    )
}


class Encoders:
    """What the encoders of the driven joints report, and the faults that they can have.

    Args:
        joints: Names of the joints, the elements of a change.
        sensors: Resolution.
        count: Number of readings.
        seed: Of the losses.
        built_in: Faults that the model carries from the start; None for none.

    Attributes:
        elements: Names of the joints.
        shift: What faults added to every reading so far [rad], (count, joints).
        lost: Which readings so far were lost, (count, joints).
    """

    def __init__(
        self,
        joints: tuple[str, ...],
        sensors: SensorConfiguration,
        *,
        count: int,
        seed: int,
        built_in: EncoderFaults | None = None,
    ) -> None:
        self.elements = joints
        self._built_in = built_in or None
        self._period = sensors.control_period
        self._shown = np.zeros((count if self._built_in else 0, len(joints)))
        self.shift = np.zeros((count, len(joints)))
        self.lost = np.zeros((count, len(joints)), dtype=bool)
        self._counts = sensors.encoder_counts
        self._values = np.zeros((len(_FAULTS), len(joints)))
        self._faulty = False
        self._chance = np.random.default_rng([seed, 2]).random((count, len(joints)))
        self._last = np.empty(len(joints))

    def has(self, element: str, name: str) -> bool:
        """Says whether a joint has a fault of this name."""
        return element in self.elements and name in _FAULTS

    def parameter(self, element: str, name: str) -> float:
        """Present size of a fault, in its own unit."""
        return float(self._values[self._index(element, name)])

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets a fault of an encoder from now on.

        Raises:
            LeglabError: If joint or name do not exist or the value is out of bounds.
        """
        index = self._index(element, name)
        self._values[index] = _FAULTS[name].check(value, f"encoder of joint {element!r}")
        self._faulty = bool(self._values.any())

    def read(self, k: int, position: np.ndarray) -> np.ndarray:
        """Returns the readings number `k` [rad], (joints,), of noisy positions [rad]."""
        if self._built_in:
            self._shown[k] = position
            self.shift[k] = self._built_in.seen(self._shown[: k + 1], self._period) - position
        if self._faulty:
            self.shift[k] += self._values[0]
            self.lost[k] = self._chance[k] < self._values[1]
        if self._built_in or self._faulty:
            position = position + self.shift[k]
        reading = quantise(position, self._counts)
        if self._faulty and k > 0:
            reading = np.where(self.lost[k], self._last, reading)
        self._last = reading
        return reading

    def _index(self, element: str, name: str) -> tuple[int, int]:
        if name not in _FAULTS:
            raise unknown_name("encoder fault", name, _FAULTS)
        if element not in self.elements:
            raise unknown_name("joint", element, self.elements)
        return _FAULTS[name].offset, self.elements.index(element)


def held(reading: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Repeats the last reading wherever one was lost; both (n,), the first is never lost."""
    index = np.where(lost, 0, np.arange(len(reading)))
    return reading[np.maximum.accumulate(index)]
