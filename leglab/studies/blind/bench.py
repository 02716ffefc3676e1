"""The nominal bench of the blind tests, and what is normal between good machines."""

from collections.abc import Mapping

import mujoco

import leglab.models
from leglab.machine import plugin
from leglab.studies.blind.plant import TIMESTEP

VALVE, SPRING = "knee_valve", "knee_spring"


def bench(pump: Mapping[str, float] | None = None) -> mujoco.MjModel:
    """The nominal bench with the fine step; where given, on a pump unit of these parameters."""
    plugin.load()
    spec = mujoco.MjSpec.from_file(f"{leglab.models.__path__[0]}/knee_bench.xml")
    spec.option.timestep = TIMESTEP
    spec.compiler.discardvisual = True
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    if pump is not None:
        spec.activate_plugin("leglab.supply")
        unit = spec.add_plugin(name="pump", plugin_name="leglab.supply")
        unit.config = {key: repr(value) for key, value in pump.items()}
        valve = spec.actuator(VALVE).plugin
        valve.config = {**valve.config, "supply": "pump"}
    return spec.compile()


# Nominal values that the faults start from, spec/knee_bench.toml.
NOMINAL = {
    "internal_leakage": 1.7e-13,
    "entrained_air": 0.005,
    "supply_pressure": 16e6,
    "lap": 0.02,
    "null_bias": 0.0,
    "rated_flow": 1.25e-4,
    "flow_asymmetry": 0.0,
    "hysteresis": 0.0,
    "bandwidth_hz": 250.0,
    "viscous": 700.0,
    "coulomb": 100.0,
    "static": 150.0,
    "pressure_coefficient": 0.0,
    "oil_temperature": 40.0,
    "k1": 25.0,
    "k2": 60.0,
    "rest_position": 0.9,
    "d1": 0.6,
    "quadratic_damping": 0.0,
}
# Spread of good machines: standard deviations, of the nominal value.
TOLERANCES = {
    "internal_leakage": 0.15,
    "entrained_air": 0.2,
    "supply_pressure": 0.01,
    "rated_flow": 0.02,
    "viscous": 0.06,
    "coulomb": 0.06,
    "k1": 0.025,
    "k2": 0.05,
}
NULL_SHIFT = 0.002  # standard deviation of the valve's null, of full command
