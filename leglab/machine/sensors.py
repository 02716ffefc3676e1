"""Sensors of the closed loop: resolution, noise, timing, and the faults of encoders.

Faults come from a scenario or from the model. MJCF has no element for a shifted or miscounting
encoder, so a model stores them as custom numerics: `<joint>_encoder_offset` [rad or m] and
`<joint>_encoder_scale`, measured = scale x true + offset; for pressure sensors likewise
`<joint>_pressure_a_offset` [Pa], `<joint>_pressure_a_scale`, and `..._b_...` for chamber b.
A delayed encoder is a `jointpos` sensor `<joint>_delayed_position` with MuJoCo's `delay`.
`leglab diagnose` writes them into improved.xml; closed loops and replays read them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from pydantic import Field

from leglab._native.loop import Readings
from leglab.base.errors import SettingsError
from leglab.base.settings import Configuration
from leglab.machine.parameters import Parameter

# Upper limit on time steps per control period: more would take hours per simulated second.
_MOST_STEPS = 100_000
# Count of normal numbers drawn at a time to skip them; `advance` would need their number of bits.
_SKIPPED = 8192
# Difference below which two times count as equal [s].
_SAME_TIME = 1e-9


class SensorConfiguration(Configuration):
    """Sensors and timing of the control loop.

    Defaults are those of the knee bench's recordings (encoder of 17 bits). A period and a latency
    that nobody sets are rounded up to whole time steps of the model (`in_whole_steps`).

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


def in_whole_steps(config: SensorConfiguration, timestep: float) -> SensorConfiguration:
    """Rounds default values of period and latency up to whole time steps of a model.

    They are rounded up, because the machine's computer could also run a somewhat slower loop with
    older measurements. Values set explicitly stay; `loop_timing` rejects values that are no
    multiple of the time step.

    Args:
        config: Sensors and timing.
        timestep: Time step of the model [s].
    """
    rounded = {}
    for name in ("control_period", "latency"):
        if name not in config.model_fields_set:
            value = getattr(config, name)
            steps = math.ceil(value / timestep - 1e-6)
            if abs(value - steps * timestep) > _SAME_TIME:
                rounded[name] = steps * timestep
    return config.model_copy(update=rounded) if rounded else config


class LoopTiming(NamedTuple):
    """Numbers of time steps from a command to the sensor sample, and from there to a command."""

    to_sample: int
    to_command: int


def loop_timing(config: SensorConfiguration, timestep: float) -> LoopTiming:
    """Splits a control period into whole time steps.

    Raises:
        SettingsError: Period or latency is no multiple of the time step, or latency > period.
    """
    if config.control_period / timestep > _MOST_STEPS:
        least = f"at least {config.control_period / _MOST_STEPS:g} s"
        raise SettingsError(
            f"timestep = {timestep:g} s; allowed: ",
            given=timestep,
            allowed=f"{least}, {_MOST_STEPS} steps a control period",
        )
    steps = round(config.control_period / timestep)
    late = round(config.latency / timestep)
    for name, count in (("control_period", steps), ("latency", late)):
        value = getattr(config, name)
        if abs(value - count * timestep) > _SAME_TIME or (name == "control_period" and count < 1):
            raise SettingsError(
                f"{name} = {value:g} s; allowed: ",
                given=value,
                allowed=f"a multiple of the model's timestep {timestep:g} s",
            )
    if late > steps:
        raise SettingsError(
            f"latency = {config.latency:g} s; allowed: ",
            given=config.latency,
            allowed=f"at most control_period = {config.control_period:g} s",
        )
    return LoopTiming(to_sample=steps - late, to_command=late)


