"""A machine as its controller meets it: measured and commanded once a control period."""

import numpy as np

from leglab.bodies import Bodies
from leglab.changes import Schedule
from leglab.control import Measurement
from leglab.measurement import (
    Encoders,
    SensorConfiguration,
    loop_timing,
    velocity_filter_coefficient,
)
from leglab.scenario import Scenario
from leglab.simulation import Simulation


class SampledMachine:
    """Takes a simulation through a scenario in steps of one control period.

    One period is `measure`, a command written to `data.ctrl`, and `advance`. Whoever steps the
    machine, a headless run, an environment or a viewer, gets the same bits from the same seed.

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
        self.period = period = sensors.control_period
        self.bodies = Bodies(simulation.model)
        self.encoders = Encoders(simulation.joints, sensors, count=count, seed=seed)
        self.schedule = Schedule(scenario, simulation, self.bodies, self.encoders)
        self._noise = np.random.default_rng(seed)
        self._position_noise = self._noise.normal(0.0, sensors.position_noise, (count, joints))
        self._pressure_noise = sensors.pressure_noise
        self._pressures = pressures
        # A control loop runs thousands of times a second: what can be looked up once is.
        self._step, self._state = simulation.step, simulation.data.plugin_state
        self._qpos, self._qpos_index = simulation.data.qpos, simulation.qpos_index
        self._pressure_slots = np.concatenate(
            [simulation.slots("pressure_a"), simulation.slots("pressure_b")]
        )
        self._supply_slot = simulation.supply_slot
        self._joints, self._count = joints, count
        self._gain = velocity_filter_coefficient(period, sensors.velocity_cutoff) / period
        self._leak = 1.0 - self._gain * period
        self._sample = self._qpos.take(self._qpos_index)
        self._sampled_pressures = self._state.take(self._pressure_slots)
        self._previous = self.encoders.read(0, self._sample + self._position_noise[0])
        self._velocity = np.zeros(joints)
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
        self.schedule.apply(now)
        sample = self._sample
        sample += self._position_noise[row]
        measured = self.encoders.read(row, sample)
        self._velocity = velocity = self._leak * self._velocity + self._gain * (
            measured - self._previous
        )
        self._previous = measured
        if not self._pressures:
            return Measurement(now, measured, velocity)
        joints = self._joints
        noisy = self._sampled_pressures + self._noise.normal(0.0, self._pressure_noise, 2 * joints)
        supply = float(self._state[self._supply_slot])
        return Measurement(now, measured, velocity, noisy[:joints], noisy[joints:], supply)

    def advance(self) -> None:
        """Ends a period: the command is held, and the next sample taken ahead of its end."""
        if self._to_sample:
            self._step(self._to_sample)
        self._sample = self._qpos.take(self._qpos_index)
        if self._pressures:
            self._sampled_pressures = self._state.take(self._pressure_slots)
        if self._to_command:
            self._step(self._to_command)

    def close(self) -> None:
        """Takes the loads off the model's bodies."""
        self.bodies.restore()
