"""Data sheets of the nominal cylinders, and design parameters of the feedback."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

# Function of joint positions [rad], velocities [rad/s], accelerations [rad/s^2] to torques [N m].
InverseDynamics = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class NominalCylinders:
    """Data sheets and geometry of all cylinders, in the order of the joints."""

    area: np.ndarray  #: Piston area on the cap (A) and on the rod (B) side [m^2], (2, joints)
    #: Volume of A with the piston fully retracted, of B fully extended [m^3], (2, joints).
    dead_volume: np.ndarray
    stroke: np.ndarray  #: [m], (joints,)
    orifice_gain: np.ndarray  #: K of one metering edge [m^3/s/sqrt(Pa)], (joints,)
    laminar_transition_pressure: np.ndarray  #: [Pa], (joints,)
    lap: np.ndarray  #: Overlap of each edge, as a share of full spool travel, (joints,)
    edge_rounding: np.ndarray  #: eps of each edge, as a share of full spool travel, (joints,)
    valve_frequency: np.ndarray  #: Natural frequency of the spool [rad/s], (joints,)
    valve_damping: np.ndarray  #: Damping ratio of the spool, (joints,)
    supply_pressure: np.ndarray  #: [Pa], (joints,)
    tank_pressure: np.ndarray  #: [Pa], (joints,)
    bulk_modulus: np.ndarray  #: Bulk modulus of the air-free oil [Pa], (joints,)
    entrained_air: np.ndarray  #: Volume fraction of air at atmospheric pressure, (joints,)
    polytropic_index: np.ndarray  #: Polytropic index of the air, (joints,)
    internal_leakage: np.ndarray  #: [m^3/s/Pa], (joints,)
    viscous: np.ndarray  #: Viscous friction of the seals [N s/m], (joints,)
    coulomb: np.ndarray  #: Coulomb friction of the seals [N], (joints,)
    static: np.ndarray  #: Breakaway friction of the seals [N], (joints,)
    stribeck_velocity: np.ndarray  #: [m/s], (joints,)
    sigma_0: np.ndarray  #: Stiffness of the bristles [N/m], (joints,)
    #: Effective mass at the piston in the rest pose with all other joints free [kg], (joints,).
    mass: np.ndarray
    position: np.ndarray  #: Joint positions of the tables [rad], evenly spaced, (joints, p)
    lever: np.ndarray  #: Piston speed per joint speed at `position` [m/rad], (joints, p)
    piston: np.ndarray  #: Piston position at `position` [m], (joints, p)

    def joints(self, indices: Sequence[int] | np.ndarray) -> "NominalCylinders":
        """Returns the data of the joints at `indices`, which may repeat, in that order."""
        tables = ("position", "lever", "piston")
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return NominalCylinders(
            **{n: v.take(indices, axis=0 if n in tables else -1) for n, v in values.items()}
        )


# Corner frequency of the low-pass filter of the measured chamber pressures [rad/s].
PRESSURE_CUTOFF = 150.0
# Corner frequency of the low-pass filter of the unknown force from which the expected pressures are
# computed [rad/s]. A fast filter would cancel the damping by a worn seal's leakage with a delay: at
# 50 rad/s hip yaw and roll oscillate in walking with tenfold leakage.
FORCE_CUTOFF = 5.0


@dataclass(frozen=True, kw_only=True)
class BacksteppingGains:
    """Design parameters of `Feedback`, one value per joint, (joints,) each."""

    position_gain: np.ndarray  #: k_1, rate at which the position error decays [1/s]
    force_damping: np.ndarray  #: zeta, damping ratio that the feedback gives to the oil spring
    #: Random walk of the unknown force, over the piston's force at supply pressure [1/sqrt(s)].
    force_drift: np.ndarray
    #: Random walk of the unknown flow, over the flow at no-load speed [1/sqrt(s)].
    flow_drift: np.ndarray
