"""The live viewer: the run's bits, sliders that only the session hears, a real window."""

import os
import subprocess
import sys
import textwrap

import mujoco
import numpy as np
import pytest
from PIL import ImageGrab

from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.machine.simulation import load_model
from leglab.viewer.display import LABEL, Display
from leglab.viewer.session import Session
from tests.helpers.pages import ROOT, blocks

KNEE = {"scenario": "seal_wear", "model": "knee_bench", "controller": "pd", "duration": 0.4}
LEAKAGE = ("knee_valve", "internal_leakage")


def session(**settings) -> Session:
    return Session(RunSettings(**{**KNEE, **settings}))


def run_for(live: Session, seconds: float) -> None:
    for _ in range(round(seconds / live.period)):
        live.step()
    assert live.failure == ""


def texts(display: Display) -> dict[str, str]:
    """What the window of a paused run tells."""
    return dict(zip(*(text.split("\n") for text in display.texts(paused=True)), strict=True))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"scenario": "payload", "controller": "adaptive_backstepping", "seed": 2},
        {"model": "leg", "controller": "bsnn_arx", "tolerance": 0.1, "scenario": "cold_oil"},
    ],
    ids=["pd", "backstepping", "bsnn_arx"],
)
def test_untouched_it_is_the_run_bit_for_bit_and_goes_on(settings):
    run = run_scenario(RunSettings(**{**KNEE, **settings}))
    live = session(**settings)
    for _ in range(2):
        run_for(live, 0.4)
        live.step()
        error = np.array([moment.error for moment in live.moments])
        np.testing.assert_array_equal(error, run.history.error)
        command = np.array([moment.command for moment in live.moments])
        np.testing.assert_array_equal(command, run.history.command)
        run_for(live, 2.0)
        assert live.time == pytest.approx(2.402)
        live.restart()


def test_sliders_wear_heat_and_load_the_machine_and_back():
    live = session(scenario="nominal")
    machine, mass = live.simulation, live.simulation.model.body("shank").mass[0]
    nominal = machine.parameter(*LEAKAGE)
    run_for(live, 0.1)
    live.move("seal_wear", 20.0)
    live.move("oil_temperature", 80.0)
    live.move("payload", 5.0)
    assert machine.parameter(*LEAKAGE) == pytest.approx(20 * nominal)
    assert machine.parameter("knee_valve", "oil_temperature") == 80.0
    assert machine.model.body("shank").mass[0] == pytest.approx(mass + 5.0)
    run_for(live, 0.1)
    live.move("seal_wear", 0.0)  # the panel's "Clear all"
    live.move("payload", 0.0)
    assert live.values["seal_wear"] == 1.0
    assert machine.parameter(*LEAKAGE) == nominal
    assert machine.model.body("shank").mass[0] == mass
    assert machine.parameter("knee_valve", "oil_temperature") == 80.0
    live.move("payload", 5.0)
    live.close()
    assert machine.model.body("shank").mass[0] == mass
    with pytest.raises(LeglabError, match="unknown slider 'wear'"):
        live.move("wear", 1.0)


def test_wear_by_hand_costs_tracking():
    live = session(scenario="nominal", model="leg", duration=4.0)
    run_for(live, 2.4)
    before = np.sqrt(np.mean([m.error**2 for m in list(live.moments)[-600:]]))
    live.move("seal_wear", 20.0)
    run_for(live, 1.2)
    after = np.sqrt(np.mean([m.error**2 for m in list(live.moments)[-600:]]))
    assert after > 1.5 * before


def test_the_fault_comes_at_its_time_and_can_be_switched():
    live = session()
    nominal = live.simulation.parameter(*LEAKAGE)

    def ratio() -> float:
        return live.simulation.parameter(*LEAKAGE) / nominal

    run_for(live, 0.19)
    assert (live.fault, ratio()) == (False, 1.0)
    run_for(live, 0.02)
    assert live.fault
    assert ratio() == pytest.approx(10.0)
    live.switch_fault()
    assert (live.fault, ratio()) == (False, 1.0)
    run_for(live, 1.0)
    live.move("seal_wear", 3.0)
    live.switch_fault()
    assert ratio() == pytest.approx(30.0)
    live.restart()
    assert (live.fault, ratio(), live.values["seal_wear"]) == (False, 1.0, 1.0)
    live.switch_fault()
    assert ratio() == pytest.approx(10.0)


