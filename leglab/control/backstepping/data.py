"""Data sheets of the nominal cylinders, and the gains that the feedback is designed from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

# Joint torques [N m] for positions [rad], velocities [rad/s] and accelerations [rad/s^2].
InverseDynamics = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class NominalCylinders:
    """Data sheets and geometry of all cylinders, in the order of the joints.

    Attributes:
        area: Piston area on the cap (A) and on the rod (B) side [m^2], (2, joints).
        dead_volume: Of A with the piston retracted, of B with it extended [m^3], (2, joints).
        stroke: [m], (joints,).
        orifice_gain: K of one metering edge [m^3/s/sqrt(Pa)], (joints,).
        laminar_transition_pressure: [Pa], (joints,).
        lap: Overlap of each edge, of full spool travel, (joints,).
        edge_rounding: eps of an edge, of full spool travel, (joints,).
        valve_frequency: Natural frequency of the spool [rad/s], (joints,).
        valve_damping: Damping ratio of the spool, (joints,).
        supply_pressure: [Pa], (joints,).
        tank_pressure: [Pa], (joints,).
        bulk_modulus: Of the air-free oil [Pa], (joints,).
        entrained_air: Volume fraction at atmospheric pressure, (joints,).
        polytropic_index: Of the air, (joints,).
        internal_leakage: [m^3/s/Pa], (joints,).
        viscous: Friction of the seals [N s/m], (joints,).
        coulomb: Friction of the seals [N], (joints,).
        static: Breakaway friction of the seals [N], (joints,).
        stribeck_velocity: [m/s], (joints,).
        sigma_0: Stiffness of the bristles [N/m], (joints,).
        mass: Moved by the piston in the rest pose while all other joints are free [kg], (joints,).
        position: Joint positions of the tables [rad], evenly spaced, (joints, p).
        lever: Piston speed per joint speed there [m/rad], (joints, p).
        piston: Piston position there [m], (joints, p).
    """

    area: np.ndarray
    dead_volume: np.ndarray
    stroke: np.ndarray
    orifice_gain: np.ndarray
    laminar_transition_pressure: np.ndarray
    lap: np.ndarray
    edge_rounding: np.ndarray
    valve_frequency: np.ndarray
    valve_damping: np.ndarray
    supply_pressure: np.ndarray
    tank_pressure: np.ndarray
    bulk_modulus: np.ndarray
    entrained_air: np.ndarray
    polytropic_index: np.ndarray
    internal_leakage: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    static: np.ndarray
    stribeck_velocity: np.ndarray
    sigma_0: np.ndarray
    mass: np.ndarray
    position: np.ndarray
    lever: np.ndarray
    piston: np.ndarray

    def joints(self, indices: Sequence[int] | np.ndarray) -> "NominalCylinders":
        """The data of some joints, in this order, perhaps several times."""
        tables = ("position", "lever", "piston")
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return NominalCylinders(
            **{n: v.take(indices, axis=0 if n in tables else -1) for n, v in values.items()}
        )


# Corner frequency of the filter of the chambers' common pressure [rad/s].
PRESSURE_CUTOFF = 150.0
# Of the filter of the unknown force on its way into the expected pressures [rad/s]. A fast one
# would compensate a worn seal's leakage so promptly that its damping is gone, and a bit late: at
# 50 rad/s hip yaw and hip roll of the walking leg oscillate when all leakages have grown tenfold.
FORCE_CUTOFF = 5.0


@dataclass(frozen=True, kw_only=True)
class BacksteppingGains:
    """Gains that `Feedback` is designed from; one value a joint, (joints,) each.

    Attributes:
        position_gain: k_1, rate at which the position error decays [1/s].
        force_damping: Damping ratio wanted of the oil spring beyond its own.
        force_drift: Random walk of the unknown force, in forces of the piston at supply pressure
            [1/sqrt(s)].
        flow_drift: Random walk of the unknown flow, in flows at the no-load speed [1/sqrt(s)].
    """

    position_gain: np.ndarray
    force_damping: np.ndarray
    force_drift: np.ndarray
    flow_drift: np.ndarray
