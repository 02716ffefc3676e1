"""One cylinder moving a mass, run by the continuous model or by the plugin inside MuJoCo."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.integrate import solve_ivp

from leglab.machine import plugin
from leglab.machine.cylinder import CONTINUOUS_STATES, Cylinder

CYLINDER = {"bore": 0.016, "rod": 0.010, "stroke": 0.080}  # m, docs/reference/parameters.md
SUPPLY_PRESSURE = 16e6  # Pa
MASS = 20.0  # kg
MID_POSITION = 0.040  # m
HELD = 1e12  # kg: mass of a piston that no force moves
# Default of the cases: ideal valve, oil without air, no leakage, no friction.
IDEAL: Mapping[str, float] = {
    **CYLINDER,
    **dict.fromkeys(("lap", "edge_rounding", "entrained_air", "internal_leakage"), 0.0),
    **dict.fromkeys(("sigma_0", "sigma_1", "viscous", "coulomb", "static"), 0.0),
    **dict.fromkeys(("stop_stiffness", "stop_damping"), 0.0),
}


def constant(value: float) -> Callable[[float], float]:
    """Returns a constant command or load."""
    return lambda _: value


NOTHING = constant(0.0)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A cylinder with its initial state, command and load."""

    #: `leglab.cylinder` attributes except `mid_length`, SI units.
    parameters: Mapping[str, float] = field(default_factory=lambda: dict(IDEAL))
    mass: float = MASS  #: Moving mass [kg]
    position: float = MID_POSITION  #: Initial piston position [m]
    velocity: float = 0.0  #: Initial velocity [m/s]
    pressures: tuple[float, float] = (5e6, 5e6)  #: Initial pressures of cap and rod side [Pa]
    command: Callable[[float], float] = NOTHING  #: Valve command over time [s]
    ideal_spool: bool = True  #: The spool starts at the initial command; a constant one keeps it
    load: Callable[[float], float] = NOTHING  #: Force against extension [N] over time [s]
    duration: float  #: Duration [s]


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Motion, pressures and energies of an experiment; arrays of shape (n,), SI units."""

    time: np.ndarray  #: Times of the states
    lag: float = 0.0  #: Age of velocity and force at `time`: half a step in MuJoCo
    #: States by name in the continuous model, and `force`, of the piston on the mass.
    states: Mapping[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.states[name]


class Continuous:
    """The continuous model under scipy's stiff Radau solver."""

    def __str__(self) -> str:
        return "continuous"

    def run(self, experiment: Experiment) -> Trace:
        """Integrates in steps of at most a fiftieth of the duration."""
        e = experiment
        cylinder = Cylinder({"supply_pressure": SUPPLY_PRESSURE, **e.parameters})
        blocked = e.mass >= HELD and e.velocity == 0
        state = cylinder.initial_state(
            position=e.position,
            velocity=e.velocity,
            pressure_a=e.pressures[0],
            pressure_b=e.pressures[1],
            spool_position=e.command(0.0) if e.ideal_spool else 0.0,
        )
        scale = np.array([1e-3, 1e-2, 1e-3, 1e-1, 1e4, 1e4, 1e-6] + [1e-3] * 6)
        time = np.linspace(0.0, e.duration, 2001)

        def rate(t: float, y: np.ndarray) -> np.ndarray:
            return cylinder.derivative(
                y, command=e.command(t), mass=e.mass, load=e.load(t), blocked=blocked
            )

        solution = solve_ivp(
            rate,
            (0.0, e.duration),
            state,
            method="Radau",
            rtol=1e-9,
            atol=1e-9 * scale,
            t_eval=time,
            max_step=e.duration / 50,
        )
        states = dict(zip(CONTINUOUS_STATES, solution.y, strict=True))
        if blocked:
            pressures = states["pressure_a"], states["pressure_b"]
            force = cylinder.area_a * pressures[0] - cylinder.area_b * pressures[1]
        else:
            rows = zip(time, solution.y.T, strict=True)
            force = np.array([e.mass * rate(t, row)[1] + e.load(t) for t, row in rows])
        return Trace(time=time, states={**states, "force": force})