def velocity_filter_coefficient(period: float, cutoff_hz: float) -> float:
    """Returns the gain a of the filter v[k] += a ((q[k] - q[k-1])/T - v[k-1])."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * period)


class VelocityFilter:
    """The control loop's velocity estimator, applied to measured positions block by block.

    Args:
        config: Provides the control period and the filter's cutoff.
    """

    def __init__(self, config: SensorConfiguration) -> None:
        a = velocity_filter_coefficient(config.control_period, config.velocity_cutoff)
        self._gain, self._keep = a / config.control_period, 1.0 - a
        self._position: np.ndarray | None = None
        self._velocity: np.ndarray | float = 0.0

    def of(self, positions: np.ndarray) -> np.ndarray:
        """Returns the velocities of the next block of positions.

        Args:
            positions: One row per control period [rad or m], (n, joints).

        Returns:
            Velocities [rad/s or m/s], (n, joints); 0 in the first row of the first block.
        """
        first = positions[:1] if self._position is None else self._position
        found = np.diff(positions, axis=0, prepend=first) * self._gain
        before = self._velocity
        # A loop, because the import of scipy.signal in each run of a sweep takes longer than a run.
        for now in found:
            now += self._keep * before
            before = now
        self._position, self._velocity = positions[-1:].copy(), found[-1].copy()
        return found


def velocity_delay(period: float, cutoff_hz: float) -> float:
    """Returns a velocity estimate's delay [s]: half a period of the difference plus filter lag.

    The lag of v[k] += a (x[k] - v[k-1]) on a ramp is T (1 - a)/a.
    """
    a = velocity_filter_coefficient(period, cutoff_hz)
    return period / 2 + period * (1 - a) / a


def position_uncertainty(config: SensorConfiguration) -> float:
    """Returns a measured position's RMS error [rad]: noise, and rounding by count/sqrt(12)."""
    if config.encoder_counts == 0:
        return config.position_noise
    step = 2.0 * math.pi / config.encoder_counts
    return math.hypot(config.position_noise, step / math.sqrt(12.0))


def quantise(position: np.ndarray, counts: int) -> np.ndarray:
    """Rounds positions [rad] to `counts` encoder counts per turn; 0 for infinite resolution."""
    if counts == 0:
        return position
    rounded = np.rint(position * (counts / (2.0 * math.pi)))
    rounded *= 2.0 * math.pi / counts
    return rounded


def held(reading: np.ndarray, lost: np.ndarray, before: float | None = None) -> np.ndarray:
    """Replaces lost readings by the last valid one before them (zero-order hold).

    Args:
        reading: Readings without losses, (n,).
        lost: True where a reading is lost, (n,); without `before` the first must not be lost.
        before: Reading that precedes the first one; None if there is none.
    """
    if before is not None:
        return held(np.append(before, reading), np.append(False, lost))[1:]
    index = np.where(lost, 0, np.arange(len(reading)))
    return reading[np.maximum.accumulate(index)]


def skip_normal(noise: np.random.Generator, count: int) -> None:
    """Advances a generator as if it had drawn `count` normal numbers."""
    while count > 0:
        count -= noise.standard_normal(min(count, _SKIPPED)).size


ENCODER_OFFSET = "{joint}_encoder_offset"
ENCODER_SCALE = "{joint}_encoder_scale"
PRESSURE_OFFSET = "{joint}_{chamber}_offset"
PRESSURE_SCALE = "{joint}_{chamber}_scale"
CHAMBERS = ("pressure_a", "pressure_b")


