"""Scenes for log viewers: a model's URDF, and the poses of its links over a recording."""

import base64
import struct
from collections.abc import Iterator
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np

from leglab.base.errors import ModelError, RecordingError
from leglab.base.recording import Recording
from leglab.data.scene import Scene
from leglab.machine.cylinder import Cylinder
from leglab.machine.sensors import held
from leglab.machine.simulation import Simulation, actuator_moments

_RATE = 50.0  # poses per second: more than a screen shows
_HIDDEN_GROUP = 3  # geoms of this group and above are not shown, as in MuJoCo's viewer
_ROUND = 12  # sides of an ellipsoid
_TYPES = {
    mujoco.mjtJoint.mjJNT_HINGE: "revolute",
    mujoco.mjtJoint.mjJNT_SLIDE: "prismatic",
    mujoco.mjtJoint.mjJNT_FREE: "floating",
}
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def scene_of(model: mujoco.MjModel, recording: Recording) -> Scene:
    """Returns links, poses and efforts of a model that replays the motion of a recording.

    Joint positions are the true ones (`<joint>_truth`), else the measured ones
    (`<joint>_position`), else taken from the model's first keyframe. Efforts of cylinders are the
    forces of the measured pressures on both sides of the piston times the lever arms of the model,
    without friction; columns `<joint>_effort` take precedence over them.

    Args:
        model: Compiled model of the machine in the recording.
        recording: Recording of a run or a machine.

    Raises:
        LeglabError: No joint of the model is in the recording, or the model has a ball joint.
    """
    poses = _poses(model, recording)
    rows = _shown(recording.time)
    simulation = Simulation(model, keyframe=None)
    data = simulation.data
    count = model.nbody
    positions = np.zeros((rows.size, count, 3))
    quaternions = np.zeros((rows.size, count, 4))
    forces = _cylinder_forces(simulation, recording)
    torques = np.zeros((len(recording), model.nv))
    shown = {int(row): k for k, row in enumerate(rows)}
    for row in range(len(recording)) if forces else shown:
        data.qpos[:] = poses[row]
        mujoco.mj_kinematics(model, data)
        if forces:
            mujoco.mj_comPos(model, data)
            mujoco.mj_tendon(model, data)
            mujoco.mj_transmission(model, data)
            moments = actuator_moments(model, data)
            torques[row] = sum(moments[i] * force[row] for i, force in forces.items())
        if row in shown:
            k = shown[row]
            for body in range(count):
                _relative(model, data, body, positions[k, body], quaternions[k, body])
    return Scene(
        urdf=urdf(model),
        links=tuple(_name(model, body) for body in range(count)),
        parents=(-1, *(int(parent) for parent in model.body_parentid[1:])),
        rows=rows,
        positions=positions,
        quaternions=quaternions,
        efforts=_efforts(model, recording, torques) if forces else {},
    )


def urdf(model: mujoco.MjModel) -> str:
    """Returns a model as URDF: links with masses and shapes, joints with their ranges.

    Links have the names of the bodies. A capsule becomes a cylinder and two spheres, an ellipsoid a
    mesh; planes and geoms that MuJoCo's viewer hides are omitted. Meshes are `data:` URIs, so that
    the text needs no other file. URDF cannot hold tendons, actuators and constraints.

    Raises:
        LeglabError: The model has a ball joint.
    """
    root = Xml.Element("robot", name=model.names[: model.names.index(b"\0")].decode() or "model")
    for body in range(model.nbody):
        _link(root, model, body)
        if body:
            _joints(root, model, body)
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode")


def _name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body_{body}"


def _shown(time: np.ndarray) -> np.ndarray:
    """Selects rows of a recording at a rate of at most `_RATE`, with the first and the last."""
    ticks = np.floor((time - time[0]) * _RATE + 1e-6)
    first = np.concatenate([[True], np.diff(ticks) > 0])
    first[-1] = True
    return np.flatnonzero(first)


def _poses(model: mujoco.MjModel, recording: Recording) -> np.ndarray:
    """Returns the model's coordinates over the recording, (n, nq)."""
    start = model.key_qpos[0] if model.nkey else model.qpos0
    poses = np.tile(start, (len(recording), 1))
    known = 0
    for joint in range(model.njnt):
        name = model.joint(joint).name
        column = next((c for c in (f"{name}_truth", f"{name}_position") if c in recording), None)
        if column is None:
            continue
        samples = recording[column]
        good = np.flatnonzero(np.isfinite(samples))
        if not good.size:
            continue
        first = float(samples[good[0]])
        poses[:, model.jnt_qposadr[joint]] = held(samples, ~np.isfinite(samples), first)
        known += 1
    if not known:
        raise RecordingError(
            "the recording has no position of a joint of the model: ",
            allowed=(model.joint(j).name for j in range(model.njnt)),
        )
    return poses