def test_a_fault_with_a_ramp_is_followed_from_when_it_is_switched_on():
    live = session(duration=2.0, ramp_duration=0.5)
    nominal = live.simulation.parameter(*LEAKAGE)
    run_for(live, 0.1)
    live.switch_fault()
    live.move("payload", 2.0)  # does not disturb the ramp
    run_for(live, 0.252)
    assert live.simulation.parameter(*LEAKAGE) / nominal == pytest.approx(5.5)


def test_oil_that_warmed_up_stays_warm_when_something_else_is_moved():
    live = session(scenario="cold_start", duration=60.0)
    run_for(live, 1.0)
    warmth = live.simulation.parameter("knee_valve", "oil_temperature")
    assert warmth > 0.0
    live.move("payload", 2.0)
    live.step()
    assert 0.0 < warmth <= live.simulation.parameter("knee_valve", "oil_temperature")


@pytest.mark.parametrize("name", ["leg", "leg_rail", "knee_bench"])
def test_sliders_do_not_touch_the_physics_of_the_viewers_model(name):
    live = session(scenario="nominal", model=name)
    shown = Display(live, name).model
    plain = load_model(name)
    assert shown.nu == plain.nu + 3
    states = []
    for model in (plain, shown):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
        data.ctrl[plain.nu :] = [30.0, 100.0, 20.0][: model.nu - plain.nu]
        for k in range(300):
            data.ctrl[: plain.nu] = 0.1 * np.sin(0.05 * k)
            mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel, data.plugin_state]))
    np.testing.assert_array_equal(*states)
    assert np.ptp(states[0]) > 0


def test_the_display_shows_the_machine_and_hears_sliders_pushes_and_resets():
    live = session(scenario="nominal")
    display = Display(live, "knee_bench")
    assert not display.take_over()
    mujoco.mj_resetData(display.model, display.data)
    assert display.take_over()  # at time 0 too: the sliders are not the user's
    display.reset_sliders()
    run_for(live, 0.2)
    display.show()
    np.testing.assert_array_equal(display.data.qpos, live.simulation.data.qpos)
    assert display.data.ctrl[0] == live.simulation.data.ctrl[0]
    assert not display.take_over()
    assert live.values["seal_wear"] == 1.0
    display.data.ctrl[1] = 12.0
    display.data.xfrc_applied[1, 2] = 5.0
    assert not display.take_over()
    assert live.values["seal_wear"] == 12.0
    assert live.simulation.data.xfrc_applied[1, 2] == 5.0
    mujoco.mj_resetData(display.model, display.data)
    assert display.take_over()


def test_the_ghost_stands_at_the_reference():
    live = session(scenario="nominal", model="leg")
    display = Display(live, "leg")
    scene = mujoco.MjvScene(display.model, 2000)
    eye = np.array([2.0, -1.0, 1.0])
    display.draw_ghost(scene, eye)
    at_rest = np.array([geom.pos for geom in scene.geoms[: scene.ngeom]])
    run_for(live, 0.6)
    display.draw_ghost(scene, eye)
    moved = np.array([geom.pos for geom in scene.geoms[: scene.ngeom]])
    assert len(moved) > 20
    assert 0.05 < np.abs(moved - at_rest).max() < 1.0
    assert all(geom.rgba[3] < 0.5 for geom in scene.geoms[: scene.ngeom])


