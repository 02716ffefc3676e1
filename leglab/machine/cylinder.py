"""One valve-controlled cylinder outside MuJoCo: continuous model, plugin scheme, steady states."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leglab._native import hydraulics as _native
from leglab.base.errors import ModelError
from leglab.machine.parameters import parameter_vector, refused

# Order of the continuous state; the energies are integrals since the start [J].
CONTINUOUS_STATES = (
    "position",
    "velocity",
    "spool_position",
    "spool_velocity",
    "pressure_a",
    "pressure_b",
    "bristle",
    "energy_supply",
    "energy_valve",
    "energy_leakage",
    "energy_friction",
    "energy_stored",
    "energy_load",
)


@dataclass(frozen=True, kw_only=True)
class SteadyState:
    """Valve and pressures at a steady piston speed."""

    spool: float  #: Relative spool position, in [-1, 1]
    pressure_a: float  #: Cap side [Pa]
    pressure_b: float  #: Rod side [Pa]


class Cylinder:
    """The plugin's cylinder, defined by its `leglab.cylinder` attributes in SI units.

    Args:
        parameters: Values of attributes that differ from the nominal ones; `bore`, `rod` and
            `stroke` are required, `mid_length` has no effect.

    Raises:
        LeglabError: If a name is unknown, a value is out of bounds or contradicts another, or a
            required one is missing.
    """

    def __init__(self, parameters: Mapping[str, float]) -> None:
        values = {"mid_length": 0.0, **parameters}
        self.vector = parameter_vector("leglab.cylinder", values)
        try:
            self.native = _native.CylinderModel(self.vector)
        except ValueError as error:
            raise refused("leglab.cylinder", str(error)) from None
        self.supply_pressure = values.get("supply_pressure", 16e6)
        self.area_a, self.area_b = self.native.areas()

    def derivative(
        self,
        state: np.ndarray,
        *,
        command: float,
        mass: float = 1.0,
        load: float = 0.0,
        blocked: bool = False,
    ) -> np.ndarray:
        """Returns the time derivative of the continuous state, (13,), order `CONTINUOUS_STATES`.

        Args:
            state: Continuous state, shape (13,).
            command: Valve command in [-1, 1].
            mass: Moving mass [kg].
            load: Force against extension [N].
            blocked: Whether the piston is locked in place.
        """
        out = np.empty(len(CONTINUOUS_STATES))
        state = np.ascontiguousarray(state, dtype=float)
        inputs = command, self.supply_pressure, mass, load, blocked
        self.native.derivative(state, *inputs, out)
        return out

    def initial_state(self, **values: float) -> np.ndarray:
        """Returns a continuous state, shape (13,), zero except for the named entries."""
        state = np.zeros(len(CONTINUOUS_STATES))
        for name, value in values.items():
            state[CONTINUOUS_STATES.index(name)] = value
        return state

    def simulate(
        self,
        commands: np.ndarray,
        timestep: float,
        *,
        mass: float,
        load: float = 0.0,
        position: float,
        velocity: float = 0.0,
        pressure_a: float,
        pressure_b: float,
    ) -> np.ndarray:
        """Runs the plugin's fixed-step scheme on a free mass.

        Args:
            commands: Valve commands held over each step, shape (n,).
            timestep: Seconds.
            mass: Moving mass [kg].
            load: Force against extension [N].
            position: Initial piston position [m].
            velocity: Initial velocity [m/s].
            pressure_a: Initial cap-side pressure [Pa].
            pressure_b: Initial rod-side pressure [Pa].

        Returns:
            Position, velocity, pressure A, pressure B, spool, bristle after each step, (n, 6).
        """
        commands = np.ascontiguousarray(commands, dtype=float)
        out = np.empty((len(commands), 6))
        start = position, velocity, pressure_a, pressure_b
        self.native.simulate(commands, timestep, self.supply_pressure, mass, load, *start, out)
        return out

    def steady_state(self, velocity: float, force: float) -> SteadyState:
        """Computes spool position and pressures for a constant piston speed against a load.

        Solves Q_A = A_A v, Q_B = -A_B v and p_A A_A - p_B A_B = force + friction(v).

        Args:
            velocity: Piston speed, extension positive [m/s].
            force: Force of the piston on the mechanism [N].

        Raises:
            LeglabError: If no valve opening gives that speed; the message names speed and force.
        """
        from scipy.optimize import brentq, root  # slow to import, and seldom needed

        ps, native = self.supply_pressure, self.native

        def balance(spool: float, start: np.ndarray) -> tuple[np.ndarray, float]:
            def residual(p: np.ndarray) -> list[float]:
                a, b, _ = native.flows(spool, ps, p[0] * ps, p[1] * ps)
                return [1e4 * (a - self.area_a * velocity), 1e4 * (b + self.area_b * velocity)]

            result = root(residual, start, tol=1e-13)
            pa, pb = result.x * ps
            wanted = force + native.steady_friction(velocity, pa, pb)
            return result.x, (pa * self.area_a - pb * self.area_b - wanted) / (ps * self.area_a)

        guess = np.array([0.4, 0.6])
        low, high = -1.0, 1.0
        # If the flow is too small the pressures diverge, but the force residual has the right sign.
        if balance(low, guess)[1] > 0 or balance(high, guess)[1] < 0:
            raise ModelError(
                f"no steady state at {velocity:g} m/s and {force:g} N: the valve is too small "
                f"or the supply pressure {ps / 1e5:.0f} bar too low",
                given=(velocity, force),
            )
        spool = brentq(lambda s: balance(s, guess)[1], low, high, xtol=1e-9)
        pressures = balance(spool, guess)[0] * ps
        return SteadyState(spool=spool, pressure_a=pressures[0], pressure_b=pressures[1])
