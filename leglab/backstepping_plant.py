"""The linearised plant that `adaptive_backstepping` is tuned on, with the valve's inverse."""

from dataclasses import dataclass

import control
import mujoco
import numpy as np

from leglab.backstepping.cylinder import CylinderModel
from leglab.backstepping.data import NominalCylinders
from leglab.errors import LeglabError
from leglab.hydraulics import Cylinder
from leglab.nominal import inertia_matrix
from leglab.simulation import Simulation
from leglab.tuning import SPEEDS, joint_plant


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """The plant of one joint around a pose and a piston speed, sampled.

    Attributes:
        a: State matrix with the measurement's memory, (9, 9).
        b: Of the spool command, (9, 1).
        disturbance: Of a force on the piston against extension, in shares of the force at supply
            pressure, (9, 1).
        c: To piston position and both pressures, as measured, (3, 9).
        spool_per_speed: Of the inverted valve [s/m].
        spool_per_force: Change of spool per unit of phi [1/m], by the pressures at the valve.
        spool_per_sum: Change of spool with the measured pressures by their sum mode, (2,) [1/Pa].
    """

    a: np.ndarray
    b: np.ndarray
    disturbance: np.ndarray
    c: np.ndarray
    spool_per_speed: float
    spool_per_force: float
    spool_per_sum: np.ndarray


def operating_points(
    simulation: Simulation, joint: int, data: NominalCylinders, *, period: float, latency: float
) -> list[OperatingPoint]:
    """Linearises a joint where `leglab.tuning` does, with the other joints free and held.

    Args:
        simulation: The nominal machine in its rest pose; it is left there.
        joint: Index of the joint.
        data: The data of that joint alone.
        period: Control period [s].
        latency: Age of a measurement [s].
    """
    model, points = CylinderModel(data), []
    home = simulation.data.qpos.copy()
    index = simulation.qpos_index[joint]
    low, high = simulation.joint_range()[joint]
    for position in (home[index], low + 0.25 * (high - low), low + 0.75 * (high - low)):
        simulation.data.qpos[:], simulation.data.qvel[:] = home, 0.0
        simulation.data.qpos[index] = position
        mujoco.mj_forward(simulation.model, simulation.data)
        for speed in SPEEDS:
            for held in (False, True):
                try:
                    point = _point(simulation, joint, speed, held, model, period, latency)
                except LeglabError:
                    continue  # the cylinder cannot run at this speed under this load
                points.append(point)
    simulation.data.qpos[:] = home
    mujoco.mj_forward(simulation.model, simulation.data)
    return points


def _point(
    simulation: Simulation,
    joint: int,
    speed: float,
    held: bool,
    model: CylinderModel,
    period: float,
    latency: float,
) -> OperatingPoint:
    lever = float(simulation.levers()[joint])
    plant = joint_plant(simulation, joint, speed)
    if held:  # the mass with the other joints free, over that with them held
        plant.A[0] *= _mass_ratio(simulation, joint)
    # States: piston velocity, both pressures, spool and its velocity, joint position.
    c = np.zeros((3, 6))
    c[0, 5], c[1, 1], c[2, 2] = lever, 1.0, 1.0
    # Pressure A accelerates the piston by area/m: that tells the mass.
    push = np.zeros((6, 1))
    push[0] = -plant.A[0, 1] * model.data.supply_pressure
    plant = control.ss(plant.A, np.hstack([plant.B, push]), c, 0)
    full = control.c2d(plant, period, "zoh")
    part = control.c2d(plant, period - latency, "zoh")
    a = np.block([[full.A, np.zeros((6, 3))], [c @ part.A, np.zeros((3, 3))]])
    b = np.vstack([full.B, c @ part.B])

    values = simulation.cylinder_parameters(simulation.actuators[joint])
    values.update(coulomb=0.0, static=0.0, sigma_0=0.0, sigma_1=0.0)
    force = float(simulation.data.qfrc_bias[simulation.dof_index[joint]]) / lever
    steady = Cylinder(values).steady_state(speed, force)
    pressure = np.array([[steady.pressure_a], [steady.pressure_b]])
    supply = model.data.supply_pressure
    piston = model.geometry(simulation.position()[joint : joint + 1])[1]
    leakage = np.array([model.data.internal_leakage, [0.0], [0.0]])
    lap = model.data.lap

    def spool(change: np.ndarray | float = 0.0, faster: float = 0.0) -> float:
        shifted = pressure + change
        chambers = model.chambers(shifted, supply, piston)
        rate = model.rate_for(np.array([speed + faster]), shifted, leakage, chambers)
        return float(model.spool_for(rate, chambers, lap)[0])

    weight = model.chambers(pressure, supply, piston).weight
    area, stiffness = model.data.area, float((model.data.area * weight).sum())
    by_force = np.array([weight[0], -weight[1]])
    by_sum = area[::-1] / stiffness
    step = 1e-6  # m, of phi
    per_sum = np.zeros(2)
    scale = 1e3  # Pa
    for chamber in range(2):
        change = np.zeros((2, 1))
        change[chamber] = scale
        total = weight[::-1] * change
        pressures = by_sum * total.sum(axis=0)
        per_sum[chamber] = (spool(pressures) - spool(-pressures)) / (2 * scale)
    return OperatingPoint(
        a=a,
        b=b[:, :1],
        disturbance=b[:, 1:],
        c=np.hstack([np.zeros((3, 6)), np.eye(3)]),
        spool_per_speed=(spool(0.0, 1e-5) - spool(0.0, -1e-5)) / 2e-5,
        spool_per_force=(spool(step * by_force) - spool(-step * by_force)) / (2 * step),
        spool_per_sum=per_sum,
    )


def _mass_ratio(simulation: Simulation, joint: int) -> float:
    """Inertia of a joint with the others free, as a share of that with the others held."""
    inertia, dof = inertia_matrix(simulation), simulation.dof_index[joint]
    return float(1.0 / (np.linalg.inv(inertia)[dof, dof] * inertia[dof, dof]))