def test_a_ghost_on_the_leg_lies_behind_its_surface_and_does_not_flicker():
    live = session(scenario="nominal", model="leg")
    display = Display(live, "leg")
    scene = mujoco.MjvScene(display.model, 2000)
    live.point = live.point._replace(position=live.simulation.position())  # no error at all
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = 130.0, -20.0, 2.5
    camera.lookat[:] = 0.1, 0.2, 0.6
    plain = mujoco.MjvScene(display.model, 2000)
    option = mujoco.MjvOption()
    mujoco.mjv_updateScene(
        display.model, display.data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, plain
    )
    eye = display.eye(camera)
    np.testing.assert_allclose(eye, np.mean([e.pos for e in plain.camera], axis=0), atol=1e-6)
    display.draw_ghost(scene, eye)
    for ghost in scene.geoms[: scene.ngeom]:
        if ghost.objtype != mujoco.mjtObj.mjOBJ_GEOM:
            continue
        place = display.data.geom_xpos[ghost.objid]
        farther = np.linalg.norm(ghost.pos - eye) - np.linalg.norm(place - eye)
        assert 1e-3 < farther < 0.02
        along = (ghost.pos - eye) / np.linalg.norm(ghost.pos - eye)
        np.testing.assert_allclose(along, (place - eye) / np.linalg.norm(place - eye), atol=1e-6)


@pytest.mark.parametrize("name", ["leg", "leg_rail", "knee_bench"])
def test_labels_fit_into_the_panel_and_differ(name):
    model = Display(session(scenario="nominal", model=name), name).model
    labels = [model.actuator(i).name for i in range(model.nu)]
    assert all(len(label) <= LABEL for label in labels)
    assert len(set(labels)) == len(labels)
    assert labels[-3:] == ["seal leak x", "oil degC", "payload kg"]


def test_texts_and_figures_say_what_happens():
    live = session()
    display = Display(live, "knee_bench")
    run_for(live, 0.3)
    assert texts(display)["fault"] == "on"
    assert texts(display)["seal wear"] == "10 x leakage"  # the scenario's, the slider stands at 1
    live.move("seal_wear", 3.0)
    live.move("payload", 2.0)
    live.move("oil_temperature", 60.0)
    shown = texts(display)
    assert shown["seal wear"] == "30 x leakage"
    assert shown["payload"] == "2 kg on shank"
    assert shown["oil temperature"] == "60 deg C"
    assert "paused" in shown
    assert "".join(shown.values()).isascii()  # the viewer's font has no more
    (_, error), (_, command) = display.figures(mujoco.MjrRect(0, 0, 1000, 700))
    assert error.linepnt[0] > 100
    worst = 1e3 * max(abs(moment.error[0]) for moment in live.moments)
    drawn = error.linedata[0, 1 : 2 * error.linepnt[0] : 2]
    assert drawn.max() == pytest.approx(worst, rel=0.05)
    assert command.linedata[0, 1] == pytest.approx(live.moments[-1].command[0])


