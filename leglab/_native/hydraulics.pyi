"""Types of the compiled hydraulics core."""

import numpy as np

def parameter_tables() -> dict[
    str,
    tuple[
        list[tuple[str, str, float, float, float, bool, str]], list[tuple[str, str, str]], list[str]
    ],
]: ...
def unit_at_slide(unit: str) -> str: ...
def sliding_friction(
    plugin: str,
    parameters: np.ndarray,
    velocity: np.ndarray,
    carried: np.ndarray,
    time: np.ndarray,
    out: np.ndarray,
) -> None: ...
def bristle(
    velocity: np.ndarray, level: np.ndarray, sigma_0: float, timestep: float, out: np.ndarray
) -> None: ...
def play(samples: np.ndarray, width: float, out: np.ndarray) -> None: ...
def spool(
    command: np.ndarray, frequency: float, damping: float, timestep: float, out: np.ndarray
) -> None: ...
def supply_pressure(
    supply: np.ndarray,
    parameters: np.ndarray,
    spools: np.ndarray,
    caps: np.ndarray,
    rods: np.ndarray,
    timestep: float,
    substeps: int,
    out: np.ndarray,
) -> None: ...

class CylinderModel:
    def __init__(self, parameters: np.ndarray) -> None: ...
    def derivative(
        self,
        state: np.ndarray,
        command: float,
        supply_pressure: float,
        mass: float,
        load: float,
        blocked: bool,
        out: np.ndarray,
    ) -> None: ...
    def simulate(
        self,
        commands: np.ndarray,
        timestep: float,
        supply_pressure: float,
        mass: float,
        load: float,
        x0: float,
        v0: float,
        pa0: float,
        pb0: float,
        out: np.ndarray,
    ) -> None: ...
    def flows(
        self, spool: float, supply_pressure: float, pa: float, pb: float
    ) -> tuple[float, float, float]: ...
    def areas(self) -> tuple[float, float]: ...
    def volumes(self, x: float) -> tuple[float, float]: ...
    def bulk_modulus(self, gauge: float) -> float: ...
    def relative_volume(self, gauge: float) -> float: ...
    def pressure_at(self, relative_volume: float, guess: float) -> float: ...
    def kinematic_viscosity(self, celsius: float) -> float: ...
    def condition(self) -> tuple[float, float, float, float]: ...
    def steady_friction(self, v: float, pa: float, pb: float) -> float: ...
