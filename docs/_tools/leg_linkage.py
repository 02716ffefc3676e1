"""Cylinder linkages of the leg: levers, piston positions, effective masses.

`python docs/_tools/leg_linkage.py` prints the tables of docs/concepts/leg_design.md.
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

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


TABLES = {"levers": lever_table, "limits": limit_table, "resonance": resonance_table}


def print_tables(tables: Mapping[str, Callable[[], list[str]]]) -> None:
    """Prints the tables, or that of the option `--table`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--table", choices=list(tables), help="this one alone")
    chosen = parser.parse_args().table
    print("\n\n".join("\n".join(tables[n]()) for n in ([chosen] if chosen else tables)))


if __name__ == "__main__":
    print_tables(TABLES)