def delayed_sensor(joint: str) -> str:
    """Returns the name of the sensor that measures a joint's position with a delay."""
    return f"{joint}_delayed_position"


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderFaults:
    """Encoder faults stored in a model; arrays of shape (joints,)."""

    offset: np.ndarray  #: Added to every reading [rad or m]
    scale: np.ndarray  #: Factor on the true position
    delay: np.ndarray  #: Age of the measured position [s]

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: Sequence[str]) -> "EncoderFaults":
        """Reads the faults of a compiled model."""

        def delay(joint: str) -> float:
            i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, delayed_sensor(joint))
            return 0.0 if i < 0 else float(model.sensor_delay[i])

        return cls(
            offset=np.array([_number(model, ENCODER_OFFSET.format(joint=j), 0.0) for j in joints]),
            scale=np.array([_number(model, ENCODER_SCALE.format(joint=j), 1.0) for j in joints]),
            delay=np.array([delay(j) for j in joints]),
        )

    def __bool__(self) -> bool:
        return bool(self.offset.any() or (self.scale != 1.0).any() or self.delay.any())

    def needed(self, period: float) -> int:
        """Returns the number of latest samples on which a reading depends."""
        return math.ceil(float(self.delay.max(initial=0.0)) / period) + 2

    def seen(self, positions: np.ndarray, last: int, period: float) -> np.ndarray:
        """Returns the encoder readings at the latest position sample, (joints,).

        Args:
            positions: Ring buffer with sample i in row i modulo n, n >= `needed`, (n, joints).
            last: Number of the latest sample, counted from 0.
            period: Sampling period [s]; a delay between samples is interpolated.
        """
        at = np.clip(last - self.delay / period, 0.0, None)
        before = np.floor(at).astype(int)
        count, joints = len(positions), np.arange(self.delay.size)
        early = positions[before % count, joints]
        later = positions[np.minimum(before + 1, last) % count, joints]
        return self.scale * (early + (at - before) * (later - early)) + self.offset


@dataclass(frozen=True, kw_only=True, eq=False)
class PressureFaults:
    """Pressure sensor faults stored in a model.

    Arrays hold chamber A of every joint, then chamber B, shape (2 joints,).
    """

    offset: np.ndarray  #: Added to every reading [Pa]
    scale: np.ndarray  #: Factor on the true pressure

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: Sequence[str]) -> "PressureFaults":
        """Reads the faults of a compiled model."""
        places = [{"joint": joint, "chamber": chamber} for chamber in CHAMBERS for joint in joints]
        return cls(
            offset=np.array([_number(model, PRESSURE_OFFSET.format(**p), 0.0) for p in places]),
            scale=np.array([_number(model, PRESSURE_SCALE.format(**p), 1.0) for p in places]),
        )

    def __bool__(self) -> bool:
        return bool(self.offset.any() or (self.scale != 1.0).any())

    def seen(self, pressures: np.ndarray) -> np.ndarray:
        """Converts true pressures to measured ones [Pa]; the last axis has 2 joints entries."""
        return self.scale * pressures + self.offset


def _number(model: mujoco.MjModel, name: str, otherwise: float) -> float:
    """Returns a custom numeric of a compiled model; `otherwise` if there is none."""
    i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    return otherwise if i < 0 else float(model.numeric_data[model.numeric_adr[i]])


_SLIP = "added to every reading, as after a slip of the encoder on its shaft"
_LOSS = "share of readings that are lost; the last one is repeated"
FAULTS = {
    "encoder_offset": Parameter("encoder_offset", "rad", 0.0, -math.pi, math.pi, True, _SLIP),
    "encoder_dropout": Parameter("encoder_dropout", "1", 0.0, 0.0, 1.0, True, _LOSS, offset=1),
}


