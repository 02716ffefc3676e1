"""Wrong units and directions of signals are a question before anything is searched."""

import functools

import mujoco
import numpy as np
import pytest

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.diagnosis.balance.units import doubts
from leglab.diagnosis.intake.admission import admit
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.plant.model import Machine
from tests.cli.test_cli import leglab
from tests.helpers.unpleasant import of_bench

DRIVES = {
    "servo": '<position name="{0}" joint="{0}" kp="60" kv="3"/>',
    "motor": '<motor name="{0}" joint="{0}"/>',
}
LINK = """<body name="{0}" pos="0 0 -0.2">
<joint name="{0}" axis="0 1 0" damping="{damping}" frictionloss="{friction}" armature="0.05"/>
<inertial mass="{mass}" pos="0 0 -0.2" diaginertia="0.02 0.02 0.002"/>"""
JOINTS = ("hip", "knee")


def machine(drive, *, damping=0.5, friction=0.1, mass=2.0):
    """MJCF of two links with drives of a kind."""
    links = (LINK.format(j, damping=damping, friction=friction, mass=mass) for j in JOINTS)
    drives = "".join(DRIVES[drive].format(j) for j in JOINTS)
    return (
        '<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>'
        f"{''.join(links)}</body></body></worldbody><actuator>{drives}</actuator></mujoco>"
    )


@functools.cache
def log(drive, seed, late=0, gain=1.0, **changes):
    """A recording of the machine, 6 s at 250 Hz, its command `late` by so many samples."""
    model = mujoco.MjModel.from_xml_string(machine(drive, **changes))
    state, rng = mujoco.MjData(model), np.random.default_rng(seed)
    time, phases = np.arange(1500) * 4e-3, rng.uniform(0.0, 6.0, (2, 3))
    waves = np.sin(2.0 * np.pi * np.multiply.outer(time, (0.4, 0.9, 2.1))[:, None] + phases)
    sent = (0.4 if drive == "servo" else 2.0) * waves.sum(axis=2)
    positions = np.empty((time.size, 2))
    for k in range(time.size):
        positions[k] = state.qpos
        state.ctrl[:] = gain * sent[max(0, k - late)]
        mujoco.mj_step(model, state, 4)
    positions += rng.normal(0.0, 2e-5, positions.shape)
    columns = {f"{j}_position": positions[:, i] for i, j in enumerate(JOINTS)}
    columns |= {f"{j}_command": sent[:, i] for i, j in enumerate(JOINTS)}
    return Recording(time=time, columns=columns)


def times(column, factor):
    """What multiplies a column of a recording, or all of a kind."""

    def change(recording):
        own = [c for c in recording.columns if c.endswith(column)]
        return recording.with_columns({c: factor * recording[c] for c in own})

    return change


def counts(recording):
    turned = np.rint(recording["hip_position"] * 4096.0 / (2.0 * np.pi))
    return recording.with_columns({"hip_position": turned})


WRONG = {
    "degrees": (times("hip_position", 180.0 / np.pi), "with 'hip_position' in degrees"),
    "all degrees": (
        times("_position", 180.0 / np.pi),
        "with 'hip_position', 'knee_position' in degrees",
    ),
    "everything": (
        times("", 180.0 / np.pi),
        "with 'hip_position', 'knee_position', 'hip_command', 'knee_command' in degrees",
    ),
    "turns": (times("knee_position", 0.5 / np.pi), "with 'knee_position' in turns"),
    "counts": (counts, "with 'hip_position' in counts, some 4096 a turn"),
    "encoder": (times("knee_position", -1.0), "with the opposite sign of 'knee_position'"),
    "drive": (times("hip_command", -1.0), "with the opposite sign of 'hip_command'"),
    "per cent": (times("hip_command", 100.0), "with 'hip_command' in per cent"),
    "mA": (times("_command", 1e3), "with 'hip_command', 'knee_command' in mA, mV"),
    "small": (times("knee_command", 1e-3), "with 'knee_command' in thousands"),
}


_MORE = pytest.mark.slow("more units and machines of the same kinds")


def some(cases, *fast):
    """All cases, of which the others are slow."""
    return [case if case in fast else pytest.param(*case, marks=_MORE) for case in cases]


