"""Films of runs: what is in the picture, and what is said where one cannot be made."""

import ctypes.util
import json
import os
import shutil
import subprocess
import sys

import imageio_ffmpeg
import numpy as np
import pytest

from leglab import RunSettings, data, run_scenario
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.causes.fault_names import FaultEvent
from leglab.cli import main
from leglab.report.film import encoder, look, render_film
from leglab.report.film.encoder import encoding
from leglab.report.film.look import ALARM, GHOST, pressure_color
from leglab.report.film.track import _named, load_track
from leglab.report.film.workers import draw_frames
from leglab.runs.folder import write_run

LENGTH, CHANGE = 2.0, 1.0  # s
BAR = 1e5  # Pa


def make_run(folder, controller="pd", **options):
    settings = RunSettings(
        scenario="seal_wear", controller=controller, model="knee_bench", **options
    )
    return write_run(run_scenario(settings), folder)


def make_dark(folder):
    """A run of a model without lights and without a sky."""
    axis = """<mujoco model="axis"><option timestep="0.001"/><worldbody><body>
      <joint name="axis" type="slide" axis="1 0 0"
      armature="0.4" damping="6"/><geom type="box" size="0.05 0.04 0.02" mass="2"/></body>
      </worldbody><actuator><motor name="drive" joint="axis" ctrllimited="true"
      ctrlrange="-80 80"/></actuator></mujoco>"""
    model = folder.with_name("axis.xml")
    model.write_text(axis)
    settings = RunSettings(
        scenario="nominal", controller="pd", model=str(model), reference="multisine", duration=0.5
    )
    return write_run(run_scenario(settings), folder)


def edited(folder, out, edit=lambda columns: {}, end=None):
    """A copy of a run with other samples, or cut off."""
    shutil.copytree(folder, out)
    recording = data.read(folder / "recording.parquet")
    if end is not None:
        recording = recording.between(0.0, end)
    columns = {**recording.columns, **edit(recording.columns)}
    changed = Recording(time=recording.time, columns=columns, metadata=recording.metadata)
    data.write(changed, out / "recording.parquet")
    return out


