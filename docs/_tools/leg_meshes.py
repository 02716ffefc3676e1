"""Writes the OBJ meshes of the leg into models/meshes (millimetres; the MJCF scales by 0.001).

Run `python docs/_tools/leg_meshes.py` after a change of shape; the result is committed.
Every mesh is one of three kinds: a loft through superellipse sections, a lever plate (the convex
outline of two circles, extruded, with a chamfer), or a helix.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

FOLDER = Path(__file__).parents[2] / "models" / "meshes"


def write_grid(name: str, *grids: np.ndarray, texture: bool = False) -> None:
    """Writes tubes of closed rings, with a fan over each end, as one OBJ.

    Args:
        name: File name without the suffix.
        grids: Points in mm, each of shape (number of rings, points a ring, 3); counter-clockwise
            seen from the last ring, so that normals point outwards.
        texture: Whether to write texture coordinates: around the ring and along the tube.
    """
    vertices: list[str] = []
    coordinates: list[str] = []
    faces: list[str] = []
    form = "{0}/{0}" if texture else "{0}"
    for rings in grids:
        count, around, _ = rings.shape
        offset = len(vertices) + 1
        centres = [rings[0].mean(0), rings[-1].mean(0)]
        points = np.vstack([rings.reshape(-1, 3), *centres])
        vertices += [f"v {x:.1f} {y:.1f} {z:.1f}" for x, y, z in points]
        if texture:
            # The pattern runs there and back around the ring: no seam, no doubled vertices.
            across = 1 - abs(2 * np.linspace(0.0, 1.0, around, endpoint=False) - 1)
            along = np.linspace(0.0, 1.0, count)
            coordinates += [f"vt {u:.2f} {v:.2f}" for v in along for u in across]
            coordinates += ["vt 0.5 0", "vt 0.5 1"]
        first, last, end = count * around, count * around + 1, (count - 1) * around
        for j in range(around):
            k = (j + 1) % around
            corners: list[tuple[int, ...]] = [(first, k, j), (last, end + j, end + k)]
            corners += [
                (i + j, i + k, i + k + around, i + j + around) for i in range(0, end, around)
            ]
            faces += ["f " + " ".join(form.format(offset + i) for i in c) for c in corners]
    (FOLDER / f"{name}.obj").write_text("\n".join(vertices + coordinates + faces) + "\n")


def superellipse(around: int, exponent: float) -> np.ndarray:
    """Unit superellipse |x|^n + |y|^n = 1, counter-clockwise, shape (around, 2)."""
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)
    power = 2.0 / exponent
    return np.stack([np.sign(c) * abs(c) ** power, np.sign(s) * abs(s) ** power], -1)


def loft(
    name: str,
    table: Sequence[tuple[float, ...]],
    *,
    axis: int,
    around: int = 20,
    exponent: float = 2.6,
    count: int = 20,
    texture: bool = True,
) -> None:
    """Lofts superellipses along an axis through a table of extents.

    Args:
        name: File name without the suffix.
        table: Rows (position along the axis, low and high of the first cross direction, low and
            high of the second), mm, ascending; interpolated by monotone cubics. The ends are
            rounded off.
        axis: 2 lofts along z with sections in (x, y), 0 along x with sections in (y, z).
        around: Points a section.
        exponent: Of the superellipse; 2 is an ellipse, more is boxier.
        count: Number of sections.
        texture: Whether the carbon weave goes on it.
    """
    rows = np.asarray(table, float)
    at: Callable[[np.ndarray], np.ndarray] = PchipInterpolator(rows[:, 0], rows[:, 1:])
    # Cosine spacing puts sections where the rounded ends turn fastest.
    s = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))
    position = rows[0, 0] + s * (rows[-1, 0] - rows[0, 0])
    unit = superellipse(around, exponent)
    rings = []
    for p, (low1, high1, low2, high2) in zip(position, at(position), strict=True):
        a = (low1 + high1) / 2 + (high1 - low1) / 2 * unit[:, 0]
        b = (low2 + high2) / 2 + (high2 - low2) / 2 * unit[:, 1]
        flat = np.full_like(a, p)
        rings.append(np.stack([a, b, flat] if axis == 2 else [flat, a, b], -1))
    write_grid(name, np.asarray(rings), texture=texture)


def lever(name: str, length: float, big: float, small: float, thickness: float) -> None:
    """Writes a lever plate in the xy plane, centred on z = 0, from the origin to (length, 0).

    Args:
        name: File name without the suffix.
        length: Distance between the two eyes, mm.
        big: Radius at the origin, mm.
        small: Radius at the far eye, mm.
        thickness: Of the plate, mm; its edges carry a chamfer of a sixth of it.
    """
    tangent = np.arccos((big - small) / length)
    far = np.linspace(-tangent, tangent, 9)
    near = np.linspace(tangent, 2 * np.pi - tangent, 13)
    chamfer = thickness / 6

    def outline(inset: float) -> np.ndarray:
        eye = np.stack([length + (small - inset) * np.cos(far), (small - inset) * np.sin(far)], -1)
        hub = (big - inset) * np.stack([np.cos(near), np.sin(near)], -1)
        return np.vstack([eye, hub])

    half = thickness / 2
    layers = [(chamfer, -half), (0.0, chamfer - half), (0.0, half - chamfer), (chamfer, half)]
    rings = [np.column_stack([outline(i), np.full(22, z)]) for i, z in layers]
    write_grid(name, np.asarray(rings))


def helix(name: str, radius: float, wire: float, pitch: float, turns: int) -> None:
    """Writes a coil about z, centred on the origin: coil and wire radius and pitch in mm."""
    t = np.linspace(0.0, 2 * np.pi * turns, 14 * turns + 1)
    centre = np.stack([radius * np.cos(t), radius * np.sin(t), pitch * (t / (2 * np.pi))], -1)
    centre[:, 2] -= pitch * turns / 2
    outward = np.stack([np.cos(t), np.sin(t), 0 * t], -1)
    up = np.array([0.0, 0.0, 1.0])
    angle = np.linspace(0.0, 2 * np.pi, 6, endpoint=False)
    section = wire * np.cos(angle)[:, None] * up
    radial = wire * np.sin(angle)[:, None] * outward[:, None]
    write_grid(name, (centre[:, None] + section + radial)[:, ::-1])


def bolt_circle(name: str, radius: float, count: int) -> None:
    """Writes a circle of screw heads in the xy plane, 5 mm across and 4 mm high, mm."""
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    outline = superellipse(8, 2.0)
    heads = []
    for centre in radius * np.stack([np.cos(angle), np.sin(angle)], -1):
        layers = [(2.6, -2.0), (2.6, 1.4), (2.0, 2.0)]
        rings = [np.column_stack([centre + r * outline, np.full(8, z)]) for r, z in layers]
        heads.append(np.asarray(rings))
    write_grid(name, *heads)


def tube(name: str, knots: Sequence[tuple[float, float, float]], radius: float) -> None:
    """Writes a hose along a smooth curve through the knots, mm."""
    t = np.linspace(0.0, len(knots) - 1.0, 5 * len(knots))
    curve = CubicSpline(range(len(knots)), np.asarray(knots, float))
    along = curve(t, 1)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    angle = np.linspace(0.0, 2 * np.pi, 7, endpoint=False)[None, :, None]
    ring = np.cos(angle) * side[:, None] + np.sin(angle) * other[:, None]
    write_grid(name, curve(t)[:, None] + radius * ring)


def rounded(rows: Sequence[tuple[float, ...]], start: float, end: float) -> list[tuple[float, ...]]:
    """Adds quarter-circle ends of the given radii to a loft table, shrinking its first extent."""
    out = []
    for radius, sign, row in ((start, -1.0, rows[0]), (end, 1.0, rows[-1])):
        z, low, high, low2, high2 = row
        steps = np.linspace(0.0, np.pi / 2, 7)[1:]
        for t in steps:
            shrink = max(np.cos(t), 0.04)
            middle, half = (low + high) / 2, (high - low) / 2 * shrink
            mid2, half2 = (low2 + high2) / 2, (high2 - low2) / 2 * max(shrink**0.3, 0.3)
            position = z + sign * radius * np.sin(t)
            out.append((position, middle - half, middle + half, mid2 - half2, mid2 + half2))
    return sorted([*out, *rows])


def main() -> None:
    """Writes all meshes."""
    FOLDER.mkdir(exist_ok=True)
    # Waisted: the cylinders in front and behind stay in sight from the side.
    thigh = [
        (-422, -42, 42, 42, 57), (-372, -36, 37, 41, 58), (-300, -33, 33, 41, 60),
        (-222, -37, 36, 41, 63), (-140, -34, 33, 41, 62), (-60, -37, 37, 42, 60),
        (0, -44, 44, 42, 57),
    ]  # fmt: skip
    loft("thigh_shell", rounded(thigh, 42, 44), axis=2, exponent=3.0, count=26)
    shank = [
        (-285, -20, 17, -20, 20), (-255, -30, 21, -27, 27), (-200, -50, 29, -40, 40),
        (-140, -60, 35, -48, 48), (-100, -54, 38, -47, 47), (-72, -38, 38, -42, 42),
        (-52, -20, 32, -33, 33),
    ]  # fmt: skip
    loft("shank_shell", shank, axis=2, exponent=2.5, count=20)
    sole = [
        (-66, -16, 18, -74, -62), (-62, -24, 27, -78, -60), (-45, -31, 34, -80, -58),
        (0, -33, 36, -80, -58), (60, -37, 44, -80, -58), (120, -41, 50, -80, -58),
        (160, -38, 45, -79, -58), (182, -26, 32, -75, -58), (190, -12, 18, -70, -59),
    ]  # fmt: skip
    loft("foot_sole", sole, axis=0, exponent=4.5, around=24, count=24, texture=False)
    upper = [
        (-60, -14, 16, -60, -46), (-55, -22, 24, -61, -38), (-38, -28, 30, -61, -32),
        (0, -29, 31, -61, -32), (40, -32, 36, -61, -26), (75, -35, 41, -61, -28),
        (120, -37, 45, -61, -40), (155, -33, 40, -61, -47), (176, -22, 28, -61, -52),
        (184, -10, 16, -61, -56),
    ]  # fmt: skip
    loft("foot_upper", upper, axis=0, exponent=3.0, around=20, count=20)
    toe_cap = [
        (132, -39, 47, -59, -41), (150, -36, 43.5, -59, -44), (168, -29.5, 36, -59, -48),
        (180, -20, 26, -59, -52), (186, -10, 16, -59, -55),
    ]  # fmt: skip
    loft("toe_cap", toe_cap, axis=0, exponent=3.0, around=20, count=12, texture=False)
    pelvis = [
        (-298, -48, 48, 200, 266), (-200, -58, 58, 197, 276), (-60, -68, 68, 194, 278),
        (20, -66, 66, 194, 270), (46, -58, 58, 196, 262),
    ]  # fmt: skip
    # Lofted along x and turned by the geom: (y, z) of the section are then (x, z) of the pelvis.
    loft("pelvis_shell", rounded(pelvis, 4, 12), axis=0, exponent=7.0, around=28, count=14)
    lever("yaw_lever", 52, 30, 10, 4)
    lever("yoke_top", 102, 44, 28, 16)
    lever("yoke_back", 108, 40, 28, 15)
    lever("roll_arm", 66, 26, 16, 14)
    lever("roll_lever", 50, 27, 11, 12)
    lever("hip_lug", 55, 30, 10, 6)
    lever("hip_strut_lever", 44, 22, 9, 6)
    lever("knee_lug", 48, 28, 10, 6)
    lever("knee_strut_lever", 42, 22, 9, 6)
    lever("ankle_lug", 36, 18, 8, 5)
    lever("ankle_strut_lever", 36, 14, 7, 5)
    lever("ankle_roll_arm", 62.8, 15, 13, 6)
    helix("torsion_coil", 27, 2.2, 6.0, 5)
    bolt_circle("bolts_65", 32.5, 8)
    bolt_circle("bolts_44", 22, 6)
    thigh_hose = [(8, -84, -262), (10, -86, -300), (6, -76, -350), (0, -76, -400), (0, -70, -422)]
    tube("thigh_hose", thigh_hose, 3.6)
    shank_hose = [
        (0, -70, 0), (-2, -74, -30), (-14, -66, -80), (-18, -56, -140), (-14, -50, -200),
        (2, -40, -250), (14, -28, -285), (22, -20, -300),
    ]  # fmt: skip
    tube("shank_hose", shank_hose, 3.6)


if __name__ == "__main__":
    main()
