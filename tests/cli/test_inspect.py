"""`leglab inspect`: the column map for a model, a picture; spans of recordings."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leglab import data
from leglab.base.recording import Recording
from tests.cli.test_cli import leglab

TIME = np.arange(400) / 100.0
ARM = ("shoulder_pan", "elbow_flex")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def model(joints, actuator="position", suffix="", limits='range="-90 90"'):
    """Writes model.xml, a chain of hinges, each with an actuator."""
    body = "".join(
        f'<body pos="0 0 -.2"><joint name="{j}" axis="0 1 0" {limits}/>'
        f'<inertial mass="1" pos="0 0 -.1" diaginertia=".01 .01 .001"/>'
        for j in joints
    )
    drives = "".join(f'<{actuator} name="{j}{suffix}" joint="{j}"/>' for j in joints)
    text = (
        f"<mujoco><worldbody>{body}{'</body>' * len(joints)}</worldbody>"
        f"<actuator>{drives}</actuator></mujoco>"
    )
    mujoco.MjModel.from_xml_string(text)
    Path("model.xml").write_text(text)


def log(names, size=0.5, name="log.csv"):
    """Writes a table of sines, each of its own phase, in columns with these names beside a time."""
    columns = {n: size * np.sin(3.0 * TIME + k) for k, n in enumerate(names)}
    rows = np.column_stack([TIME, *columns.values()])
    np.savetxt(name, rows, delimiter=",", comments="", header=",".join(["time", *names]))
    return columns


def proposed(capsys, machine="model.xml"):
    """Columns that the proposed map gives, read back through it."""
    options = ("--model", machine, "--out", "map.toml", "--overwrite")
    status, _, errors = leglab("inspect", "log.csv", *options, capsys=capsys)
    assert (status, errors) == (0, "")
    return data.read("log.csv", columns="map.toml")


@pytest.mark.parametrize(
    ("joints", "theirs"),
    [
        (ARM, ("observation.state/{}.pos", "action/{}.pos")),  # LeRobot, flattened
        (ARM, ("/joint_states/{}/position", "/cmd/{}/data")),  # PlotJuggler
        (ARM, ("{}Angle", "{}Cmd")),
        (("left_knee", "right_knee"), ("robot.{1}.{0}.q_meas", "robot.{1}.{0}.u")),
        (("LF_KFE", "RF_KFE"), ("q_{}", "q_des_{}")),
    ],
)
def test_columns_are_known_by_their_words_in_any_order(joints, theirs, capsys):
    model(joints, suffix="_servo")
    names = {}
    for joint in joints:
        for form, ours in zip(theirs, ("{}_position", "{}_servo_command"), strict=True):
            words = joint.split("_") if "{1}" in form else [joint]
            names[ours.format(joint)] = form.format(*words)
    columns = log([*reversed(names.values()), "temperature", "frame_index"])
    found = proposed(capsys)
    for ours, name in names.items():
        np.testing.assert_allclose(found[ours], columns[name], atol=1e-12)
    assert {"temperature", "frame_index"} <= set(found.columns)


@pytest.mark.parametrize(
    ("joints", "first"),
    [(("hip", "knee"), 0), (("joint1", "joint2"), 0), (("joint1", "joint2"), 1)],
)
def test_numbered_columns_go_by_the_order_of_the_model(joints, first, capsys):
    model(joints)
    columns = log([f"{kind}[{first + k}]" for k in (1, 0) for kind in ("qpos", "qvel", "ctrl")])
    found = proposed(capsys)
    for k, joint in enumerate(joints):
        for kind, ours in (("qpos", "position"), ("qvel", "velocity"), ("ctrl", "command")):
            np.testing.assert_allclose(found[f"{joint}_{ours}"], columns[f"{kind}[{first + k}]"])


def test_numbers_that_are_more_than_the_joints_are_guesses(capsys):
    model(("hip", "knee"))
    log(["q0", "q1", "q2", "u0", "u1"])
    assert (
        leglab("inspect", "log.csv", "--model", "model.xml", "--out", "m.toml", capsys=capsys)[0]
        == 0
    )
    text = Path("m.toml").read_text()
    assert '# "q0" = "hip_position"  # ? likeness 50%' in text
    assert "# ? no column for hip_position" in text
    assert '\n"u0" = "hip_command"\n' in text


def test_units_by_name_and_by_the_range_of_the_joint(capsys):
    model(("knee",), "motor")
    columns = log(["angle [deg]", "u_Nm", "knee_speed_rpm"], size=30.0)
    found = proposed(capsys)
    np.testing.assert_allclose(found["knee_position"], np.radians(columns["angle [deg]"]))
    np.testing.assert_allclose(found["knee_velocity"], columns["knee_speed_rpm"] * np.pi / 30.0)
    np.testing.assert_allclose(found["knee_command"], columns["u_Nm"])
    columns = log(["enc", "u"], size=30.0)
    np.testing.assert_allclose(proposed(capsys)["knee_position"], np.radians(columns["enc"]))
    assert "# ? in degrees, by the range [-1.571, 1.571] rad" in Path("map.toml").read_text()
    model(("knee",))  # a servo: its command is an angle before it is a share
    np.testing.assert_allclose(proposed(capsys)["knee_command"], np.radians(columns["u"]))
    columns = log(["knee", "pA", "pB", "u"], size=1.5)
    for name in ("pA", "pB"):
        columns[name] += 80.0
    columns["knee"] += 0.9
    data.write(Recording(time=TIME, columns=columns), "log.csv")
    found = proposed(capsys, "knee_bench")
    np.testing.assert_allclose(found["knee_pressure_b"], 1e5 * columns["pB"])
    assert "# ? bar, by the range [0, 1.6e+07] Pa" in Path("map.toml").read_text()
    assert '\n"knee" = "knee_position"\n' in Path("map.toml").read_text()


def test_what_an_equality_gives_needs_no_column_and_a_base_is_held(capsys):
    model(("elbow", "finger"))
    text = Path("model.xml").read_text()
    joint = '<equality><joint joint1="finger" joint2="elbow"/></equality></mujoco>'
    text = text.replace("</mujoco>", joint).replace("<worldbody>", '<worldbody><body name="base">')
    base = '<freejoint name="root"/><geom size="0.1"/>'
    text = text.replace('<body name="base">', f'<body name="base">{base}')
    Path("model.xml").write_text(text.replace("</worldbody>", "</body></worldbody>"))
    log(["elbow_pos", "elbow_cmd", "finger_cmd"])
    command = ("inspect", "log.csv", "--model", "model.xml")
    assert leglab(*command, capsys=capsys)[0] == 2
    status, printed, _ = leglab(*command, "--fix-base", capsys=capsys)
    assert status == 0
    assert '"elbow_pos" = "elbow_position"' in printed
    assert "no column" not in printed


def test_a_map_is_tried_on_the_model(capsys):
    model(("elbow",), limits='damping="0.5" armature="0.05"')
    machine = mujoco.MjModel.from_xml_path("model.xml")
    machine.opt.timestep = 1e-3
    state, angle = mujoco.MjData(machine), np.empty(600)
    command = 0.5 * np.sin(0.03 * np.arange(600)) + 0.3 * np.sin(0.11 * np.arange(600))
    for k, sent in enumerate(command):
        angle[k] = state.qpos[0]
        state.ctrl[0] = sent
        mujoco.mj_step(machine, state, 10)
    time = 0.01 * np.arange(600)
    for factor, said in (
        (1.0, '"q" = "elbow_position"\n'),
        (180.0 / np.pi, '"q" = {name = "elbow_position", factor = 0.0174532925'),
        (-1.0, '"q" = "elbow_position"  # ? with the opposite sign of'),
    ):
        log = Recording(time=time, columns={"q": factor * angle, "u": command})
        data.write(log, "log.csv")
        printed = leglab("inspect", "log.csv", "--model", "model.xml", capsys=capsys)[1]
        assert said in printed


def test_what_may_be_either_of_two_is_not_chosen(capsys):
    model(("elbow",))
    log(["hip_pos", "knee_pos", "u"])
    status, printed, _ = leglab("inspect", "log.csv", "--model", "model.xml", capsys=capsys)
    assert status == 0
    assert '# "hip_pos" = "elbow_position"  # ? as near: knee_pos' in printed
    assert "# ? no column for elbow_position" in printed
    found = json.loads(
        leglab("inspect", "log.csv", "--model", "model.xml", "--json", capsys=capsys)[1]
    )
    assert found["map"]["missing"] == ["elbow_position"]
    (sure,) = (line for line in found["map"]["columns"] if line["sure"])
    assert (sure["theirs"], sure["ours"]) == ("u", "elbow_command")


def test_a_map_that_is_given_stays_and_is_completed(capsys):
    model(("hip", "knee"))
    columns = log(["hip_pos", "b1", "hip_cmd", "knee_cmd"])
    Path("log.csv").write_text(Path("log.csv").read_text().replace(",", ";").replace(".", ","))
    text = 'decimal = ","\n[columns]\nb1 = {name = "knee_position", factor = -1.0, offset = 0.1}\n'
    Path("mine.toml").write_text(text)
    options = ("--columns", "mine.toml", "--model", "model.xml", "--out", "map.toml")
    assert leglab("inspect", "log.csv", *options, capsys=capsys)[0] == 0
    written = Path("map.toml").read_text()
    assert 'decimal = ","\n[columns]\n' in written
    assert '"b1" = {name = "knee_position", factor = -1.0, offset = 0.1}\n' in written
    found = data.read("log.csv", columns="map.toml")
    np.testing.assert_allclose(found["knee_position"], 0.1 - columns["b1"])
    np.testing.assert_allclose(found["hip_position"], columns["hip_pos"])
    Path("mine.toml").write_text('decimal = ","\n')  # and no column yet
    assert leglab("inspect", "log.csv", *options, "--overwrite", capsys=capsys)[0] == 0
    assert '"knee_cmd" = "knee_command"' in Path("map.toml").read_text()


def test_without_a_model_names_are_made_of_the_columns_own_words(capsys):
    log(["knee.q_meas [deg]", "angle", "hip_cmd", "note2"])
    status, printed, _ = leglab("inspect", "log.csv", capsys=capsys)
    assert status == 0
    text = printed[printed.index("[columns]") :]
    Path("map.toml").write_text(text.replace("JOINT", "ankle"))
    found = data.read("log.csv", columns="map.toml")
    assert set(found.columns) == {"knee_position", "ankle_position", "hip_command", "note2"}


def test_a_map_replaces_nothing_and_needs_a_model(capsys):
    model(("knee",))
    log(["q", "u"])
    Path("map.toml").write_text("mine")
    arguments = ("inspect", "log.csv", "--out", "map.toml")
    for options, words in (
        (("--model", "model.xml"), "map.toml exists; --overwrite replaces it"),
        ((), "--out writes the map that is proposed for a model; allowed: --out with --model"),
    ):
        status, printed, errors = leglab(*arguments, *options, capsys=capsys)
        assert (status, printed, errors.count("\n")) == (2, "", 1)
        assert words in errors
    assert Path("map.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,a\n0,1\n0.2,2\n0.1,3\n", "error: column 'time', row 2: 0.1 s comes after 0.2 s"),
        ("time,a\n", "error: column 'time', row 0: there is no sample"),
        ("b,a\n3,1\n2,2\n1,3\n", "error: no column 'time'"),
    ],
)
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_what_is_no_recording_is_shown_with_status_2(text, words, options, capsys, folder):
    (folder / "bad.csv").write_text(text)
    status, printed, errors = leglab("inspect", "bad.csv", *options, capsys=capsys)
    assert (status, errors) == (2, "")
    assert words.removeprefix("error: ") in printed
    assert "no gap" not in printed


def test_a_run_s_folder_and_a_folder_of_several(capsys, folder):
    recording = Recording(time=TIME, columns={"knee_position": TIME})
    for name in ("a", "b"):
        (folder / "runs" / name).mkdir(parents=True)
        data.write(recording, folder / "runs" / name / "recording.parquet")
        (folder / "runs" / name / "run.json").write_text("{}")
    assert leglab("inspect", "runs/a", capsys=capsys)[0] == 0
    status, _, errors = leglab("inspect", "runs", capsys=capsys)
    assert status == 2
    allowed = "runs/a/recording.parquet, runs/b/recording.parquet"
    assert errors == f"error: runs: 2 recordings, one at a time; allowed: {allowed}\n"


def test_a_span_of_a_recording(capsys):
    log(["knee_position"])
    cut = ("--from", "1", "--to", "2")
    printed = leglab("inspect", "log.csv", *cut, capsys=capsys)[1]
    assert printed.startswith("log.csv: 100 samples over 0.99 s from 1 s")
    assert leglab("convert", "log.csv", "cut.csv", *cut, capsys=capsys)[0] == 0
    assert len(data.read("cut.csv")) == 100
    for command in (("inspect", "log.csv"), ("convert", "log.csv", "x.csv")):
        status, _, errors = leglab(*command, "--from", "5", capsys=capsys)
        assert status == 2
        words = "no sample in [5, inf) s: the recording covers [0, 3.99] s"
        assert errors == f"error: log.csv: {words}\n"


@pytest.mark.parametrize(
    "count", [1, 6, pytest.param(130, marks=pytest.mark.slow("draws a hundred panels"))]
)
def test_a_plot_of_all_columns(count, capsys, folder):
    time = np.r_[TIME[:200], TIME[200:] + 1.0]
    columns = {f"a{k}_position": np.where(TIME < 1, np.nan, np.sin(k * TIME)) for k in range(count)}
    data.write(Recording(time=time, columns=columns), "log.csv")
    assert leglab("inspect", "log.csv", "--plot", capsys=capsys)[0] == 0
    assert (folder / "log.png").read_bytes().startswith(b"\x89PNG")
    status, _, errors = leglab("inspect", "log.csv", "--plot", "log.png", capsys=capsys)
    assert (status, errors) == (2, "error: log.png exists; --overwrite replaces it\n")


@pytest.fixture
def machine(monkeypatch):
    """Stands for the search of a diagnosis: what reaches it is what was read."""
    from leglab.base.errors import LeglabError
    from leglab.diagnosis.verdict import verdict

    taken = {}

    def diagnose(model, recordings, *, held_out, healthy, **rest):
        taken.update(recordings=recordings, held_out=held_out, healthy=healthy)
        raise LeglabError("enough")

    monkeypatch.setattr(verdict, "diagnose", diagnose)
    model(("knee",))
    return taken


def recordings(folder, *names, end=2.0):
    """Writes recordings of the knee below a folder, and other files beside them."""
    for k, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        time = TIME[end > TIME]
        columns = {"knee_position": np.sin(3 * time + k), "knee_command": np.cos(3 * time + k)}
        data.write(Recording(time=time, columns=columns), path)
    (folder / "notes.md").write_text("mine")


def test_folders_of_recordings_are_taken(machine, capsys, folder):
    recordings(folder / "now", "a/recording.parquet", "b/recording.parquet", "x.csv")
    recordings(folder / "before", "x.csv")
    (folder / "before" / "x.csv").rename(folder / "before" / "x.CSV")
    (folder / "now" / "table.csv").write_text("name,size\na,3\n")
    command = ("diagnose", "model.xml", "now", "--healthy", "before", "--from", "0.5")
    status, _, errors = leglab(*command, "--held-out", "x", capsys=capsys)
    assert status == 2
    first, second, _, last = errors.splitlines()
    assert first == "warning: now: 1 files are no recordings (notes.md)"
    assert second.startswith("warning: left out: now/table.csv: ")
    assert last == "error: enough"
    assert list(machine["recordings"]) == ["a/recording.parquet", "b/recording.parquet", "x.csv"]
    assert machine["held_out"] == ("x.csv",)
    assert {r.time[0] for r in machine["recordings"].values()} == {0.5}
    assert list(machine["healthy"]) == ["x.CSV"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("empty",), "empty: a folder without recordings; allowed: .parquet, .csv"),
        (("now", "--healthy", "now/x.csv"), "x.csv is given as a recording and as --healthy"),
        (("now", "now/x.csv"), "two recordings are called 'x.csv'"),
        (("now", "--to", "0"), "x.csv: no sample in [-inf, 0) s: the recording covers [0, 1.99] s"),
        (("texts",), "table.csv: "),
    ],
)
def test_folders_that_cannot_be_taken(arguments, words, machine, capsys, folder):
    recordings(folder / "now", "x.csv")
    (folder / "empty").mkdir()
    (folder / "texts").mkdir()
    (folder / "texts" / "table.csv").write_text("name,size\na,3\n")
    status, _, errors = leglab("diagnose", "model.xml", *arguments, capsys=capsys)
    assert (status, machine) == (2, {})
    assert errors.count("\n") == 1 + ("notes.md" in errors)
    assert words in errors
    assert not (folder / "out").exists()


def test_a_recording_in_the_place_of_the_model_is_named(capsys, folder):
    recordings(folder, "x.csv")
    for command in ("diagnose", "improve"):
        status, _, errors = leglab(command, "x.csv", "model.xml", capsys=capsys)
        assert status == 2
        assert errors == "error: x.csv is a recording: the model comes first, model.xml x.csv\n"
