"""Recordings of the knee bench, its model, and the states that a replay starts from.

Position and velocity come from a Savitzky-Golay filter, pressures are lightly smoothed, and what
no sensor sees, spool and bristle, by running their exact equations over the measured command and
the smoothed velocity.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pyarrow.parquet as pq
from scipy.linalg import expm
from scipy.signal import savgol_filter

import leglab
from leglab.base.errors import LeglabError
from leglab.machine import plugin
from leglab.machine.parameters import Parameter, State, plugin_tables

SAMPLING_PERIOD = 1e-3  # s, spec/knee_bench.toml [measurement]
WINDOW = 300  # samples, 0.3 s
# Quartic over 21 ms: passes the 2 Hz motion of the bench, takes the noise down to a third.
_POSITION_FILTER = {"window_length": 21, "polyorder": 4}
_PRESSURE_FILTER = {"window_length": 5, "polyorder": 2}


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Measured samples of the knee bench, arrays of shape (n,): rad, 1, Pa."""

    name: str
    position: np.ndarray
    command: np.ndarray
    pressure_a: np.ndarray
    pressure_b: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Starts:
    """Smoothed and reconstructed states at every sample, arrays of shape (n,).

    Attributes:
        position: rad.
        velocity: rad/s.
        acceleration: rad/s^2.
        pressure_a: Pa.
        pressure_b: Pa.
        spool: Relative position and velocity [1, 1/s], shape (n, 2).
        bristle: m.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    pressure_a: np.ndarray
    pressure_b: np.ndarray
    spool: np.ndarray
    bristle: np.ndarray


def nominal_folder() -> Path:
    """Folder of the nominal recordings: $LEGLAB_DATA or ../shared/data beside the repository.

    Raises:
        LeglabError: If there is none; names the places.
    """
    root = Path(leglab.__file__).resolve().parents[1]
    places = [Path(os.environ["LEGLAB_DATA"])] if "LEGLAB_DATA" in os.environ else []
    places += [root.parent / "shared" / "data", root / "shared" / "data"]
    for place in places:
        folder = place / "knee_bench" / "nominal"
        if folder.is_dir():
            return folder
    raise LeglabError(
        f"no folder knee_bench/nominal in {', '.join(map(str, places))}; set LEGLAB_DATA"
    )


def read_recording(path: Path) -> Recording:
    """Reads the channels that a replay needs from a Parquet file."""
    columns = pq.read_table(path)

    def column(name: str) -> np.ndarray:
        return columns[name].to_numpy().astype(float)

    return Recording(
        name=path.stem,
        position=column("knee_position"),
        command=column("knee_valve_command"),
        pressure_a=column("knee_pressure_a"),
        pressure_b=column("knee_pressure_b"),
    )


def bench(timestep: float) -> mujoco.MjModel:
    """The knee bench at a time step [s]."""
    plugin.load()
    path = Path(leglab.__file__).parent / "models" / "knee_bench.xml"
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.timestep = timestep
    return spec.compile()


class KneeBench:
    """The bench with the places of its cylinder's parameters and states.

    Args:
        timestep: Of the model [s].
    """

    def __init__(self, timestep: float) -> None:
        self.model = bench(timestep)
        self.data = mujoco.MjData(self.model)
        self.timestep = timestep
        table = plugin_tables()["leglab.cylinder"]
        start = self.model.plugin_stateadr[self.model.actuator_plugin[0]]
        entries: dict[str, Parameter | State] = {**table.parameters, **table.states}
        self.at = {name: start + entry.offset for name, entry in entries.items()}

    def parameter(self, name: str) -> float:
        """Value of a parameter of the cylinder."""
        return float(self.data.plugin_state[self.at[name]])

    def lever(self, position: np.ndarray) -> np.ndarray:
        """d(piston)/d(knee) [m/rad] at knee positions, shape (n,)."""
        lever = np.empty_like(position)
        for i, q in enumerate(position):
            self.data.qpos[0] = q
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_tendon(self.model, self.data)
            lever[i] = self.data.ten_J.flat[0]
        return lever

    def run(
        self, starts: Starts, command: np.ndarray, first: int, **parameters: float
    ) -> np.ndarray:
        """Knee position and pressures at the end of one window, shape (3,).

        Args:
            starts: Where windows start.
            command: Measured valve command, shape (n,).
            first: Sample at which the window starts.
            **parameters: Parameters of the cylinder that differ from the model.
        """
        model, data, at = self.model, self.data, self.at
        mujoco.mj_resetData(model, data)
        data.qpos[0] = starts.position[first]
        # MuJoCo's velocity lags half a step behind its position.
        lag = 0.5 * self.timestep * starts.acceleration[first]
        data.qvel[0] = starts.velocity[first] - lag
        state = data.plugin_state
        for name, value in parameters.items():
            state[at[name]] = value
        state[at["pressure_a"]] = starts.pressure_a[first]
        state[at["pressure_b"]] = starts.pressure_b[first]
        state[[at["spool_position"], at["spool_velocity"]]] = starts.spool[first]
        state[at["bristle"]] = starts.bristle[first]
        state[at["play_output"]] = command[first - 1] if first else 0.0
        substeps = round(SAMPLING_PERIOD / self.timestep)
        for u in command[first : first + WINDOW]:
            data.ctrl[0] = u
            mujoco.mj_step(model, data, substeps)
        return np.array([data.qpos[0], state[at["pressure_a"]], state[at["pressure_b"]]])


def reconstruct(recording: Recording, rig: KneeBench) -> Starts:
    """States at every sample from the measured channels."""
    position = savgol_filter(recording.position, **_POSITION_FILTER)
    velocity = savgol_filter(recording.position, **_POSITION_FILTER, deriv=1, delta=SAMPLING_PERIOD)
    count = len(position)

    # The bench starts with its spool centred; a command holds from its sample to the next.
    w, zeta = 2 * np.pi * rig.parameter("bandwidth_hz"), rig.parameter("damping_ratio")
    transition = expm(np.array([[0, 1], [-w * w, -2 * zeta * w]]) * SAMPLING_PERIOD)
    spool = np.zeros((count, 2))
    for i in range(count - 1):
        target = np.array([recording.command[i], 0.0])
        spool[i + 1] = target + transition @ (spool[i] - target)

    v = velocity * rig.lever(position)
    coulomb, static = rig.parameter("coulomb"), rig.parameter("static")
    level = coulomb + (static - coulomb) * np.exp(-((v / rig.parameter("stribeck_velocity")) ** 2))
    sigma = rig.parameter("sigma_0")
    steady = np.sign(v) * level / sigma
    fade = np.exp(-sigma * np.abs(v) / level * SAMPLING_PERIOD)
    bristle = np.zeros(count)
    for i in range(count - 1):
        bristle[i + 1] = steady[i] + (bristle[i] - steady[i]) * fade[i]

    return Starts(
        position=position,
        velocity=velocity,
        acceleration=np.gradient(velocity, SAMPLING_PERIOD),
        pressure_a=savgol_filter(recording.pressure_a, **_PRESSURE_FILTER),
        pressure_b=savgol_filter(recording.pressure_b, **_PRESSURE_FILTER),
        spool=spool,
        bristle=bristle,
    )