def _relative(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, position: np.ndarray, quat: np.ndarray
) -> None:
    """Writes the pose of a body in the frame of its parent."""
    parent = model.body_parentid[body]
    inverse = np.zeros(4)
    mujoco.mju_negQuat(inverse, data.xquat[parent])
    mujoco.mju_rotVecQuat(position, data.xpos[body] - data.xpos[parent], inverse)
    mujoco.mju_mulQuat(quat, inverse, data.xquat[body])


def _cylinder_forces(simulation: Simulation, recording: Recording) -> dict[int, np.ndarray]:
    """Computes forces of measured pressures [N] by actuator id, (n,); extension is positive."""
    forces = {}
    for actuator, joint in zip(simulation.actuators, simulation.joints, strict=True):
        columns = [f"{joint}_pressure_{side}" for side in "ab"]
        if actuator in simulation.cylinders and all(c in recording for c in columns):
            cylinder = Cylinder(simulation.cylinder_parameters(actuator))
            cap, rod = (recording[c] for c in columns)
            index = simulation.model.actuator(actuator).id
            forces[index] = cap * cylinder.area_a - rod * cylinder.area_b
    return forces


def _efforts(
    model: mujoco.MjModel, recording: Recording, torques: np.ndarray
) -> dict[str, np.ndarray]:
    efforts = {}
    for joint in recording.joints:
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        if index >= 0 and f"{joint}_effort" not in recording:
            efforts[joint] = torques[:, model.jnt_dofadr[index]]
    return efforts


def _link(root: Xml.Element, model: mujoco.MjModel, body: int) -> None:
    link = Xml.SubElement(root, "link", name=_name(model, body))
    if body:
        inertial = Xml.SubElement(link, "inertial")
        _origin(inertial, model.body_ipos[body], model.body_iquat[body])
        Xml.SubElement(inertial, "mass", value=_numbers(model.body_mass[body]))
        about = dict(
            zip(("ixx", "iyy", "izz"), map(_numbers, model.body_inertia[body]), strict=True)
        )
        Xml.SubElement(inertial, "inertia", {**dict.fromkeys(("ixy", "ixz", "iyz"), "0"), **about})
    for geom in _shown_geoms(model, body):
        for position, tag, attributes in _shapes(model, geom):
            visual = Xml.SubElement(link, "visual")
            centre = model.geom_pos[geom] + _rotated(np.array(position), model.geom_quat[geom])
            _origin(visual, centre, model.geom_quat[geom])
            Xml.SubElement(Xml.SubElement(visual, "geometry"), tag, attributes)
            material = Xml.SubElement(visual, "material", name=f"geom_{geom}")
            Xml.SubElement(material, "color", rgba=_numbers(*_color(model, geom)))


def _joints(root: Xml.Element, model: mujoco.MjModel, body: int) -> None:
    """Writes the joints of a body from parent to body, with a link between consecutive joints.

    MuJoCo rotates a body about an anchor anywhere in its frame, relative to the reference
    coordinates `qpos0`; URDF rotates a link about its origin, relative to 0.
    """
    link = _name(model, int(model.body_parentid[body]))
    start, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    position, quat = model.body_pos[body].copy(), model.body_quat[body].copy()
    anchor = np.zeros(3)
    for k, joint in enumerate(range(start, start + count)):
        kind = _TYPES.get(mujoco.mjtJoint(model.jnt_type[joint]))
        name = model.joint(joint).name or f"joint_{joint}"
        if kind is None:
            text = f"joint {name!r} is a ball: a URDF has "
            raise ModelError(text, given=name, allowed="hinges, slides and free joints")
        if kind == "floating":
            position, quat = np.zeros(3), _IDENTITY.copy()
        else:
            position = position + _rotated(model.jnt_pos[joint] - anchor, quat)
            anchor = model.jnt_pos[joint].copy()
            drawn, axis = model.qpos0[model.jnt_qposadr[joint]], model.jnt_axis[joint]
            if kind == "prismatic":
                position = position - drawn * _rotated(axis, quat)
            elif drawn:
                back, turned = np.zeros(4), np.zeros(4)
                mujoco.mju_axisAngle2Quat(back, axis, -drawn)
                mujoco.mju_mulQuat(turned, quat, back)
                quat = turned
        last = k == count - 1 and not anchor.any()
        child = _name(model, body) if last else f"{_name(model, body)}/{name}"
        if not last:
            Xml.SubElement(root, "link", name=child)
        element = Xml.SubElement(root, "joint", name=name, type=kind)
        _connect(element, link, child, position, quat)
        if kind != "floating":
            Xml.SubElement(element, "axis", xyz=_numbers(*model.jnt_axis[joint]))
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-1e3, 1e3)
            limits = {"lower": _numbers(low), "upper": _numbers(high)}
            Xml.SubElement(element, "limit", {"effort": "0", "velocity": "0", **limits})
        if last:
            return
        link, position, quat = child, np.zeros(3), _IDENTITY.copy()
    fixed = Xml.SubElement(root, "joint", name=f"{_name(model, body)}/fixed", type="fixed")
    _connect(fixed, link, _name(model, body), position - _rotated(anchor, quat), quat)


