"""A machine with hidden faults that is run in closed loop and recorded by noisy sensors."""

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np

from leglab.base.recording import Recording
from leglab.machine.parameters import PluginTable
from leglab.machine.plugin import elements

SAMPLING_PERIOD = 1e-3  # s
# Neither the replay's step nor half of it, which corrects the replay.
TIMESTEP = 0.2e-3  # s
ENCODER_STEP = 2.0 * np.pi / 131072.0  # rad, spec/knee_bench.toml [measurement]
POSITION_NOISE = 2e-5  # rad rms
PRESSURE_NOISE = 1.5e4  # Pa rms
_LOOP_GAIN = 0.5  # valve command per rad
_FEEDFORWARD = 0.031  # valve command per rad/s: 1/(27 rad/s at full opening), 16 bar drop margin

# Generalised force on the knee from time, position, velocity and actuator force on the knee.
Torque = Callable[[float, float, float, float], float]


@dataclass(kw_only=True)
class Plant:
    """The knee bench with what is wrong with it; faults write here.

    Attributes:
        model: Compiled with the fine step; faults may change it.
        tuning: Plugin parameters of this good machine, by element and name.
        parameters: The same of what is wrong with it.
        torques: Further generalised forces on the knee.
        command_delay: s.
        encoder: (scale, offset [rad], delay [s]) of the position sensor.
        onset: Time at which parameters, torques and delay set in [s].
    """

    model: mujoco.MjModel
    tuning: dict[tuple[str, str], float] = field(default_factory=dict)
    parameters: dict[tuple[str, str], float] = field(default_factory=dict)
    torques: list[Torque] = field(default_factory=list)
    command_delay: float = 0.0
    encoder: tuple[float, float, float] = (1.0, 0.0, 0.0)
    onset: float = 0.0

    def record(self, reference: np.ndarray, rng: np.random.Generator) -> Recording:
        """Follows a reference, shape (n,) at the sampling period, and records it."""
        model, data = self.model, mujoco.MjData(self.model)
        places: dict[str, tuple[int, PluginTable]] = elements(model)
        substeps = round(SAMPLING_PERIOD / TIMESTEP)
        start, table = places["knee_valve"]
        slots = [start + table.entry(n).offset for n in ("pressure_a", "pressure_b")]
        self._set(data, places, self.tuning)
        if self.onset <= 0.0:
            self._set(data, places, self.parameters)
        data.qpos[0] = reference[0]
        _settle(model, data, start, table)
        count = reference.size
        true = np.empty((count, 3))
        command = np.empty(count)
        rate = np.gradient(reference, SAMPLING_PERIOD)
        scale, offset, late = self.encoder
        lag = round(self.command_delay / TIMESTEP)
        queue = np.zeros(lag + 1)
        seen_late = round(late / SAMPLING_PERIOD)
        active = self.onset <= 0.0
        for k in range(count):
            true[k] = data.qpos[0], data.plugin_state[slots[0]], data.plugin_state[slots[1]]
            seen = scale * true[max(k - seen_late, 0), 0] + offset
            seen += POSITION_NOISE * rng.standard_normal()
            u = -_LOOP_GAIN * (reference[k] - seen) - _FEEDFORWARD * rate[k]
            command[k] = np.clip(u, -1.0, 1.0)
            if not active and k * SAMPLING_PERIOD >= self.onset:
                self._set(data, places, self.parameters)
                active = True
            for _ in range(substeps):
                queue[1:] = queue[:-1]
                queue[0] = command[k]
                data.ctrl[0] = queue[lag] if active else command[k]
                if self.torques:
                    load = float(data.qfrc_actuator[0])
                    v = float(data.qvel[0])
                    total = sum(t(data.time, float(data.qpos[0]), v, load) for t in self.torques)
                    data.qfrc_applied[0] = total if active else 0.0
                mujoco.mj_step(model, data)
        time = SAMPLING_PERIOD * np.arange(count)
        position = scale * _shifted(true[:, 0], late) + offset
        position = position + POSITION_NOISE * rng.standard_normal(count)
        noise = PRESSURE_NOISE * rng.standard_normal((count, 2))
        return Recording(
            time=time,
            columns={
                "knee_position": np.round(position / ENCODER_STEP) * ENCODER_STEP,
                "knee_valve_command": command,
                "knee_pressure_a": true[:, 1] + noise[:, 0],
                "knee_pressure_b": true[:, 2] + noise[:, 1],
            },
        )

    @staticmethod
    def _set(
        data: mujoco.MjData,
        places: dict[str, tuple[int, PluginTable]],
        values: dict[tuple[str, str], float],
    ) -> None:
        for (element, name), value in values.items():
            start, table = places[element]
            data.plugin_state[start + table.entry(name).offset] = value


def _settle(model: mujoco.MjModel, data: mujoco.MjData, start: int, table: PluginTable) -> None:
    """Runs a simple position loop for a second, so that recordings start from rest."""
    target = float(data.qpos[0])
    for _ in range(round(1.0 / TIMESTEP)):
        data.ctrl[0] = -_LOOP_GAIN * (target - data.qpos[0])
        mujoco.mj_step(model, data)
    data.time = 0.0


def _shifted(samples: np.ndarray, delay: float) -> np.ndarray:
    """Samples that arrive late, by linear interpolation, shape (n,)."""
    time = SAMPLING_PERIOD * np.arange(samples.size)
    return np.interp(time - delay, time, samples)
