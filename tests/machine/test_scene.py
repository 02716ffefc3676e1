"""Machines in logs: the URDF moves as the model does, and what readers decode is what moved."""

import base64
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from leglab import RunSettings, data, load_model, run_scenario, write_run
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.machine.scene import scene_of, urdf
from leglab.machine.simulation import Simulation
from tests.cli.test_cli import leglab

# Two hinges with anchors and a drawn angle in one body, and a slide that is drawn pulled out.
ODD = """<mujoco model="odd"><compiler angle="radian"/><worldbody>
  <body name="base" pos="0.1 0.2 0.3" quat="0.9 0.1 -0.3 0.2">
    <joint name="swing" type="hinge" axis="0 1 0" pos="0.05 0 -0.1" ref="0.4"/>
    <joint name="twist" type="hinge" axis="1 0 1" pos="0 0.02 0.1"/>
    <geom type="capsule" size="0.02 0.1" rgba="1 0 0 1"/>
    <body name="tip" pos="0 0 0.4" euler="0.3 1.2 -0.5">
      <joint name="reach" type="slide" axis="0 0 1" ref="0.05" range="-1 1"/>
      <geom type="ellipsoid" size="0.01 0.02 0.03"/><geom type="box" size="0.03 0.02 0.01"/>
    </body></body></worldbody>
  <actuator><motor joint="swing"/><motor joint="twist"/><motor joint="reach"/></actuator>
</mujoco>"""


def moved(model, angles):
    """Places of the bodies by name, joints at these coordinates."""
    pose = mujoco.MjData(model)
    for joint, value in angles.items():
        pose.joint(joint).qpos[0] = value
    mujoco.mj_kinematics(model, pose)
    names = [model.body(body).name for body in range(1, model.nbody)]
    return {name: (pose.body(name).xpos, pose.body(name).xmat) for name in names}


def read_urdf(text):
    """Compiles a URDF by MuJoCo's own reader, with its meshes as files."""
    root, files = Xml.fromstring(text), {}
    for number, mesh in enumerate(root.iter("mesh")):
        content = mesh.get("filename").removeprefix("data:model/stl;base64,")
        files[f"{number}.stl"] = base64.b64decode(content)
        mesh.set("filename", f"{number}.stl")
    keep = Xml.SubElement(Xml.SubElement(root, "mujoco"), "compiler")
    for name in ("fusestatic", "balanceinertia", "discardvisual", "strippath"):
        keep.set(name, "false")
    for name in ("boundmass", "boundinertia"):  # MuJoCo wants some of links between two joints
        keep.set(name, "1e-9")
    return mujoco.MjModel.from_xml_string(Xml.tostring(root, encoding="unicode"), files)


@pytest.mark.parametrize("name", ["odd", "leg", "leg_rail"])
def test_the_urdf_moves_as_the_model(name):
    model = mujoco.MjModel.from_xml_string(ODD) if name == "odd" else load_model(name)
    again = read_urdf(urdf(model))
    random = np.random.default_rng(3)
    angles = {model.joint(j).name: random.uniform(-0.8, 0.8) for j in range(model.njnt)}
    theirs = moved(again, angles)
    for body, (place, turned) in moved(model, angles).items():
        np.testing.assert_allclose(theirs[body][0], place, atol=1e-7, err_msg=body)
        np.testing.assert_allclose(theirs[body][1], turned, atol=1e-7, err_msg=body)
    assert again.body_mass.sum() == pytest.approx(model.body_mass[1:].sum(), rel=1e-6)


def test_a_ball_joint_is_refused():
    text = ODD.replace('type="hinge" axis="1 0 1" pos="0 0.02 0.1"', 'type="ball"')
    model = mujoco.MjModel.from_xml_string(text.replace('<motor joint="twist"/>', ""))
    with pytest.raises(LeglabError, match="joint 'twist' is a ball"):
        urdf(model)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    run = run_scenario(RunSettings(scenario="nominal", controller="pd", duration=0.2))
    folder = write_run(run, tmp_path_factory.mktemp("scene") / "run")
    recording = data.read(folder / "recording.parquet")
    data.write(recording, folder / "run.mcap", scene=scene_of(load_model("leg"), recording))
    return folder


def messages(path, topic):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [m.decoded_message for m in reader.iter_decoded_messages(topics=topic)]