def slide_model(
    parameters: Mapping[str, float],
    mass: float,
    timestep: float,
    *,
    unit: Mapping[str, float] | None = None,
) -> mujoco.MjModel:
    """Builds a mass on a slide joint, moved by a `leglab.cylinder`; qpos is the piston position.

    Args:
        parameters: Attributes of the cylinder "valve".
        mass: Moving mass [kg].
        timestep: Time step [s].
        unit: Attributes of the `leglab.supply` "unit" that feeds it; constant pressure if None.
    """
    plugin.load_plugin()

    def config(values: Mapping[str, object]) -> str:
        return "".join(f'<config key="{k}" value="{v}"/>' for k, v in values.items())

    supply: dict[str, object] = {"supply_pressure": SUPPLY_PRESSURE}
    extension = ""
    if unit is not None:
        supply = {"supply": "unit"}
        instance = f'<instance name="unit">{config(unit)}</instance>'
        extension = f'<plugin plugin="leglab.supply">{instance}</plugin>'
    valve = config({**supply, **parameters, "mid_length": 0.5 * parameters["stroke"]})
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco>
        <option timestep="{timestep!r}" gravity="0 0 0" integrator="implicitfast"/>
        <extension><plugin plugin="leglab.cylinder"/>{extension}</extension>
        <worldbody>
          <body>
            <joint name="rod" type="slide" axis="1 0 0" ref="{MID_POSITION}"/>
            <inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/>
          </body>
        </worldbody>
        <actuator>
          <plugin name="valve" plugin="leglab.cylinder" joint="rod">{valve}</plugin>
        </actuator>
      </mujoco>""")


def places(model: mujoco.MjModel, element: str = "valve") -> dict[str, int]:
    """Returns the indices in `plugin_state` of a plugin instance's parameters and states."""
    start, table = plugin.elements(model)[element]
    return {n: start + table.entry(n).offset for n in (*table.parameters, *table.states)}


class Engine:
    """The plugin inside MuJoCo.

    Args:
        timestep: Time step [s].
    """

    def __init__(self, timestep: float) -> None:
        self.timestep = timestep

    def __str__(self) -> str:
        return f"MuJoCo {self.timestep * 1e3:g} ms"

    def run(self, experiment: Experiment) -> Trace:
        """Steps to the end of the experiment."""
        e, h = experiment, self.timestep
        model = slide_model(e.parameters, e.mass, h)
        data = mujoco.MjData(model)
        state, at = data.plugin_state, places(model)
        data.qpos[0], data.qvel[0] = e.position, e.velocity
        state[at["pressure_a"]], state[at["pressure_b"]] = e.pressures
        if e.ideal_spool:
            state[at["spool_position"]] = state[at["play_output"]] = e.command(0.0)
        names = ("pressure_a", "pressure_b", "spool_position", *CONTINUOUS_STATES[7:])
        columns = [at[name] for name in names]
        count = round(e.duration / h)
        rows = np.empty((count, 3 + len(columns)))
        for i in range(count):
            data.ctrl[0] = e.command(i * h)
            data.qfrc_applied[0] = -e.load(i * h)
            mujoco.mj_step(model, data)
            rows[i, :3] = data.qpos[0], data.qvel[0], data.actuator_force[0]
            rows[i, 3:] = state[columns]
        states = dict(zip(("position", "velocity", "force", *names), rows.T, strict=True))
        return Trace(time=h * np.arange(1, count + 1), lag=0.5 * h, states=states)


Solver = Continuous | Engine
ENGINES = (Engine(1e-3), Engine(0.5e-3))
SOLVERS: tuple[Solver, ...] = (Continuous(), *ENGINES)