class Encoders:
    """Encoders of the driven joints, with faults from a scenario or from the model.

    Args:
        joints: Names of the joints; changes of a scenario address them as elements.
        sensors: Resolution and timing.
        positions: Array of the true positions [rad], updated by the simulation.
        index: Indices of the joints in `positions`, (joints,).
        noise: Noise of the first block of readings [rad], (kept, joints), `kept` per block.
        seed: Seed of the losses.
        built_in: Faults stored in the model; None for none.

    Attributes:
        elements: Names of the joints.
        position: The last reading [rad], (joints,).
        velocity: The filtered difference of readings [rad/s], (joints,).
        sample: Function that samples the present positions for the next reading.
        shift: Shift of every reading since `begin` by faults [rad], (kept, joints).
        lost: True for readings since `begin` that were lost, (kept, joints).
        noise: Noise of the readings since `begin` [rad], (kept, joints).
        built_in: Faults stored in the model; None for none.
        gain: Factor on the difference of two readings in the velocity filter [1/s].
        keep: Factor on the previous velocity in the velocity filter.
    """

    def __init__(
        self,
        joints: tuple[str, ...],
        sensors: SensorConfiguration,
        *,
        positions: np.ndarray,
        index: np.ndarray,
        noise: np.ndarray,
        seed: int,
        built_in: EncoderFaults | None = None,
    ) -> None:
        self.elements = joints
        self.built_in = built_in or None
        self._period = period = sensors.control_period
        needed = self.built_in.needed(period) if self.built_in else 0
        self._shown = np.zeros((needed, len(joints)))
        self._noisy = np.zeros(len(joints))
        self.position, self.velocity = np.zeros(len(joints)), np.zeros(len(joints))
        self.shift = np.zeros(noise.shape)
        self.lost = np.zeros(noise.shape, dtype=bool)
        self._values = np.zeros((len(FAULTS), len(joints)))
        self._seed, self._first = seed, 0
        self.noise = noise
        self.gain = velocity_filter_coefficient(period, sensors.velocity_cutoff) / period
        self.keep = 1.0 - self.gain * period
        self._readings = Readings(
            positions=positions,
            joints=np.asarray(index, dtype=np.int64),
            noise=noise,
            shift=self.shift,
            lost=self.lost,
            counts=sensors.encoder_counts,
            gain=self.gain,
            keep=self.keep,
            position=self.position,
            velocity=self.velocity,
        )
        self.sample = self._readings.sample
        self.sample()
        self._faulty = self.built_in is not None
        if self._faulty:
            self._disturb(0)
        self._readings.start()

    @cached_property
    def _chance(self) -> np.ndarray:
        """Draws uniform numbers that decide on losses, (kept, joints); only if a fault is set."""
        bits = np.random.PCG64([self._seed, 2])
        bits.advance(self._first * len(self.elements))  # one draw per uniform number
        return np.random.Generator(bits).random(self.noise.shape)

    def has(self, element: str, name: str) -> bool:
        """Tests whether a joint has a fault of this name."""
        return element in self.elements and name in FAULTS

    def parameter(self, element: str, name: str) -> float:
        """Returns the present magnitude of a fault, in the fault's unit."""
        return float(self._values[self._index(element, name)])

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets a fault of an encoder from now on.

        Raises:
            SettingsError: If joint or name do not exist or the value is out of bounds.
        """
        index = self._index(element, name)
        self._values[index] = FAULTS[name].check(value, f"encoder of joint {element!r}")
        self._faulty = True

    def begin(self, first: int, noise: np.ndarray) -> None:
        """Starts the next block of readings, which are again counted from 0.

        Args:
            first: Number of readings before the block.
            noise: Noise of the block's readings [rad], (at most kept, joints).
        """
        self.noise[: len(noise)] = noise
        self._first = first
        self.__dict__.pop("_chance", None)

    def read(self, k: int) -> None:
        """Computes reading `k` of position and velocity from the last sample."""
        if self._faulty:
            self._disturb(k)
        self._readings.read(k)

    def hold(self, k: int) -> None:
        """Writes the present faults into `shift` and `lost` of all readings from `k` on."""
        if self._faulty:
            self.shift[k:] = self._values[0]
            self.lost[k:] = self._chance[k:] < self._values[1]

    def _disturb(self, k: int) -> None:
        """Computes shift and loss of reading `k` due to faults."""
        self.shift[k] = self._values[0]
        if self.built_in:
            number = self._first + k
            self._readings.noisy(k, self._noisy)
            self._shown[number % len(self._shown)] = self._noisy
            shown = self.built_in.seen(self._shown, number, self._period)
            self.shift[k] += shown - self._noisy
        # The very first reading is never lost, because no earlier reading could be repeated.
        self.lost[k] = (self._chance[k] < self._values[1]) & (self._first + k > 0)

    def _index(self, element: str, name: str) -> tuple[int, int]:
        if name not in FAULTS:
            raise SettingsError.unknown("encoder fault", name, FAULTS)
        if element not in self.elements:
            raise SettingsError.unknown("joint", element, self.elements)
        return FAULTS[name].offset, self.elements.index(element)
