"""Forces and speeds that squat and stride need of the cylinders, and those that 160 bar gives.

`python docs/_tools/leg_authority.py` prints the tables of docs/concepts/leg_design.md. The weight
of leg and trunk share stands on the foot as a vertical force without friction; a stride is the
sagittal motion below at one stride a second with 60 % stance, the force rolling from heel to ball.
"""

import mujoco
import numpy as np
from leg_linkage import (
    JOINTS,
    SUPPLY_PRESSURE,
    cylinders,
    lever_rows,
    load_with_motors,
    print_tables,
)
from scipy.interpolate import CubicSpline

STANCE = 0.6  # of the stride
HEEL, BALL = -0.04, 0.12  # m before the ankle; the ball is at 73 % of the foot
# Knots (fraction of the stride, angle in rad): the course of adult walking with the knee to 1.05.
STRIDE = {
    "hip_yaw": ([0, 0.25, 0.5, 0.75], [0, 0.08, 0, -0.08]),
    "hip_roll": ([0, 0.25, 0.5, 0.75], [0, 0.06, 0, -0.04]),
    "hip_pitch": (
        [0, 0.15, 0.35, 0.5, 0.62, 0.75, 0.88],
        [0.42, 0.35, 0.05, -0.15, -0.02, 0.38, 0.48],
    ),
    "knee": (
        [0, 0.14, 0.35, 0.5, 0.6, 0.72, 0.85, 0.95],
        [0.08, 0.30, 0.12, 0.25, 0.65, 1.05, 0.55, 0.12],
    ),
    "ankle_pitch": (
        [0, 0.08, 0.25, 0.45, 0.6, 0.75, 0.9],
        [0, -0.08, 0.06, 0.16, -0.30, -0.02, 0.02],
    ),
    "ankle_roll": ([0, 0.25, 0.5, 0.75], [0, 0.05, 0, -0.04]),
}


def stride(phase: np.ndarray) -> np.ndarray:
    """Angle, speed and acceleration of the six joints, shape (3, len(phase), 6), rad and s."""
    splines = []
    for times, angles in STRIDE.values():
        knots = np.array([*times, 1.0]), np.array([*angles, angles[0]])
        splines.append(CubicSpline(*knots, bc_type="periodic"))
    motion = np.array([[spline(phase, order) for spline in splines] for order in range(3)])
    return motion.swapaxes(1, 2)


def torques(
    model: mujoco.MjModel, data: mujoco.MjData, motion: np.ndarray, force: float, ahead: float
) -> np.ndarray:
    """Joint torques, N m, shape (6,), that the cylinders must supply.

    Args:
        model: The leg with a fixed pelvis and native springs and dampers.
        data: Work space; holds the pose afterwards.
        motion: Angle, speed and acceleration, shape (3, 6).
        force: Vertical ground force on the foot, N.
        ahead: Where it acts, m before the ankle, at the height of the sole.
    """
    data.qpos[:], data.qvel[:], data.qacc[:] = motion
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_inverse(model, data)
    point = data.body("ankle_cross").xpos + np.array([ahead, 0.0, -0.08])
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, point, model.body("foot").id)
    return data.qfrc_inverse - jacobian.T @ [0.0, 0.0, force]


def force_margins(needed: np.ndarray) -> np.ndarray:
    """Stall force at 160 bar over the needed force, N, shape (6,)."""
    sizes = cylinders()
    limits = [sizes[j].areas[0 if f > 0 else 1] for j, f in zip(JOINTS, needed, strict=True)]
    with np.errstate(divide="ignore"):
        return SUPPLY_PRESSURE * np.array(limits) / abs(needed)


def squat(model: mujoco.MjModel, ahead: float) -> tuple[np.ndarray, np.ndarray]:
    """Torques, N m, and force margins of holding the keyframe `squat` on this leg alone."""
    data = mujoco.MjData(model)
    motion = np.zeros((3, 6))
    motion[0] = model.key("squat").qpos
    tau = torques(model, data, motion, 9.81 * model.body_mass.sum(), ahead)
    return tau, force_margins(tau / np.diag(lever_rows(model, data)))


def walk(model: mujoco.MjModel, samples: int = 1000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A stride in one second, cylinder friction included.

    Returns:
        Torques, N m, shape (samples, 6); the least force and speed margins, shape (2, 6); the
        flow from the supply, m^3/s, shape (samples,).
    """
    data, sizes = mujoco.MjData(model), cylinders()
    phase = np.linspace(0.0, 1.0, samples, endpoint=False)
    tau: list[np.ndarray] = []
    flow: list[float] = []
    margins: list[list[np.ndarray]] = []
    for p, motion in zip(phase, stride(phase).swapaxes(0, 1), strict=True):
        # The weight comes and goes within a tenth of the stance.
        share = np.clip(min(p, STANCE - p) / (0.1 * STANCE), 0.0, 1.0)
        ahead = HEEL + (BALL - HEEL) * min(p / STANCE, 1.0)
        tau.append(torques(model, data, motion, 9.81 * model.body_mass.sum() * share, ahead))
        lever = np.diag(lever_rows(model, data))
        speed, needed = lever * motion[1], tau[-1] / lever
        reserve, used = np.zeros(6), 0.0
        for i, j in enumerate(JOINTS):
            way = 1 if speed[i] > 0 else -1
            needed[i] += sizes[j].viscous * speed[i] + way * sizes[j].coulomb
            reserve[i] = sizes[j].speed(way * needed[i], way) / max(abs(speed[i]), 1e-9)
            used += sizes[j].areas[0 if way > 0 else 1] * abs(speed[i])
        margins.append([force_margins(needed), reserve])
        flow.append(used)
    return np.array(tau), np.min(margins, 0), np.array(flow)


def squat_table() -> list[str]:
    """Torques of the squat and margins as Markdown."""
    model = load_with_motors("leg_motor")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("squat").id)
    mujoco.mj_forward(model, data)
    under_hip = data.body("thigh").xpos[0] - data.body("ankle_cross").xpos[0]
    lines = ["| force acts, m before the ankle | N m | least margin |", "|---|---|---|"]
    for ahead in (under_hip, 0.0, 0.05, 0.12):
        tau, margin = squat(model, ahead)
        torques = ", ".join(f"{value:.0f}" for value in tau[2:5])
        place = f"{ahead:.3f}" + (" (under the hip)" if ahead == under_hip else "")
        lines.append(f"| {place} | {torques} | {margin.min():.2f} |")
    return lines


def stride_table() -> list[str]:
    """Torques and speeds of the stride, margins and supply flow as Markdown."""
    tau, margin, flow = walk(load_with_motors("leg_motor"))
    lines = ["| joint | torque, N m | peak rad/s | force margin | speed margin |", "|---" * 5 + "|"]
    peak = abs(stride(np.linspace(0, 1, 1000))[1]).max(0)
    for i, j in enumerate(JOINTS):
        row = [j, f"{tau[:, i].min():.0f} to {tau[:, i].max():.0f}", f"{peak[i]:.1f}"]
        lines.append(f"| {' | '.join([*row, *(f'{m:.2f}' for m in margin[:, i])])} |")
    mean, most = 6e4 * flow.mean(), 6e4 * flow.max()
    lines += ["", f"Flow of the cylinders: {mean:.1f} l/min on average, {most:.1f} at the peak."]
    return lines


if __name__ == "__main__":
    print_tables({"squat": squat_table, "stride": stride_table})
