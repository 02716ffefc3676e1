"""Joints, masses, linkages and shapes of the leg models (docs/concepts/leg_design.md)."""

from pathlib import Path

import leg_meshes
import mujoco
import numpy as np
import pytest
from leg_design import FOLDER, JOINTS, cylinders, lever_rows, place, sample_poses

from leglab.machine.simulation import load_model

POSES = ("home", "stand", "swing", "squat")
# Extending the cylinder turns the joint this way (leg.xml, header comment).
SIGN = dict.fromkeys(JOINTS, -1) | {"hip_yaw": 1}
# Shortest lever over the whole range, m (docs/concepts/leg_design.md).
SHORTEST_LEVER = {
    "hip_yaw": 0.039,
    "hip_roll": 0.041,
    "hip_pitch": 0.025,
    "knee": 0.024,
    "ankle_pitch": 0.026,
    "ankle_roll": 0.019,
}


@pytest.fixture(scope="module")
def leg() -> mujoco.MjModel:
    return load_model("leg")


@pytest.fixture(scope="module")
def rail() -> mujoco.MjModel:
    return load_model("leg_rail")


def full_range(model: mujoco.MjModel) -> np.ndarray:
    """Limits of the six joints, rad, shape (6, 2)."""
    return np.array([model.joint(j).range for j in JOINTS])


@pytest.mark.parametrize("name", ["leg", "leg_rail", "leg_motor"])
def test_joints_actuators_and_step(name):
    model = load_model(name)
    expected = (["rail"] if name == "leg_rail" else []) + list(JOINTS)
    assert [model.joint(i).name for i in range(model.njnt)] == expected
    assert [model.actuator(i).name for i in range(model.nu)] == [f"{j}_valve" for j in JOINTS]
    assert model.opt.timestep == 0.001
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint in JOINTS:
        assert model.actuator(f"{joint}_valve").trnid[0] == model.tendon(f"{joint}_cylinder").id


def test_positive_directions(leg):
    """Signs as the header of leg.xml says, seen in the positions of foot and knee."""
    data = mujoco.MjData(leg)
    toe = np.array([0.19, 0.0, -0.07])
    outer_edge = np.array([0.06, 0.04, -0.08])

    def foot_point(joint: str, local: np.ndarray) -> np.ndarray:
        mujoco.mj_resetData(leg, data)
        data.joint(joint).qpos[0] = 0.2
        mujoco.mj_forward(leg, data)
        moved = data.body("foot").xpos + data.body("foot").xmat.reshape(3, 3) @ local
        mujoco.mj_resetData(leg, data)
        mujoco.mj_forward(leg, data)
        return moved - data.body("foot").xpos - data.body("foot").xmat.reshape(3, 3) @ local

    assert foot_point("hip_yaw", toe)[1] > 0.01
    assert foot_point("hip_roll", np.zeros(3))[1] > 0.1
    assert foot_point("hip_pitch", np.zeros(3))[0] > 0.1
    assert foot_point("knee", np.zeros(3))[0] < -0.05
    assert foot_point("ankle_pitch", toe)[2] > 0.01
    assert foot_point("ankle_roll", outer_edge)[2] > 0.005


def test_segments_follow_de_leva(leg):
    """75 kg adult; fractions of length by de Leva 1996, table 4, men."""
    lengths = {"thigh": 0.422, "shank": 0.440, "foot": 0.258}
    masses = {"thigh": 10.6, "shank": 3.2, "foot": 1.0}
    gyration = {  # about x, y, z of the body frame
        "thigh": (0.329, 0.329, 0.149),
        "shank": (0.251, 0.246, 0.102),
        "foot": (0.124, 0.257, 0.245),
    }
    for name, mass in masses.items():
        body = leg.body(name)
        assert body.mass[0] == pytest.approx(mass)
        radii = np.array(gyration[name]) * lengths[name]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, body.iquat)
        rotation = rotation.reshape(3, 3)
        inertia = rotation @ np.diag(body.inertia) @ rotation.T
        np.testing.assert_allclose(inertia, mass * np.diag(radii**2), rtol=0.02, atol=1e-6)
    assert leg.body("thigh").ipos[2] == pytest.approx(-0.4095 * 0.422, rel=0.01)
    assert leg.body("shank").ipos[2] == pytest.approx(-0.4395 * 0.440, rel=0.01)
    assert leg.body("shank").pos[2] == -0.422
    assert leg.body("ankle_cross").pos[2] == -0.440
    assert 30.0 <= leg.body("pelvis").mass[0] <= 35.0


def test_levers_keep_sign_and_touch_one_joint(leg):
    data = mujoco.MjData(leg)
    for angles in sample_poses(full_range(leg), 300):
        place(leg, data, angles)
        levers = lever_rows(leg, data)
        np.testing.assert_allclose(levers, np.diag(np.diag(levers)), atol=1e-12)
        for joint, lever in zip(JOINTS, np.diag(levers), strict=True):
            assert lever * SIGN[joint] > SHORTEST_LEVER[joint], joint


