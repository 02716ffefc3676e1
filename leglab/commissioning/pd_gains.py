"""Tuning of PD gains on the linearised plant: the fastest loop that keeps its stability margins.

Gains of the shipped models are stored in `pd_gains.toml`, which `leglab tune` writes.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from leglab.base.errors import LeglabError
from leglab.commissioning.calibration import drive_signs, free_inertia, native_speed_limit
from leglab.commissioning.gains_file import CYLINDER_MODELS, GainsFile, Row, stored_name
from leglab.commissioning.nominal import inertia_matrix
from leglab.machine.cylinder import CONTINUOUS_STATES, Cylinder
from leglab.machine.native import NativeActuator
from leglab.machine.sensors import SensorConfiguration, in_whole_steps, velocity_filter_coefficient
from leglab.machine.simulation import Simulation, load_model

if TYPE_CHECKING:
    import control

TUNED_MODELS = (*CYLINDER_MODELS, "leg_motor")

GAIN_MARGIN_DB = 6.0
PHASE_MARGIN_DEG = 45.0
# File of PD gains, written by `leglab tune` and not edited by hand.
PD = GainsFile(
    path=Path(__file__).with_name("pd_gains.toml"),
    head=(
        "PD gains by `leglab tune --write`: the greatest K_p that keeps "
        f"{GAIN_MARGIN_DB:g} dB and {PHASE_MARGIN_DEG:g} degrees",
        "at every pose and piston speed of the linearised plant. Not to be edited by hand.",
    ),
    timing=("control_period", "latency", "velocity_cutoff"),
    formats={
        "position": ".4g",
        "velocity": ".4g",
        "gain_margin_db": ".2f",
        "phase_margin_deg": ".1f",
        "crossover": ".2f",
    },
)
# Piston speeds [m/s] at which the plant is linearised, in both directions. The linear plant lacks
# dry friction, which has no slope at these speeds and would stabilise the loop.
SPEEDS = (-0.2, -0.05, -0.01, 0.01, 0.05, 0.2)
# Speeds of a native actuator at which the plant is linearised, as shares of its full speed.
NATIVE_SPEEDS = (-0.5, -0.1, 0.1, 0.5)
# Largest gains to try for a valve: command per position error [1/rad] (`_MOST_POSITION`), per
# velocity error [s/rad] (`_MOST_VELOCITY`). For native actuators `_most_gains` computes both.
_MOST_POSITION, _MOST_VELOCITY = 50.0, 0.2
_INDEX = {name: i for i, name in enumerate(CONTINUOUS_STATES)}
_STATES = ("velocity", "pressure_a", "pressure_b", "spool_position", "spool_velocity")


def joint_plant(
    simulation: Simulation, joint: int, speed: float, *, held: bool = False
) -> "control.StateSpace":
    """Linearises one joint from valve command to joint position [rad] in the present pose.

    The piston runs at `speed` [m/s] under the load of the pose. The other joints are held, or free,
    so that the cylinder moves the effective mass 1/(J M^-1 J').
    """
    import control  # takes a second, and most runs use stored gains

    model, data = simulation.model, simulation.data
    lever = float(simulation.levers()[joint])
    row = np.zeros(model.nv)
    row[simulation.dof_index[joint]] = lever
    solved = np.zeros((1, model.nv))
    mujoco.mj_solveM(model, data, solved, row[None, :])
    mass = 1.0 / float(row @ solved[0])

    values = {**simulation.cylinder_parameters(simulation.actuators[joint])}
    values.update(coulomb=0.0, static=0.0, sigma_0=0.0, sigma_1=0.0)
    cylinder = Cylinder(values)
    force = float(data.qfrc_bias[simulation.dof_index[joint]]) / lever
    steady = cylinder.steady_state(speed, force)
    length = data.actuator_length[joint]
    position = 0.5 * values["stroke"] + length - values["mid_length"]
    centre = cylinder.initial_state(
        position=position,
        velocity=speed,
        spool_position=steady.spool,
        pressure_a=steady.pressure_a,
        pressure_b=steady.pressure_b,
    )
    command = steady.spool - values["null_bias"]

    def slope(offset: np.ndarray, step: float = 0.0) -> np.ndarray:
        return cylinder.derivative(centre + offset, command=command + step, mass=mass, load=force)

    rows = [_INDEX[name] for name in _STATES]
    a = np.zeros((6, 6))
    for column, (name, eps) in enumerate(zip(_STATES, (1e-5, 1e1, 1e1, 1e-6, 1e-3), strict=True)):
        offset = np.zeros(len(CONTINUOUS_STATES))
        offset[_INDEX[name]] = eps
        a[:5, column] = (slope(offset) - slope(-offset))[rows] / (2 * eps)
    zero = np.zeros(len(CONTINUOUS_STATES))
    b = np.zeros((6, 1))
    b[:5, 0] = (slope(zero, 1e-6) - slope(zero, -1e-6))[rows] / 2e-6
    a[5, 0] = 1.0 / lever  # joint speed per piston speed
    if held:  # factor: mass with the other joints free, over mass with the other joints held
        inertia, dof = inertia_matrix(simulation), simulation.dof_index[joint]
        a[0] *= 1.0 / (np.linalg.inv(inertia)[dof, dof] * inertia[dof, dof])
    return control.ss(a, b, np.eye(6)[5:], 0)


def native_plant(
    simulation: Simulation, joint: int, speed: float, *, held: bool = False
) -> "control.StateSpace":
    """Linearises one joint from a native actuator's command to joint position [rad or m].

    m q'' = lever half gain u - d q' - k q. The slopes d and k include the joint's inverse dynamics
    in the present pose, the actuator's force and a servo's internal loop; m is the inertia with the
    other joints free or held; a filter of the actuator adds a state. Dry friction, which has no
    slope, is neglected. The negative k of an unstable load is replaced by 0, because the load falls
    much more slowly than PD reacts.

    Args:
        simulation: The machine at rest; its pose is left unchanged.
        joint: Index of the joint.
        speed: Speed of the joint [rad/s or m/s].
        held: Whether the other joints are held; otherwise they are free.
    """
    import control  # takes a second, and most runs use stored gains

    drive = simulation.native[simulation.actuators[joint]]
    data = simulation.data
    lever = drive.lever(data)
    mass = free_inertia(simulation, drive.dof)
    if held:
        mass = float(inertia_matrix(simulation)[drive.dof, drive.dof])
    stiffness, damping = _slopes(simulation, drive, speed)
    per_length, per_velocity = drive.slopes(0.0)
    stiffness -= per_length * lever**2
    damping -= per_velocity * lever**2
    push = lever * drive.half * drive.gain(data) / mass
    a = np.array([[0.0, 1.0], [-max(stiffness, 0.0) / mass, -damping / mass]])
    b = np.array([[0.0], [push]])
    if drive.time_constant:
        rate = 1.0 / drive.time_constant
        a = np.block([[a, b], [np.zeros((1, 2)), np.array([[-rate]])]])
        b = np.array([[0.0], [0.0], [rate]])
    return control.ss(a, b, np.eye(len(a))[:1], 0)


def _slopes(simulation: Simulation, drive: NativeActuator, speed: float) -> tuple[float, float]:
    """Computes the slopes of a joint's load force over its position and velocity.

    By central differences of inverse dynamics without acceleration, contacts, joint limits and dry
    friction.
    """
    model, data = simulation.model, simulation.data
    place, dof = model.jnt_qposadr[drive.joint], drive.dof
    flags, pose, rates = model.opt.disableflags, data.qpos.copy(), data.qvel.copy()
    none = mujoco.mjtDisableBit
    model.opt.disableflags |= none.mjDSBL_CONTACT | none.mjDSBL_LIMIT | none.mjDSBL_FRICTIONLOSS

    def force(dq: float, dv: float) -> float:
        data.qpos[:], data.qvel[:] = pose, 0.0
        data.qpos[place] += dq
        data.qvel[dof] = speed + dv
        data.qacc[:] = 0.0
        mujoco.mj_inverse(model, data)
        return float(data.qfrc_inverse[dof])

    try:
        dq, dv = 1e-4, max(1e-3 * abs(speed), 1e-5)
        stiffness = (force(dq, 0.0) - force(-dq, 0.0)) / (2 * dq)
        damping = (force(0.0, dv) - force(0.0, -dv)) / (2 * dv)
    finally:
        model.opt.disableflags = flags
        data.qpos[:], data.qvel[:] = pose, rates
        mujoco.mj_forward(model, data)
    return stiffness, damping


def sampled_plant(
    plant: "control.StateSpace", period: float, latency: float
) -> "control.StateSpace":
    """Samples a plant behind a zero-order hold, measured `latency` <= period before the command.

    The command at t uses the output at t - latency, which follows from the state at t - period and
    the command sent then. The measured outputs are added to the states.
    """
    import control  # takes a second, and most runs use stored gains

    full = control.c2d(plant, period, "zoh")
    outputs, n = plant.C.shape
    # State (x, y_measured): y[k+1] = C (A_p x[k] + B_p u[k]).
    cp, dp = plant.C, np.zeros((outputs, full.B.shape[1]))
    if latency < period:
        part = control.c2d(plant, period - latency, "zoh")
        cp, dp = plant.C @ part.A, plant.C @ part.B
    a = np.block([[full.A, np.zeros((n, outputs))], [cp, np.zeros((outputs, outputs))]])
    b = np.vstack([full.B, dp])
    c = np.hstack([np.zeros((outputs, n)), np.eye(outputs)])
    return control.ss(a, b, c, 0, period)


def operating_poses(simulation: Simulation, joint: int) -> Iterator[None]:
    """Moves a machine at rest through the poses in which a joint is linearised, then back.

    The joint is at its present position, at a quarter and at three quarters of its range.
    """
    data, index = simulation.data, simulation.qpos_index[joint]
    home = data.qpos.copy()
    low, high = simulation.joint_range()[joint]
    for position in (home[index], low + 0.25 * (high - low), low + 0.75 * (high - low)):
        data.qpos[:], data.qvel[:] = home, 0.0
        data.qpos[index] = position
        mujoco.mj_forward(simulation.model, data)
        yield
    data.qpos[:] = home
    mujoco.mj_forward(simulation.model, data)


def sampled_plants(
    simulation: Simulation, joint: int, sensors: SensorConfiguration, *, held: bool = False
) -> list["control.StateSpace"]:
    """Computes the sampled linear plants of one joint for which gains are tuned.

    Args:
        simulation: The nominal machine at rest; its pose is restored.
        joint: Index of the joint.
        sensors: Control period and latency of the loop.
        held: Whether the other joints are held; otherwise they are free.

    Returns:
        One plant per pose and piston speed, from valve command to measured position [rad]; the
        command has the sign with which a positive value moves the joint forward.
    """
    plants = []
    for _ in operating_poses(simulation, joint):
        direction = float(drive_signs(simulation)[joint])
        plants += [
            sampled_plant(direction * plant, sensors.control_period, sensors.latency)
            for plant in _plants(simulation, joint, held=held)
        ]
    return plants


def _plants(
    simulation: Simulation, joint: int, *, held: bool = False
) -> Iterator["control.StateSpace"]:
    """Yields a joint's linear plants in the present pose at several speeds, without duplicates."""
    name = simulation.actuators[joint]
    if name in simulation.native:
        full = native_speed_limit(simulation, simulation.native[name])
        seen: list[np.ndarray] = []
        for share in NATIVE_SPEEDS:
            plant = native_plant(simulation, joint, share * full, held=held)
            if not any(np.allclose(plant.A, known, rtol=1e-4) for known in seen):
                seen.append(plant.A)
                yield plant
        return
    for speed in SPEEDS:
        try:
            yield joint_plant(simulation, joint, speed, held=held)
        except LeglabError:
            continue  # the cylinder cannot run at this speed under this load


def _most_gains(
    simulation: Simulation, joint: int, sensors: SensorConfiguration
) -> tuple[float, float]:
    """Returns the largest gains to try: command per position error and per velocity error.

    For a native actuator, whose command accelerates the joint by B, they are K_p = w^2/B and K_v =
    w/B. The crossover is then about w, where hold and latency alone cost 90 degrees of phase.
    """
    name = simulation.actuators[joint]
    if name not in simulation.native:
        return _MOST_POSITION, _MOST_VELOCITY
    drive = simulation.native[name]
    data = simulation.data
    push = abs(drive.lever(data) * drive.half * drive.gain(data))
    fastest = math.pi / 2 / (sensors.control_period / 2 + sensors.latency)
    per_push = free_inertia(simulation, drive.dof) / push
    return fastest**2 * per_push, fastest * per_push


def tune(simulation: Simulation, joint: int, *, sensors: SensorConfiguration) -> Row:
    """Finds the PD gains with the greatest K_p at which the margins are 6 dB and 45 degrees.

    The margins hold for the sampled loop with hold, latency and velocity filter, at every pose and
    piston speed. The greatest K_p is chosen because the error at constant speed falls with K_p.

    Args:
        simulation: The nominal machine at rest; its pose is restored.
        joint: Index of the joint.
        sensors: Control period, latency and velocity filter of the loop.

    Returns:
        `position` and `velocity`, valve command per position error [1/rad] and per velocity error
        [s/rad], with the least `gain_margin_db`, `phase_margin_deg` and `crossover` [rad/s] over
        the operating points.
    """
    most_position, most_velocity = _most_gains(simulation, joint, sensors)
    period = sensors.control_period
    frequencies = np.geomspace(0.05, math.pi / period * 0.999, 4000)
    z = np.exp(1j * frequencies * period)
    responses = [_response(plant, z) for plant in sampled_plants(simulation, joint, sensors)]
    alpha = velocity_filter_coefficient(period, sensors.velocity_cutoff)
    derivative = alpha * (1 - 1 / z) / period / (1 - (1 - alpha) / z)

    def margins(kp: float, kv: float) -> list[float]:
        law = kp + kv * derivative
        found = [stability_margins(plant * law, frequencies) for plant in responses]
        return np.min([(math.inf,) * 3, *found], axis=0).tolist()

    def stable(kp: float, kv: float) -> bool:
        gain, phase, _ = margins(kp, kv)
        return gain >= GAIN_MARGIN_DB and phase >= PHASE_MARGIN_DEG

    def greatest(kv: float) -> float:
        low, high = 0.0, most_position
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if stable(middle, kv) else (low, middle)
        return low

    best, kv = greatest(0.0), 0.0
    for tried in np.linspace(0.0, most_velocity, 41).tolist():
        # The bisection takes 40 times as long as the test whether it can find a greater K_p.
        if stable(best, tried) and (kp := greatest(tried)) > best:
            best, kv = kp, tried
    kp = _round_down(best)
    kv = _round_down(kv) if simulation.actuators[joint] in simulation.native else round(kv, 4)
    return dict(zip(PD.formats, (kp, kv, *margins(kp, kv)), strict=True))


def _response(plant: "control.StateSpace", z: np.ndarray) -> np.ndarray:
    """Computes C (z I - A)^-1 B + D; `plant(z)` does it point by point, 20 times as slowly."""
    states = np.linalg.solve(z[:, None, None] * np.eye(plant.nstates) - plant.A, plant.B)
    return (plant.C @ states + plant.D).ravel()


def stability_margins(
    loop: np.ndarray, frequencies: np.ndarray, *, stable: bool = False
) -> tuple[float, float, float]:
    """Computes gain margin [dB], phase margin [deg] and crossover [rad/s] of a frequency response.

    All crossings are evaluated, because a resonance may cross the unit circle several times.

    Args:
        loop: Response of the open loop at sampled frequencies.
        frequencies: The frequencies [rad/s].
        stable: Whether the closed loop is known to be stable. Then the gain margin is the least
            change of gain, up or down: with several integrators a lower gain may be unstable.
    """
    magnitude = np.abs(loop)
    sign_change = loop.imag[1:] * loop.imag[:-1] <= 0
    cross = np.flatnonzero(sign_change & (loop.real[1:] < 0))
    gain = math.inf
    if cross.size:
        levels = 20 * np.log10(np.maximum(magnitude[cross], magnitude[cross + 1]))
        gain = float(np.abs(levels).min() if stable else -levels.max())
    unity = np.flatnonzero((magnitude[1:] - 1) * (magnitude[:-1] - 1) <= 0)
    phase, crossover = math.inf, 0.0
    if unity.size:
        angle = np.degrees(np.angle(-loop[unity]))
        phase = float(np.abs(angle).min())
        crossover = float(frequencies[unity[0]])
    return gain, phase, crossover


def _round_down(value: float) -> float:
    """Rounds down to three significant digits, which the file's format `.4g` keeps exactly."""
    if value <= 0:
        return 0.0
    scale = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / scale) * scale:.3g}")