def test_frames_stand_where_the_machine_was(folder):
    recording = data.read(folder / "recording.parquet")
    model = load_model("leg")
    transforms = messages(folder / "run.mcap", "/tf")
    assert len(transforms) == 11  # 50 a second, and the last
    for message, row in ((transforms[4], 40), (transforms[-1], 100)):
        placed = {"world": (np.zeros(3), np.eye(3))}
        for each in message.transforms:
            turn, shift = each.transform.rotation, each.transform.translation
            matrix = np.zeros(9)
            mujoco.mju_quat2Mat(matrix, [turn.w, turn.x, turn.y, turn.z])
            origin, axes = placed[each.header.frame_id]
            here = origin + axes @ [shift.x, shift.y, shift.z]
            placed[each.child_frame_id] = here, axes @ matrix.reshape(3, 3)
        angles = {joint: recording[f"{joint}_truth"][row] for joint in recording.tracked}
        for body, (place, turned) in moved(model, angles).items():
            np.testing.assert_allclose(placed[body][0], place, atol=1e-9, err_msg=body)
            np.testing.assert_allclose(placed[body][1].ravel(), turned, atol=1e-9, err_msg=body)
    (description,) = messages(folder / "run.mcap", "/robot_description")
    assert description.data == urdf(model)
    links = {link.get("name") for link in Xml.fromstring(description.data).iter("link")}
    assert {each.child_frame_id for each in transforms[0].transforms} <= links


def test_efforts_are_those_of_the_pressures(folder):
    """Areas of piston and annulus in closed form, lever arms of MuJoCo's transmission."""
    recording = data.read(folder / "recording.parquet")
    states = messages(folder / "run.mcap", "/joint_states")
    simulation = Simulation(load_model("leg"))
    row = 60
    for joint in simulation.joints:
        simulation.data.joint(joint).qpos[0] = recording[f"{joint}_truth"][row]
    mujoco.mj_forward(simulation.model, simulation.data)
    forces = []
    for joint, actuator in zip(simulation.joints, simulation.actuators, strict=True):
        cap, rod = (recording[f"{joint}_pressure_{side}"][row] for side in "ab")
        sizes = simulation.cylinder_parameters(actuator)
        bore, thin = sizes["bore"], sizes["rod"]
        forces.append(np.pi / 4 * (bore**2 * cap - (bore**2 - thin**2) * rod))
    wanted = dict(zip(simulation.joints, simulation.levers() * np.array(forces), strict=True))
    told = dict(zip(states[row].name, states[row].effort, strict=True))
    for joint in simulation.joints:
        assert told[joint] == pytest.approx(wanted[joint], rel=1e-9, abs=1e-9)
    assert max(map(abs, told.values())) > 1.0


def test_a_joint_has_one_message_of_its_hydraulics(folder):
    recording = data.read(folder / "recording.parquet")
    back = data.read(folder / "run.mcap")
    for name, samples in recording.columns.items():
        np.testing.assert_array_equal(back[name], samples, err_msg=name)
    assert {n for n in back.columns if n not in recording} == {
        f"{joint}_effort" for joint in recording.joints
    }
    message = messages(folder / "run.mcap", "/knee/hydraulics")[7]
    assert message.pressure_a == recording["knee_pressure_a"][7]
    assert message.valve_command == recording["knee_valve_command"][7]
    assert messages(folder / "run.mcap", "/knee/control")[7].truth == recording["knee_truth"][7]
    with (folder / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    topics = {channel.topic for channel in summary.channels.values()}
    assert len(topics) <= 2 * 6 + 4
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    (text,) = {s.data.decode() for s in summary.schemas.values() if s.name.endswith("Hydraulics")}
    assert "float64 pressure_a  # Pa\n" in text


def test_a_reader_of_ros_bags_opens_it(folder):
    """Every message by rosbags; Foxglove's own reader is the package mcap of the tests above."""
    rosbags = pytest.importorskip("rosbags.rosbag2", reason="pip install rosbags")
    typesys = pytest.importorskip("rosbags.typesys")
    store, counts = typesys.get_typestore(typesys.Stores.EMPTY), {}
    with rosbags.Reader(folder / "run.mcap") as reader:
        for connection in reader.connections:
            found = typesys.get_types_from_msg(connection.msgdef.data, connection.msgtype)
            store.register({k: v for k, v in found.items() if k not in store.types})
        for connection, _, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            assert message is not None
    assert counts["/joint_states"] == counts["/knee/hydraulics"] == 101
    assert counts["/tf"] == 11


def test_a_format_without_a_machine_says_so(folder, tmp_path, capsys):
    run = str(folder)
    status, _, told = leglab("convert", run, f"{tmp_path}/x.csv", "--model", "leg", capsys=capsys)
    assert status == 2
    assert "csv cannot show a machine; --model goes with mcap" in told
    assert leglab("convert", run, f"{tmp_path}/run.mcap", capsys=capsys)[0] == 0
    assert (tmp_path / "run.mcap").read_bytes() == (folder / "run.mcap").read_bytes()
    other = Recording(time=[0.0, 1.0], columns={"elbow_position": [0.0, 1.0]})
    with pytest.raises(LeglabError, match="no position of a joint of the model: hip_yaw"):
        scene_of(load_model("leg"), other)