def test_lever_is_the_derivative_of_length(leg):
    data = mujoco.MjData(leg)
    step = 1e-6
    ids = [leg.tendon(f"{j}_cylinder").id for j in JOINTS]
    for angles in sample_poses(full_range(leg), 5)[-5:]:
        place(leg, data, angles + step)
        longer = data.ten_length[ids].copy()
        place(leg, data, angles - step)
        difference = (longer - data.ten_length[ids]) / (2 * step)
        place(leg, data, angles)
        np.testing.assert_allclose(np.diag(lever_rows(leg, data)), difference, rtol=1e-5)


def test_pistons_stay_clear_of_their_ends(leg):
    data = mujoco.MjData(leg)
    low, high = full_range(leg).T
    sizes = cylinders()
    for fraction in np.linspace(0.0, 1.0, 101):
        place(leg, data, low + fraction * (high - low))
        for joint in JOINTS:
            position = sizes[joint].position(data.tendon(f"{joint}_cylinder").length[0])
            assert 0.002 <= position <= sizes[joint].stroke - 0.002, joint


def test_cylinder_rods_run_free(leg):
    """No drawn part lies in the rod's way, 18 mm from either pin: axis and four lines around it."""
    data = mujoco.MjData(leg)
    groups = np.array([0, 1, 0, 0, 0, 0], np.uint8)
    hit = np.zeros(1, np.int32)
    sizes = cylinders()
    for angles in sample_poses(full_range(leg), 100):
        place(leg, data, angles)
        for joint in JOINTS:
            base = data.site(f"{joint}_cylinder_base").xpos
            rod = data.site(f"{joint}_cylinder_rod").xpos
            length = np.linalg.norm(rod - base)
            line = (rod - base) / length
            across = np.linalg.svd(line[None])[2][1:] * sizes[joint].rod / 2
            for offset in (np.zeros(3), *across, *-across):
                start = base + 0.018 * line + offset
                distance = mujoco.mj_ray(leg, data, start, line, groups, 1, -1, hit)
                assert distance < 0 or distance > length - 0.036, (joint, angles, distance, hit)


@pytest.mark.parametrize("pose", POSES)
def test_keyframes_are_inside_the_ranges(leg, pose):
    low, high = full_range(leg).T
    angles = leg.key(pose).qpos
    assert np.all((angles >= low) & (angles <= high))


@pytest.mark.parametrize("pose", POSES)
def test_rail_keyframes_put_the_foot_flat(rail, pose):
    data = mujoco.MjData(rail)
    mujoco.mj_resetDataKeyframe(rail, data, rail.key(pose).id)
    mujoco.mj_forward(rail, data)
    sole = rail.geom("sole").id
    rotation = data.geom_xmat[sole].reshape(3, 3)
    for x in (-1, 1):
        for y in (-1, 1):
            corner = data.geom_xpos[sole] + rotation @ (rail.geom_size[sole] * [x, y, -1])
            assert abs(corner[2]) < 1e-3
    low, high = rail.joint("rail").range
    assert low < data.joint("rail").qpos[0] < high


@pytest.mark.parametrize("name", ["leg_rail", "leg_motor"])
def test_variants_share_the_leg(leg, name):
    other = load_model(name)
    for i in range(leg.nbody):
        body, twin = leg.body(i), other.body(leg.body(i).name)
        for field in ("mass", "inertia", "ipos", "iquat", "quat"):
            np.testing.assert_array_equal(getattr(body, field), getattr(twin, field))
        if body.name != "pelvis":
            np.testing.assert_array_equal(body.pos, twin.pos)
    for joint in JOINTS:
        for field in ("axis", "pos", "range", "margin"):
            same = getattr(leg.joint(joint), field)
            np.testing.assert_array_equal(same, getattr(other.joint(joint), field))
        for end in ("base", "rod"):
            site, twin = (m.site(f"{joint}_cylinder_{end}") for m in (leg, other))
            np.testing.assert_array_equal(site.pos, twin.pos)
            assert leg.body(site.bodyid[0]).name == other.body(twin.bodyid[0]).name


def test_meshes_are_what_the_script_writes(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(leg_meshes, "FOLDER", tmp_path)
    leg_meshes.main()
    committed = sorted(path.name for path in (FOLDER / "meshes").glob("*"))
    assert sorted(path.name for path in tmp_path.glob("*")) == committed
    for name in committed:
        assert (tmp_path / name).read_text() == (FOLDER / "meshes" / name).read_text(), name
    assert sum(path.stat().st_size for path in tmp_path.glob("*")) < 300_000
