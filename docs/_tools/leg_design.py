"""Cylinders of the leg: linkages and effective masses, and what squat and stride need of them.

`python docs/_tools/leg_design.py` prints the tables of docs/concepts/leg_design.md. The weight
of leg and trunk share stands on the foot as a vertical force without friction; a stride is the
sagittal motion below at one stride a second with 60 % stance, the force rolling from heel to ball.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

FOLDER = Path(__file__).parents[2] / "models"
REPLACED = {
    "parts/cylinders.xml": "parts/motors.xml",
    "parts/springs_hydraulic.xml": "parts/springs_native.xml",
}
JOINTS = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
BULK_MODULUS = 1.4e9  # Pa, oil without air, the stiffest case
SUPPLY_PRESSURE = 16e6  # Pa
RATED_PRESSURE_DROP = 7e6  # Pa over both edges
# Angles, rad, that walking and squatting stay in; joints in the order of JOINTS.
USUAL = np.array([(-0.3, 0.3), (-0.15, 0.3), (-0.3, 1.2), (0.05, 1.6), (-0.35, 0.5), (-0.2, 0.2)])
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


def load_with_motors(name: str) -> mujoco.MjModel:
    """Compiles `models/NAME.xml` after replacing the plugin parts by the native ones, in memory.

    Args:
        name: Model name without the suffix, for instance "leg_rail".

    Returns:
        The compiled model: same bodies, joints, sites and tendons, motors named `<joint>_valve`.
    """
    text = (FOLDER / f"{name}.xml").read_text()
    for hydraulic, native in REPLACED.items():
        text = text.replace(hydraulic, native)
    files = [*FOLDER.glob("parts/*.xml"), *FOLDER.glob("meshes/*.obj")]
    assets = {path.relative_to(FOLDER).as_posix(): path.read_bytes() for path in files}
    return mujoco.MjModel.from_xml_string(text, assets)


@dataclass(frozen=True, kw_only=True)
class CylinderSize:
    """Geometry, valve and friction of one cylinder.

    Attributes:
        bore: Piston diameter, m.
        rod: Rod diameter, m.
        stroke: Travel, m.
        mid_length: Distance of the pins at half stroke, m.
        dead_volume_a: Cap side volume at x = 0 with its hose, m^3.
        dead_volume_b: Rod side volume at x = stroke with its hose, m^3.
        rated_flow: Of the valve at 7 MPa over both edges, m^3/s.
        viscous: Viscous friction, N s/m.
        coulomb: Coulomb friction, N.
        sigma_0: Bristle stiffness, N/m.
    """

    bore: float
    rod: float
    stroke: float
    mid_length: float
    dead_volume_a: float
    dead_volume_b: float
    rated_flow: float
    viscous: float
    coulomb: float
    sigma_0: float

    @property
    def areas(self) -> tuple[float, float]:
        """Piston and annulus area, m^2."""
        piston = np.pi / 4 * self.bore**2
        return piston, piston - np.pi / 4 * self.rod**2

    def position(self, length: float) -> float:
        """Piston position from the cap end, m, at a distance of the pins, m."""
        return self.stroke / 2 + length - self.mid_length

    def stiffness(self, length: float) -> float:
        """Stiffness of the locked oil, N/m: beta (A_A^2 / V_A + A_B^2 / V_B)."""
        (piston, annulus), x = self.areas, self.position(length)
        cap = piston**2 / (self.dead_volume_a + piston * x)
        ring = annulus**2 / (self.dead_volume_b + annulus * (self.stroke - x))
        return BULK_MODULUS * (cap + ring)

    def speed(self, load: float, direction: int) -> float:
        """Steady speed, m/s, with a fully open ideal valve against a load, N, that opposes it."""
        piston, annulus = self.areas
        area = piston if direction > 0 else annulus
        gain = self.rated_flow / np.sqrt(RATED_PRESSURE_DROP / 2)
        drop = max(area * SUPPLY_PRESSURE - load, 0.0)
        return float(gain * np.sqrt(drop / (piston**3 + annulus**3)))


def cylinders() -> dict[str, CylinderSize]:
    """Reads parts/cylinders.xml; the keys are the joints."""
    found = {}
    for plugin in ElementTree.parse(FOLDER / "parts" / "cylinders.xml").iterfind("actuator/plugin"):
        value = {str(c.get("key")): str(c.get("value")) for c in plugin.iterfind("config")}
        fields = {name: float(value[name]) for name in CylinderSize.__dataclass_fields__}
        found[str(plugin.get("name")).removesuffix("_valve")] = CylinderSize(**fields)
    return found


def place(model: mujoco.MjModel, data: mujoco.MjData, angles: np.ndarray) -> None:
    """Sets the six leg angles, rad, and computes positions, tendons and the mass matrix."""
    for joint, angle in zip(JOINTS, angles, strict=True):
        data.joint(joint).qpos[0] = angle
    mujoco.mj_fwdPosition(model, data)


def lever_rows(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Jacobian of the six cylinder lengths, m/rad, shape (6, nv)."""
    jacobian = np.zeros((model.ntendon, model.nv))
    mujoco.mju_sparse2dense(
        jacobian, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
    )
    return np.ascontiguousarray(jacobian[[model.tendon(f"{j}_cylinder").id for j in JOINTS]])