def _connect(
    element: Xml.Element, parent: str, child: str, position: np.ndarray, quat: np.ndarray
) -> None:
    Xml.SubElement(element, "parent", link=parent)
    Xml.SubElement(element, "child", link=child)
    _origin(element, position, quat)


def _origin(element: Xml.Element, position: np.ndarray, quat: np.ndarray) -> None:
    """Writes a pose; URDF's roll, pitch, yaw are rotations about the fixed axes x, y, z in turn."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    r = matrix.reshape(3, 3)
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if abs(np.cos(pitch)) > 1e-9:
        roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    else:  # gimbal lock at pitch +-90 degrees, where roll and yaw have the same axis
        roll, yaw = np.arctan2(-r[1, 2], r[1, 1]), 0.0
    Xml.SubElement(element, "origin", xyz=_numbers(*position), rpy=_numbers(roll, pitch, yaw))


def _rotated(vector: np.ndarray, quat: np.ndarray) -> np.ndarray:
    found = np.zeros(3)
    mujoco.mju_rotVecQuat(found, np.asarray(vector, dtype=float), np.asarray(quat, dtype=float))
    return found


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _shown_geoms(model: mujoco.MjModel, body: int) -> Iterator[int]:
    start = int(model.body_geomadr[body])
    for geom in range(start, start + int(model.body_geomnum[body])):
        plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        if model.geom_group[geom] < _HIDDEN_GROUP and not plane and _color(model, geom)[3] > 0:
            yield geom


def _color(model: mujoco.MjModel, geom: int) -> np.ndarray:
    material = model.geom_matid[geom]
    return model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]


def _shapes(
    model: mujoco.MjModel, geom: int
) -> Iterator[tuple[tuple[float, float, float], str, dict[str, str]]]:
    """Yields the shapes of a geom: centre in its frame, element of the URDF, attributes."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    centre = (0.0, 0.0, 0.0)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        yield centre, "sphere", {"radius": _numbers(size[0])}
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        yield centre, "box", {"size": _numbers(*(2 * size))}
    elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        round_ = {"radius": _numbers(size[0])}
        yield centre, "cylinder", {**round_, "length": _numbers(2 * size[1])}
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            for end in (-size[1], size[1]):
                yield (0.0, 0.0, float(end)), "sphere", round_
    else:
        yield centre, "mesh", {"filename": _stl(*_surface(model, geom))}


def _surface(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices [m], (v, 3), and triangles, (f, 3), of a geom in its own frame."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        at, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        first, many = int(mesh.faceadr[0]), int(mesh.facenum[0])
        return model.mesh_vert[at : at + count], model.mesh_face[first : first + many]
    turn = np.arange(_ROUND) * (2 * np.pi / _ROUND)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        turn, rings = np.pi / 4 + np.arange(4) * (np.pi / 2), [(0.0, -1.0), (2**0.5, -1.0)]
        rings += [(2**0.5, 1.0), (0.0, 1.0)]
        scale = size
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        rings, scale = [(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)], size[[0, 0, 1]]
    else:
        lift = np.linspace(-np.pi / 2, np.pi / 2, _ROUND // 2 + 2)
        rings = [(float(np.cos(a)), float(np.sin(a))) for a in lift]
        scale = size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[[0, 0, 0]]
    points = np.array([(r * np.cos(a), r * np.sin(a), z) for r, z in rings for a in turn]) * scale
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        points[:, 2] += np.where(points[:, 2] < 0, -size[1], size[1])
    n, faces = turn.size, []
    for ring in range(len(rings) - 1):
        for i in range(n):
            a, b = ring * n + i, ring * n + (i + 1) % n
            faces += [(a, b, b + n), (a, b + n, a + n)]
    return points, np.array(faces)


def _stl(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Returns a surface as a binary STL in a `data:` URI."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.zeros(len(faces), dtype=record)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = normals / np.where(lengths > 0, lengths, 1.0)
    triangles["corners"] = corners
    content = bytes(80) + struct.pack("<I", len(faces)) + triangles.tobytes()
    return f"data:model/stl;base64,{base64.b64encode(content).decode()}"