def tuned_tables(
    models: Sequence[str], progress: Callable[[int, int, str], None]
) -> dict[str, dict]:
    """Tunes models; returns tables of `PD` by model.

    Args:
        models: Names or paths of the models.
        progress: Function that is called before each joint with the number of joints done, the
            number of all joints, and a text that names model and joint.

    Raises:
        LeglabError: A model cannot be loaded.
    """
    machines = {model: Simulation(load_model(model)) for model in models}
    total, done = sum(len(machine.joints) for machine in machines.values()), 0
    found: dict[str, dict] = {}
    for model, machine in machines.items():
        sensors = in_whole_steps(SensorConfiguration(), machine.model.opt.timestep)
        rows = []
        for i, joint in enumerate(machine.joints):
            progress(done, total, f"tuning {model}, {joint}")
            done += 1
            machine.reset()
            rows.append(tune(machine, i, sensors=sensors))
        found[stored_name(model)] = PD.table(machine, sensors, rows)
    return found


def stored_gains(
    model: str, simulation: Simulation, sensors: SensorConfiguration
) -> list[tuple[float, float]] | None:
    """Returns the stored gains of a model; None if `PD` has none for this control loop."""
    rows = PD.rows(model, simulation, sensors)
    return None if rows is None else [(row["position"], row["velocity"]) for row in rows]


def tuned_gains(simulation: Simulation, sensors: SensorConfiguration) -> list[tuple[float, float]]:
    """Tunes all joints of a machine without stored gains; moves the machine."""
    result = []
    for joint in range(len(simulation.joints)):
        simulation.reset()
        gains = tune(simulation, joint, sensors=sensors)
        result.append((gains["position"], gains["velocity"]))
    return result