def inverse_mass(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """J M^-1 J^T of the six cylinders, 1/kg, shape (6, 6)."""
    levers = lever_rows(model, data)
    solved = np.zeros_like(levers)
    mujoco.mj_solveM(model, data, solved, levers)
    return levers @ solved.T


def sample_poses(box: np.ndarray, count: int) -> np.ndarray:
    """All 64 corners of a box of angles, shape (6, 2), and uniform samples inside."""
    corners = np.array(np.meshgrid(*box, indexing="ij")).reshape(6, -1).T
    inside = np.random.default_rng(7).uniform(box[:, 0], box[:, 1], (count, 6))
    return np.vstack([corners, inside])


def resonance(model: mujoco.MjModel, box: np.ndarray, count: int = 2000) -> tuple[np.ndarray, ...]:
    """Largest w_h h over a box of angles.

    Returns:
        Of each cylinder alone; the same with the friction bristles stuck; both of shape (6,).
        Then of the fastest mode with all six cylinders locked, shape ().
    """
    data, sizes = mujoco.MjData(model), cylinders()
    alone, stuck, coupled = np.zeros(6), np.zeros(6), 0.0
    bristle = np.array([sizes[j].sigma_0 for j in JOINTS])
    for angles in sample_poses(box, count):
        place(model, data, angles)
        inverse = inverse_mass(model, data)
        lengths = [data.tendon(f"{j}_cylinder").length[0] for j in JOINTS]
        stiffness = np.array([sizes[j].stiffness(x) for j, x in zip(JOINTS, lengths, strict=True)])
        root = np.sqrt(stiffness)
        alone = np.maximum(alone, stiffness * np.diag(inverse))
        stuck = np.maximum(stuck, (stiffness + bristle) * np.diag(inverse))
        coupled = max(coupled, np.linalg.eigvalsh(root[:, None] * inverse * root)[-1])
    step = model.opt.timestep
    return np.sqrt(alone) * step, np.sqrt(stuck) * step, np.sqrt(coupled) * step


def _travel() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ranges [rad], (6, 2); shortest and longest levers, first and last pistons [m], (2, 6)."""
    model, sizes = load_with_motors("leg"), cylinders()
    data = mujoco.MjData(model)
    ranges = np.array([model.joint(j).range for j in JOINTS])
    levers, positions = [], []
    for fraction in np.linspace(0.0, 1.0, 201):
        place(model, data, ranges[:, 0] + fraction * (ranges[:, 1] - ranges[:, 0]))
        levers.append(np.abs(np.diag(lever_rows(model, data))))
        lengths = [data.tendon(f"{j}_cylinder").length[0] for j in JOINTS]
        positions.append([sizes[j].position(x) for j, x in zip(JOINTS, lengths, strict=True)])
    rows = [np.min(levers, 0), np.max(levers, 0), np.min(positions, 0), np.max(positions, 0)]
    return ranges, np.array(rows[:2]), np.array(rows[2:])


def lever_table() -> list[str]:
    """Ranges, levers and piston positions as Markdown."""
    ranges, (short, long), (first, last) = _travel()
    sizes = cylinders()
    lines = ["| joint | range, rad | lever, mm (shortest, longest) | piston, mm of stroke |"]
    lines.append("|---|---|---|---|")
    for i, j in enumerate(JOINTS):
        row = [j, f"{ranges[i, 0]:g} to {ranges[i, 1]:g}"]
        row.append(f"{1e3 * short[i]:.1f}, {1e3 * long[i]:.1f}")
        stroke = 1e3 * sizes[j].stroke
        row.append(f"{1e3 * first[i]:.1f} to {1e3 * last[i]:.1f} of {stroke:.0f}")
        lines.append(f"| {' | '.join(row)} |")
    return lines


def limit_table() -> list[str]:
    """Forces, torques and speeds as Markdown."""
    _, (short, long), _ = _travel()
    sizes = cylinders()
    head = ("joint", "push, pull, N", "N m at longest lever", "at shortest")
    lines = [f"| {' | '.join(head)} | no-load rad/s, longest |", "|---|---|---|---|---|"]
    for i, j in enumerate(JOINTS):
        push, pull = (SUPPLY_PRESSURE * area for area in sizes[j].areas)
        row = [j, f"{push:.0f}, {pull:.0f}"]
        row += [f"{push * arm:.0f}, {pull * arm:.0f}" for arm in (long[i], short[i])]
        row.append(", ".join(f"{sizes[j].speed(0, way) / long[i]:.1f}" for way in (1, -1)))
        lines.append(f"| {' | '.join(row)} |")
    return lines


def resonance_table() -> list[str]:
    """Largest w_h h of every cylinder as Markdown, and with stuck bristles below."""
    ranges = _travel()[0]
    short = ("yaw", "roll", "pitch", "knee", "ankle pitch", "ankle roll")
    lines = [f"| model, range | {' | '.join(short)} | all six |", "|---|" + "---|" * 7]
    worst, where = 0.0, ""
    for name in ("leg", "leg_rail"):
        variant = load_with_motors(name)
        for label, box in (("usual", USUAL), ("joint range", ranges)):
            alone, stuck, coupled = resonance(variant, box)
            values = " | ".join(f"{value:.2f}" for value in alone)
            lines.append(f"| {name}, {label} | {values} | {coupled:.3f} |")
            if stuck.max() > worst:
                worst, where = stuck.max(), JOINTS[int(np.argmax(stuck))]
    lines += ["", "While a seal sticks its bristle adds to the oil's stiffness: at most"]
    lines.append(f"{worst:.2f} ({where}).")
    return lines


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


TABLES = {
    "levers": lever_table,
    "limits": limit_table,
    "resonance": resonance_table,
    "squat": squat_table,
    "stride": stride_table,
}


def main() -> None:
    """Prints the tables, or that of the option `--table`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--table", choices=list(TABLES), help="this one alone")
    chosen = parser.parse_args().table
    print("\n\n".join("\n".join(TABLES[n]()) for n in ([chosen] if chosen else TABLES)))


if __name__ == "__main__":
    main()