@pytest.mark.parametrize("name", ["leg", "knee_bench"])
def test_figures_do_not_cover_the_machine_however_its_joints_bend(name):
    live = session(model=name)
    display = Display(live, name)
    run_for(live, 0.3)
    view = mujoco.MjrRect(0, 0, 1280, 720)
    model, data = display.model, display.data
    camera = model.camera("three_quarter").id
    focus = 0.5 * view.height / np.tan(0.5 * np.deg2rad(model.cam_fovy[camera]))
    moving = [i for i in range(model.ngeom) if model.body_weldid[model.geom_bodyid[i]]]
    figures = [rect for rect, _ in display.figures(view)]
    assert moving
    for joint in live.joints:
        for angle in np.linspace(*model.joint(joint).range, 7):
            display.show()
            data.joint(joint).qpos[0] = angle
            mujoco.mj_forward(model, data)
            seen = (data.geom_xpos[moving] - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(
                3, 3
            )
            x = 0.5 * view.width + focus * seen[:, 0] / -seen[:, 2]
            y = 0.5 * view.height + focus * seen[:, 1] / -seen[:, 2]
            for rect in figures:
                within = (x > rect.left) & (x < rect.left + rect.width)
                within &= (y > rect.bottom) & (y < rect.bottom + rect.height)
                assert not within.any(), f"{joint} at {angle:.2f}"


def test_the_feed_forward_is_dashed_over_the_command_that_it_equals():
    live = session(controller="static_feedforward")
    display = Display(live, "knee_bench")
    run_for(live, 0.3)
    _, (_, figure) = display.figures(mujoco.MjrRect(0, 0, 1000, 700))
    count = sum(points > 0 for points in figure.linepnt)
    *dashes, command = range(count)
    assert len(dashes) > 10
    # MuJoCo draws the first line over the others, and each ends before the next begins.
    starts = [figure.linedata[i, 0] for i in dashes]
    ends = [figure.linedata[i, 2 * figure.linepnt[i] - 2] for i in dashes]
    assert all(end > start for end, start in zip(ends, starts[1:], strict=False))
    assert figure.linepnt[command] > 100
    assert not np.allclose(figure.linergb[0], figure.linergb[command], atol=0.3)
    assert "dashed: feed-forward" in figure.title


def test_texts_say_what_the_controller_names():
    live = session(controller="bsnn_arx_bank", duration=16.0)
    display = Display(live, "knee_bench")
    run_for(live, 7.9)
    assert "named" not in texts(display)
    run_for(live, 0.6)
    assert texts(display)["named"].startswith("seal wear 1")  # ten times, more or less
    assert texts(display)["named"].isascii()


def test_a_blow_up_stops_with_its_reason_and_restart_mends_it():
    live = session()
    live.simulation.data.qvel[:] = 1e9
    live.step()
    assert "blew up" in live.failure
    time = live.time
    live.step()
    assert live.time == time
    live.restart()
    run_for(live, 0.1)


@pytest.mark.parametrize("display", [None, ":987"])
def test_without_a_display_one_line_names_the_way(display):
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    if display:
        environment["DISPLAY"] = display
    result = subprocess.run(
        [sys.executable, "-m", "leglab", "view", "seal_wear"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert "DISPLAY" in line
    assert "leglab video" in line


_WINDOW = """
    import sys, time
    import numpy as np
    from leglab import RunSettings
    from leglab.viewer.session import Session
    from leglab.viewer.window import ENTER, SPACE, Window

    live = Session(RunSettings(scenario="seal_wear", model="knee_bench", duration=1000.0))
    window = Window(live, "knee_bench")
    assert window.handle.is_running()
    window.run(3.0)
    nominal = live.simulation.parameter("knee_valve", "internal_leakage")
    assert live.time > 0.05 and not live.fault
    assert window.handle.user_scn.ngeom > 0
    window.display.data.ctrl[1] = 20.0
    window.run(3.0)
    assert window.display.data.ctrl[1] == 20.0
    worn = live.simulation.parameter("knee_valve", "internal_leakage")
    assert abs(worn / nominal - 20.0) < 1e-9, worn / nominal
    for key in (ENTER, SPACE):
        window._keys.put(key)
    window.frame(0.1)
    assert live.fault
    paused = live.time
    window.frame(0.1)
    assert live.time == paused
    window._keys.put(SPACE)
    window.frame(0.1)
    assert live.time > paused
    print("ready", flush=True)
    while sys.stdin.readline().strip() != "end":
        window.frame(0.01)
    window.close()
    print("closed")
"""


@pytest.mark.slow("a real window")
def test_a_real_window_hears_slider_and_keys(screen):
    environment = {**os.environ, "DISPLAY": screen, "MUJOCO_GL": "glfw"}
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(_WINDOW)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        ready = process.stdout.readline().strip()
        if ready == "ready":
            picture = np.asarray(ImageGrab.grab(xdisplay=screen))
            assert picture.std() > 20  # a picture, not an empty window
        out, err = process.communicate("end\n", timeout=120)
    finally:
        process.kill()
    assert ready == "ready", err
    assert "closed" in out, err


def test_names_that_a_plugin_refers_to_stay(tmp_path):
    found = blocks((ROOT / "docs/guides/model.md").read_text())
    text = next(block.text for block in found if block.file == "boom.xml")
    name = "lifting_boom_valve"
    learned = f'<instance name="rest"><config key="cylinder" value="{name}"/></instance>'
    text = text.replace("lift_valve", name).replace(
        "</extension>", f'<plugin plugin="leglab.residual">{learned}</plugin></extension>'
    )
    path = tmp_path / "boom.xml"
    path.write_text(text)
    settings = RunSettings(
        scenario="nominal", model=str(path), controller="pd", reference="sine_sweep"
    )
    model = Display(Session(settings), str(path)).model
    assert model.actuator(0).name == name
    assert model.nu == 4