def named(folder, out):
    """A copy of a run whose controller named its change at 1.2 s and took that back at 1.6 s."""
    shutil.copytree(folder, out)
    metrics = json.loads((out / "metrics.json").read_text())
    name = {"time": 1.2, "onset": 1.0, "fault": "seal_wear", "element": "knee", "size": 9.61}
    name |= {"low": 8.0, "high": 11.0, "confidence": 0.934, "explained": 0.9}
    metrics["events"] = [{"names": [name], "withdrawn": 1.6}]
    (out / "metrics.json").write_text(json.dumps(metrics))
    return out


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Runs by name, most of them made from the first one."""
    base = tmp_path_factory.mktemp("runs")
    pd = make_run(base / "pd", duration=LENGTH)

    def no_error(columns):
        return {"knee_reference": columns["knee_truth"]}

    def pressures(cap, rod):
        def edit(columns):
            level = np.ones_like(columns["knee_truth"])
            return {"knee_pressure_a": cap * BAR * level, "knee_pressure_b": rod * BAR * level}

        return edit

    return {
        "pd": pd,
        "static": make_run(base / "static", "static_feedforward", duration=LENGTH),
        "short": make_run(base / "short", duration=1.2),
        "perfect": edited(pd, base / "perfect", no_error),
        "cap": edited(pd, base / "cap", pressures(160.0, 0.0)),
        "rod": edited(pd, base / "rod", pressures(0.0, 160.0)),
        "half": edited(pd, base / "half", end=0.8),
        "named": named(pd, base / "named"),
        "dark": make_dark(base / "dark"),
    }


def test_slow_wear_is_told_as_it_was_said_then(runs, tmp_path):
    wear = {"fault": "seal_wear", "element": "knee", "since": 0.1, "time": 0.5, "seen": 1.9}
    wear |= {"size": 4.0, "remaining": 60.0, "confidence": 1.0, "explained": 0.9}

    def looks(columns):
        time = np.linspace(0.0, LENGTH, len(columns["knee_truth"]))
        parts = [time < 0.5, time < 1.0]
        return {
            "knee_health_fault": np.select(parts, [0.0, 1.0], 1.0),
            "knee_health_size": np.select(parts, [0.0, 2.0], 4.0),
            "knee_health_remaining": np.select(parts, [np.nan, np.nan], 60.0),
        }

    folder = edited(runs["pd"], tmp_path / "wear", looks)
    metrics = json.loads((folder / "metrics.json").read_text())
    condition = {**wear, "fault": "oil_temperature", "element": "hip", "condition": True}
    metrics["health"] = [wear, condition]
    (folder / "metrics.json").write_text(json.dumps(metrics))
    first, last, other = load_track(folder).named
    assert (first.text, last.text) == (
        "slowly: knee seal wear 2",
        "slowly: knee seal wear 4, left 1 min",
    )
    assert first.start == pytest.approx(0.5, abs=0.01)
    assert first.end == last.start == pytest.approx(1.0, abs=0.01)
    assert last.end == np.inf
    # What the recording does not follow stands as it was at the end.
    assert other.text == "slowly until 2 s: hip oil temperature 4, left 1 min"


@pytest.fixture(scope="module")
def stills(runs, tmp_path_factory):
    """Frames, (times, 720, 1280, 3), by name; all drawn by one process."""
    span = [0.0, LENGTH]
    jobs = {
        "pd": (["pd"], span, [0.9, 1.1]),
        "seconds": (["pd"], span, [0.0, 1.0]),
        "perfect": (["perfect"], span, [0.9]),
        "chambers": (["cap", "rod"], span, [0.5]),
        "dark": (["dark"], [0.0, 0.5], [0.3]),
        "named": (["named"], span, [1.15, 1.3, 1.7]),
        "mixed": (["pd", "static", "half", "short"], span, [0.5, 1.5]),
    }
    out = tmp_path_factory.mktemp("stills") / "frames.npz"
    asked = {k: ([str(runs[n]) for n in names], *rest) for k, (names, *rest) in jobs.items()}
    env = {**os.environ, "MUJOCO_GL": "egl", "LP_NUM_THREADS": "0"}
    command = [sys.executable, "-m", "tests.helpers.film_stills", json.dumps(asked), str(out)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {name: frames.astype(int) for name, frames in np.load(out).items()}


@pytest.fixture
def ffmpeg(tmp_path, monkeypatch):
    """Puts a script in the place of ffmpeg."""

    def put(script):
        other = tmp_path / "ffmpeg"
        other.write_text(f"#!/bin/bash\n{script}\n")
        other.chmod(0o755)
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(other))

    return put


def encode(path, frame):
    with encoding(path, (320, 240), 30) as write:
        for _ in range(60):
            write(frame)


def like(frame, color, tolerance=40):
    """Number of pixels of a colour, (red, green, blue) in 0..255."""
    return int((np.abs(frame - np.asarray(color)).max(axis=-1) < tolerance).sum())


def inside(frame, index, count):
    panel = look.panels(count)[index]
    return frame[panel.top : panel.bottom, panel.left : panel.right]


def test_a_film_plays_anywhere(runs, tmp_path):
    shares = []
    path = render_film(
        [runs["pd"], runs["static"]],
        tmp_path / "new" / "film.mp4",
        start=0.9,
        duration=0.4,
        progress=shares.append,
    )
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(720, 1280, 3).astype(int) for frame in reader]
    assert (meta["size"], meta["codec"], meta["fps"]) == ((1280, 720), "h264", 30.0)
    assert meta["pix_fmt"].startswith("yuv420p")
    assert len(frames) == 12
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # the index comes first
    for index in range(2):
        before, after = (inside(frame, index, 2) for frame in (frames[0], frames[-1]))
        assert np.abs(after - before).max() > 50  # the shank moves
        assert like(after, ALARM) > like(before, ALARM) + 2000  # the change is marked
    assert [entry.name for entry in path.parent.iterdir()] == ["film.mp4"]


@pytest.mark.slow("films")
def test_the_ghost_shows_where_the_reference_differs(stills):
    tint = 255 * np.array(GHOST[:3])

    def bluish(frame):
        red, _, blue = np.moveaxis(inside(frame, 0, 1), -1, 0)
        return int((blue - red > 0.35 * (tint[2] - tint[0])).sum())

    with_error, without = bluish(stills["pd"][0]), bluish(stills["perfect"][0])
    assert with_error > 1000
    assert without < 0.1 * with_error


def test_a_model_without_lights_is_not_dark(stills):
    picture = inside(stills["dark"][0], 0, 1)[look.HEADING + 4 :]
    bright = picture.max(axis=-1)
    assert np.percentile(bright, 1) > 60  # the box; by MuJoCo's lamp alone it has 50
    assert np.median(bright) > 150  # the sky


def test_the_chambers_have_the_colour_of_their_pressures(stills):
    """The cap side is above the rod side; what is high in one panel is low in the other."""
    high, low = (255 * pressure_color(level) for level in (1.0, 0.0))
    rows = {}
    for index, name in enumerate(("cap", "rod")):
        panel = look.panels(2)[index]
        # Without the gauges, which show the pressures as well.
        picture = inside(stills["chambers"][0], index, 2)[:, 150 : panel.width - 180]
        for level, color in (("high", high), ("low", low)):
            near = np.abs(picture - color).max(axis=-1) < 60
            assert near.sum() > 30, (name, level)
            rows[name, level] = np.flatnonzero(near.any(axis=1)).mean()
    assert rows["cap", "high"] < rows["cap", "low"]
    assert rows["rod", "high"] > rows["rod", "low"]


def test_the_change_is_marked_when_it_comes(stills):
    before, after = stills["pd"]
    assert like(inside(before, 0, 1), ALARM, 8) < 50
    assert like(inside(after, 0, 1), ALARM, 8) > 2000
    traces = slice(720 - look.TRACES, 720)
    assert like(after[traces], ALARM, 10) > like(before[traces], ALARM, 10) + 100


def test_a_name_is_shown_while_it_stands(runs, stills):
    (name,) = load_track(runs["named"]).named
    assert (name.start, name.end) == (1.2, 1.6)
    assert name.text == "named: knee seal wear 9.61, 93 %"
    assert load_track(runs["pd"]).named == ()
    # Below the change's own tag, before its cylinders are reached.
    earlier, standing, gone = (
        like(inside(frame, 0, 1)[40:110, :400], look.NAMED, 8) for frame in stills["named"]
    )
    assert standing > 1000
    assert max(earlier, gone) < 100


def test_a_run_that_is_over_says_so(stills):
    running, over = stills["mixed"]
    for index, ended in enumerate((False, False, True, True)):
        # Above the gauges; a veil lies over what a run that is over leaves behind.
        parts = [inside(frame, index, 4)[120:240] for frame in (running, over)]
        veiled = float(np.median(parts[1].min(axis=-1))) > 215
        assert veiled == ended, index
        assert float(np.median(parts[0].min(axis=-1))) < 215
    stopped, finished = (inside(over, index, 4)[150:220, 20:-20] for index in (2, 3))
    assert like(stopped, ALARM, 8) > 300  # "stopped at 0.80 s"
    assert like(finished, ALARM, 8) == 0  # "run ends at 1.20 s"


def test_seal_leakage_is_that_of_the_machine(runs):
    leakage = load_track(runs["pd"]).seal_leakage()
    times = load_track(runs["pd"]).recording.time
    assert leakage[times < CHANGE - 1e-3] == pytest.approx(1.0)
    assert leakage[times > CHANGE + 1e-2] == pytest.approx(10.0)


@pytest.mark.slow("films")
def test_frames_do_not_depend_on_the_process_that_draws_them(runs, stills):
    job = {"folders": [str(runs["pd"])], "camera": "three_quarter"}
    job |= {"start": 0.0, "last": LENGTH, "frames": 2, "rate": 1.0}
    frames = list(draw_frames(job, backend="egl", count=2))
    for frame, expected in zip(frames, stills["seconds"], strict=True):
        assert np.array_equal(np.frombuffer(frame, np.uint8).reshape(720, 1280, 3), expected)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": 9.0}, r"start = 9 s; allowed: within the runs, 0 to 2 s"),
        ({"start": -1.0}, r"start = -1 s; allowed"),
        ({"duration": 0.0}, r"duration = 0 s; allowed: more than 0"),
        ({"camera": "sied"}, r"unknown camera 'sied'.*side.*did you mean 'side'"),
    ],
)
def test_what_cannot_be_shown_is_said(runs, tmp_path, options, message):
    with pytest.raises(LeglabError, match=message):
        render_film([runs["pd"]], tmp_path / "film.mp4", **options)
    assert not list(tmp_path.iterdir())


def test_too_many_runs_are_refused(runs, tmp_path):
    with pytest.raises(LeglabError, match=r"5 runs side by side; allowed: 1 to 4"):
        render_film([runs["pd"]] * 5, tmp_path / "film.mp4")


def test_damaged_folders_are_named(runs, tmp_path):
    out = tmp_path / "film.mp4"
    with pytest.raises(LeglabError, match=r"'nowhere' is not the folder of a run: it has no run"):
        render_film(["nowhere"], out)
    for name, content, message in (
        ("run.json", b"{", r"run\.json: cannot be read"),
        (
            "run.json",
            b'{"settings": {}, "window": 1.0}',
            r"run\.json: it has no settings with model, scenario, controller",
        ),
        ("run.json", b'{"settings": {}}', r"run\.json: window: field required"),
        ("recording.parquet", b"PAR1", r"recording\.parquet"),
    ):
        folder = tmp_path / "run"
        shutil.copytree(runs["pd"], folder)
        (folder / name).write_bytes(content)
        with pytest.raises(LeglabError, match=message):
            render_film([folder], out)
        shutil.rmtree(folder)
    assert not out.exists()


def test_a_missing_library_is_said_with_the_line_that_installs_it(runs, tmp_path, monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "none")  # which neither EGL nor OSMesa accepts
    with pytest.raises(LeglabError, match=r"egl .*osmesa .*apt-get install -y libegl1") as error:
        render_film([runs["pd"]], tmp_path / "film.mp4", duration=0.1)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow("films")
@pytest.mark.skipif(not ctypes.util.find_library("OSMesa"), reason="apt-get install -y libosmesa6")
def test_osmesa_steps_in_for_egl(runs, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "osmesa")  # which EGL does not accept
    out = tmp_path / "film.mp4"
    main(["video", str(runs["pd"]), "--out", str(out), "--duration", "0.1", "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert printed["film"] == str(out)
    assert printed["bytes"] == out.stat().st_size > 5000


def test_a_full_disk_is_said(tmp_path, ffmpeg):
    # The real one, which writes to a device that is full.
    ffmpeg(f'exec {imageio_ffmpeg.get_ffmpeg_exe()} "${{@:1:$#-1}}" -f mp4 /dev/full')
    noise = np.random.default_rng(0).integers(0, 255, 3 * 320 * 240, np.uint8).tobytes()
    with pytest.raises(LeglabError, match=r"film\.mp4: cannot be written: no space left"):
        encode(tmp_path / "film.mp4", noise)
    assert [entry.name for entry in tmp_path.iterdir()] == ["ffmpeg"]


@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("exec sleep 60", "ffmpeg took nothing for 0.5 s"),
        ("cat >/dev/null", "ffmpeg wrote nothing"),
    ],
)
def test_an_encoder_that_hangs_or_writes_nothing_is_said(tmp_path, monkeypatch, ffmpeg, does, said):
    ffmpeg(does)
    monkeypatch.setattr("leglab.report.film.encoder._PATIENCE", 0.5)
    with pytest.raises(LeglabError, match=rf"film\.mp4: cannot be encoded: {said}"):
        encode(tmp_path / "film.mp4", bytes(3 * 320 * 240))
    assert [entry.name for entry in tmp_path.iterdir()] == ["ffmpeg"]


def test_a_hanging_ffmpeg_makes_no_picture(tmp_path, monkeypatch, ffmpeg):
    ffmpeg("exec sleep 60")
    monkeypatch.setattr(encoder, "_PATIENCE_OF_A_FILM", 0.3)
    with pytest.raises(LeglabError, match=r"film\.mp4: cannot be encoded: ffmpeg took more than"):
        encoder.still_bytes(tmp_path / "film.mp4")


def test_the_length_of_a_film_is_known(tmp_path):
    encode(tmp_path / "film.mp4", bytes(3 * 320 * 240))
    # The last frame begins a thirtieth of a second before the end.
    assert encoder._seconds(tmp_path / "film.mp4") == pytest.approx(2.0, abs=0.1)


def test_an_encoder_that_lacks_h264_is_said(tmp_path, monkeypatch, ffmpeg):
    ffmpeg("echo \"Unknown encoder 'libx264'\" >&2; exit 1")
    for program, message in (("ffmpeg", "no libx264"), ("none", "no ffmpeg; install one")):
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / program))
        with pytest.raises(LeglabError, match=message):
            encode(tmp_path / "film.mp4", bytes(3 * 320 * 240))
    assert [entry.name for entry in tmp_path.iterdir()] == ["ffmpeg"]


def test_a_place_that_cannot_be_written_to_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(LeglabError, match=r"cannot be written"):
        encode(tmp_path / "file" / "film.mp4", b"")


@pytest.mark.slow("films")
def test_workers_do_not_run_code_of_the_working_folder(runs, tmp_path, monkeypatch):
    for name in ("leglab", "mujoco", "numpy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("open('ran', 'w'); raise SystemExit('ran')")
    monkeypatch.chdir(tmp_path)
    render_film([runs["pd"]], tmp_path / "film.mp4", duration=0.1)
    assert not (tmp_path / "ran").exists()


def test_a_name_ends_where_its_repair_is_told():
    name = {"time": 1.2, "onset": 1.0, "fault": "payload", "element": "all", "size": 6.0}
    name |= {"low": 5.0, "high": 7.0, "confidence": 0.93, "explained": 0.9}
    back = {**name, "time": 3.3, "onset": 3.0, "size": 0.12, "low": 0.0, "undoes": 1.0}
    events = [
        FaultEvent.model_validate({"names": [one], "withdrawn": withdrawn})
        for one, withdrawn in ((name, None), (back, None), ({**name, "onset": 5.0}, 6.0))
    ]
    first, second, third = _named(events)
    assert (first.start, first.end, first.text) == (1.2, 3.3, "named: payload 6, 93 %")
    assert (second.end, second.text) == (np.inf, "named: payload back to 0.12, 93 %")
    assert third.end == 6.0