@pytest.mark.parametrize(
    ("kind", "drive"),
    some(
        [*((kind, "servo") for kind in WRONG), ("degrees", "motor"), ("drive", "motor")],
        *((kind, "servo") for kind in ("all degrees", "counts", "encoder", "drive", "small")),
        ("degrees", "motor"),
    ),
)
def test_a_wrong_unit_or_sign_of_most_recordings_is_a_question(
    kind, drive, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.xml").write_text(machine(drive))
    spoil, words = WRONG[kind]
    changes = {"friction": 0.3, "mass": 2.3}  # The machine is not quite its model.
    for seed in range(3):
        recording = log(drive, seed, **changes)
        data.write(spoil(recording) if seed else recording, tmp_path / f"l{seed}.parquet")
    logs = [f"l{seed}.parquet" for seed in range(3)]
    status, out, errors = leglab("diagnose", "model.xml", *logs, capsys=capsys)
    assert (status, out) == (2, "")
    last = errors.splitlines()[-1]
    assert words in last
    assert last.startswith("error: l1.parquet (and 1 more recordings): ")
    assert "column map (--columns)" in last
    assert not (tmp_path / "out").exists()


CHANGED = {
    "as its model": {},
    "payload": {"mass": 3.0},
    "friction": {"friction": 0.6, "damping": 3.0},
    "delay": {"late": 5},
    "weak drive": {"gain": 0.3},
    "strong drive": {"gain": 3.0},
}


@pytest.mark.parametrize(
    ("change", "drive"),
    some(
        [(change, drive) for change in CHANGED for drive in DRIVES],
        *((change, "servo") for change in ("as its model", "payload", "delay", "weak drive")),
        ("friction", "motor"),
    ),
)
def test_a_machine_that_has_changed_is_not_taken_for_another_unit(change, drive, tmp_path):
    (tmp_path / "model.xml").write_text(machine(drive))
    logs = {f"l{seed}": log(drive, seed, **CHANGED[change]) for seed in range(2)}
    assert doubts(Machine(tmp_path / "model.xml"), logs) == []


@pytest.mark.parametrize(
    ("case", "pressures"),
    some(
        [(case, pressures) for case in ("nominal", "d2") for pressures in (True, False)],
        ("nominal", True),
        ("d2", False),
    ),
)
def test_a_valve_that_is_counted_the_other_way(case, pressures):
    bench = Machine("knee_bench")
    logs = admit(bench, of_bench(case)).recordings
    if not pressures:
        logs = {n: r.select(bench.columns) for n, r in logs.items()}
    assert doubts(bench, logs) == []
    if case == "nominal":
        logs = dict(logs) | {"walk": times("knee_valve_command", -1.0)(logs["walk"])}
        (found,) = doubts(bench, logs)
        assert (found.recording, found.columns) == ("walk", ("knee_valve_command",))
        assert found.factor == -1.0


def glitches(recording, rng):
    """Drop-outs to zero and spikes of a position, stale first rows, and 8 ms of zeros."""
    angle = recording["knee_position"].copy()
    places = rng.choice(np.arange(50, angle.size - 50, 8), 20, replace=False)
    angle[places[:10]] = 0.0
    angle[places[10:]] += rng.choice([-0.3, 0.3], 10)
    angle[1:3] = angle[0] = angle[-1] + 1.0
    return recording.with_columns({"knee_position": angle}), np.append(places, (0, 1, 2))


def test_samples_that_no_motion_supports_are_left_out_and_counted_in_a_line():
    bench = Machine("knee_bench")
    walk = of_bench("nominal")["walk"]
    spoilt, places = glitches(walk, np.random.default_rng(0))
    admitted = admit(bench, {"walk": spoilt})
    left_out = np.isnan(admitted.recordings["walk"]["knee_position"])
    assert set(np.flatnonzero(left_out)) == set(places)
    (line,) = admitted.notes
    assert "jump away" in line
    assert "'knee_position' 23, worst " in line
    assert not any("jump" in note for note in admit(bench, {"walk": walk}).notes)


def test_two_publishers_in_one_column_are_named():
    walk = of_bench("nominal")["walk"]
    angle = walk["knee_position"].copy()
    angle[::2] += 0.1
    with pytest.raises(LeglabError, match=r"every other row of column 'knee_position'"):
        admit(Machine("knee_bench"), {"walk": walk.with_columns({"knee_position": angle})})


def test_windows_across_changes_of_a_state_are_left_out():
    bench = Machine("knee_bench")
    walk = of_bench("nominal")["walk"]
    rows = np.arange(len(walk))
    mode = np.where(rows < len(walk) // 2, 1.0, 2.0)
    extra = {"mode": mode, "counter": rows * 1.0, "tick": rows % 2.0, "spare": 0.0 * rows}
    admitted = admit(bench, {"walk": walk.with_columns(extra)})
    (line,) = admitted.notes
    assert line == "walk: windows across changes of a state are left out: 'mode' 1 times"
    needed = (*bench.columns, "knee_pressure_a")
    series = UniformSeries.from_recording(admitted.recordings["walk"], "walk", needed)
    assert not series.valid[len(walk) // 2]
    assert series.valid.mean() > 0.98
