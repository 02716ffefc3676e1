"""Simulated machine with sensors and a scenario's changes, in steps of one control period."""

import numpy as np

from leglab._native.loop import Drives
from leglab.base.scenario import Scenario
from leglab.control import Measurement
from leglab.machine.changes import Bodies, NativeJoints, Schedule
from leglab.machine.sensors import (
    EncoderFaults,
    Encoders,
    PressureFaults,
    SensorConfiguration,
    loop_timing,
    skip_normal,
)
from leglab.machine.simulation import Simulation


class SampledMachine:
    """Simulation of a machine through a scenario in steps of one control period.

    One period is `measure`, `send` and `advance`. A headless run, an environment and a viewer get
    bitwise equal results from the same seed.

    Args:
        simulation: The machine, at the start of the run.
        scenario: Scenario with the changes.
        sensors: Resolution, noise and timing of the sensors.
        count: Number of periods after which the noise repeats.
        kept: Number of periods whose noise is drawn at a time; results do not depend on it.
        seed: Seed of the sensor noise.
        pressures: Whether pressures are measured, if there are cylinders.

    Attributes:
        simulation: The machine.
        period: Control period [s].
        bodies: Loads on its bodies; `close` removes them.
        encoders: Its encoders and their faults.
        schedule: Applies the scenario's changes.
        send: Function that sends commands (joints,), clipped to [-1, 1], to valves and native
            actuators; for anything but an array of finite numbers it returns False and sends none.
        row: Index of the present period in the drawn block of noise.
        exact: True if the model defines no faults of encoders and pressure sensors.

    Raises:
        LeglabError: The timing or a change does not fit the machine.
    """

    def __init__(
        self,
        simulation: Simulation,
        scenario: Scenario,
        sensors: SensorConfiguration,
        *,
        count: int,
        kept: int,
        seed: int,
        pressures: bool,
    ) -> None:
        joints = len(simulation.joints)
        self._to_sample, self._to_command = loop_timing(sensors, simulation.model.opt.timestep)
        self.simulation = simulation
        self.period = sensors.control_period
        self.bodies = Bodies(simulation.model)
        self._seed, self._position_noise = seed, sensors.position_noise
        self._count, self._kept = count, min(kept, count)
        self._first, self._end = 0, self._kept
        self._encoder_noise = np.random.default_rng(seed)
        self.encoders = Encoders(
            simulation.joints,
            sensors,
            positions=simulation.data.qpos,
            index=simulation.qpos_index,
            noise=self._encoder_noise.normal(0.0, sensors.position_noise, (self._kept, joints)),
            seed=seed,
            built_in=EncoderFaults.of(simulation.model, simulation.joints),
        )
        self._native = NativeJoints(simulation)
        self.schedule = Schedule(scenario, simulation, self._native, self.bodies, self.encoders)
        self._pressure_noise = sensors.pressure_noise
        hydraulic = simulation.hydraulic_joints
        self._pressure_faults = PressureFaults.of(simulation.model, hydraulic) or None
        self._pressures = pressures and bool(hydraulic)
        # In the random sequence the pressure noise follows the noise of all positions.
        self._noise = self._encoder_noise
        if self._pressures and self._kept < count:
            self._noise = np.random.default_rng(seed)
            skip_normal(self._noise, count * joints)
        # A control loop runs thousands of times per second, so attribute look-ups are cached.
        self._step, self._state = simulation.step, simulation.data.plugin_state
        self._apply, self._read = self.schedule.apply, self.encoders.read
        self._sample = self.encoders.sample
        self._readings = self.encoders.position, self.encoders.velocity
        self.send = Drives(simulation.data.ctrl, simulation.centre, simulation.half).send
        self._pressure_slots = np.concatenate(
            [simulation.slots("pressure_a"), simulation.slots("pressure_b")]
        )
        self._supply_slot = simulation.supply_slot if hydraulic else -1
        self._cylinders = len(hydraulic)
        self._sampled_pressures = self._state.take(self._pressure_slots)
        self.exact = not (self._pressure_faults or self.encoders.built_in)
        self._periods = 0
        self.row = -1

    def measure(self) -> Measurement:
        """Begins a period: applies the changes that are due and reads the sensors."""
        now = self._periods * self.period
        row = self.row + 1
        if row == self._end:
            row = 0
            self._draw()
        self._periods += 1
        self.row = row
        self._apply(now)
        self._read(row)
        if not self._pressures:
            return Measurement(now, *self._readings)
        count = self._cylinders
        noisy = self._sampled_pressures + self._noise.normal(0.0, self._pressure_noise, 2 * count)
        if self._pressure_faults:
            noisy = self._pressure_faults.seen(noisy)
        supply = float(self._state[self._supply_slot])
        return Measurement(now, *self._readings, noisy[:count], noisy[count:], supply)

    def _draw(self) -> None:
        """Draws the noise of the next `kept` periods; the noise repeats after `count` periods."""
        self._first += self._end
        if self._first == self._count:
            self._first, self._encoder_noise = 0, np.random.default_rng(self._seed)
        self._end = min(self._kept, self._count - self._first)
        shape = self._end, len(self.simulation.joints)
        noise = self._encoder_noise.normal(0.0, self._position_noise, shape)
        self.encoders.begin(self._first, noise)

    def pressure_noise(self, count: int) -> np.ndarray:
        """Draws the pressure noise that the next `count` calls of `measure` would use.

        Returns:
            Noise [Pa], (count, 2 cylinders); without columns if no pressure is measured.
        """
        columns = 2 * self._cylinders if self._pressures else 0
        return self._noise.normal(0.0, self._pressure_noise, (count, columns))

    def advance(self) -> None:
        """Ends a period: simulates it with the command held, and samples sensors before its end."""
        if self._to_sample:
            self._step(self._to_sample)
        self._sample()
        if self._pressures:
            self._sampled_pressures = self._state.take(self._pressure_slots)
        if self._to_command:
            self._step(self._to_command)

    def close(self) -> None:
        """Restores the model: removes loads from bodies, undoes changes of joints and drives."""
        self.bodies.restore()
        self._native.restore()
