"""A machine as its controller meets it: measured and commanded once a control period."""

import numpy as np

from leglab._native.loop import Valves
from leglab.bodies import Bodies
from leglab.changes import Schedule
from leglab.control import Measurement
from leglab.encoders import EncoderFaults, Encoders
from leglab.measurement import SensorConfiguration, loop_timing
from leglab.scenario import Scenario
from leglab.simulation import Simulation


class SampledMachine:
    """Takes a simulation through a scenario in steps of one control period.

    One period is `measure`, `send` and `advance`. Whoever steps the machine, a headless run, an
    environment or a viewer, gets the same bits from the same seed.

    Args:
        simulation: The machine, at the start of the run.
        scenario: Changes.
        sensors: Resolution, noise and timing.
        count: Periods for which noise is drawn; it repeats after them.
        seed: Of the sensor noise.
        pressures: Whether pressures are measured.

    Attributes:
        simulation: The machine.
        period: Control period [s].
        bodies: Loads on its bodies; `close` takes them off.
        encoders: Its encoders and their faults.
        schedule: Carries out the scenario's changes.
        send: Function that sends commands (joints,) to the valves, clipped to [-1, 1]; False, and
            nothing sent, for what is no array of finite numbers.
        row: Number of the present period within the drawn noise.

    Raises:
        LeglabError: If the timing or a change does not fit the machine.
    """

    def __init__(
        self,
        simulation: Simulation,
        scenario: Scenario,
        sensors: SensorConfiguration,
        *,
        count: int,
        seed: int,
        pressures: bool,
    ) -> None:
        joints = len(simulation.joints)
        self._to_sample, self._to_command = loop_timing(sensors, simulation.model.opt.timestep)
        self.simulation = simulation
        self.period = sensors.control_period
        self.bodies = Bodies(simulation.model)
        self._noise = np.random.default_rng(seed)
        self.encoders = Encoders(
            simulation.joints,
            sensors,
            positions=simulation.data.qpos,
            index=simulation.qpos_index,
            noise=self._noise.normal(0.0, sensors.position_noise, (count, joints)),
            seed=seed,
            built_in=EncoderFaults.of(simulation.model, simulation.joints),
        )
        self.schedule = Schedule(scenario, simulation, self.bodies, self.encoders)
        self._pressure_noise = sensors.pressure_noise
        self._pressures = pressures
        # A control loop runs thousands of times a second: what can be looked up once is.
        self._step, self._state = simulation.step, simulation.data.plugin_state
        self._apply, self._read = self.schedule.apply, self.encoders.read
        self._sample = self.encoders.sample
        self._readings = self.encoders.position, self.encoders.velocity
        self.send = Valves(simulation.data.ctrl).send
        self._pressure_slots = np.concatenate(
            [simulation.slots("pressure_a"), simulation.slots("pressure_b")]
        )
        self._supply_slot = simulation.supply_slot
        self._joints, self._count = joints, count
        self._sampled_pressures = self._state.take(self._pressure_slots)
        self._periods = 0
        self.row = -1

    def measure(self) -> Measurement:
        """Begins a period: what changes now does so, and the sensors are read."""
        now = self._periods * self.period
        row = self.row + 1
        if row == self._count:
            row = 0
        self._periods += 1
        self.row = row
        self._apply(now)
        self._read(row)
        if not self._pressures:
            return Measurement(now, *self._readings)
        joints = self._joints
        noisy = self._sampled_pressures + self._noise.normal(0.0, self._pressure_noise, 2 * joints)
        supply = float(self._state[self._supply_slot])
        return Measurement(now, *self._readings, noisy[:joints], noisy[joints:], supply)

    def advance(self) -> None:
        """Ends a period: the command is held, and the next sample taken ahead of its end."""
        if self._to_sample:
            self._step(self._to_sample)
        self._sample()
        if self._pressures:
            self._sampled_pressures = self._state.take(self._pressure_slots)
        if self._to_command:
            self._step(self._to_command)

    def close(self) -> None:
        """Takes the loads off the model's bodies."""
        self.bodies.restore()
