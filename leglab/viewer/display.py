"""Display model of the viewer: a copy of the machine with sliders, a ghost and figures."""

from functools import partial

import mujoco
import numpy as np

from leglab.base.errors import LeglabError
from leglab.base.scale import rms
from leglab.machine.simulation import load_model
from leglab.viewer.session import HISTORY, Session

_GHOST = np.array([0.10, 0.45, 0.75, 0.28], dtype=np.float32)
# Maximum number of letters of a label that the control panel shows in full.
LABEL = 13
# The ghost is moved away from the camera by this share of its distance from the camera.
_GHOST_SHIFT = 0.003
_COLOURS = {
    "error": (0.95, 0.45, 0.30),
    "command": (0.85, 0.85, 0.85),
    "feed-forward": (1.0, 0.6, 0.1),
}
# Offset of the displayed time [s]: a time of 0 then means that the viewer was reset by the user.
_NOT_RESET = 1e-9
# Approximate number of points of a line, and number of points of a dash.
_POINTS, _DASH = 200, 4
# Size of a figure as shares of the view's width and height, and minimum size for its text [px].
_SHARE, _LEAST = (0.30, 0.22), (300, 150)


class Display:
    """A copy of the machine for the viewer.

    The machine is not modified: in the copy each slider is an additional actuator without gain.
    The copy takes its state from the machine, and the user's inputs are read from the copy.

    Args:
        session: Session to show.
        model: Name of the model or path of its file.

    Attributes:
        model: The viewer's model.
        data: State of the model; `data.ctrl` holds the commands, then the values of the sliders.
    """

    def __init__(self, session: Session, model: str) -> None:
        self._session = session
        simulation = session.simulation
        self._actuators = simulation.model.nu

        def add_sliders(spec: mujoco.MjSpec, *, short: bool) -> None:
            if short:  # the panel cuts long names; sensors that refer to names are removed
                for sensor in list(spec.sensors):
                    spec.delete(sensor)
                for actuator in spec.actuators:
                    actuator.name = short_label(actuator.name)
            for slider in session.sliders.values():
                actuator = spec.add_actuator(name=slider.label, target=session.joints[0])
                actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
                actuator.gainprm[0] = 0.0
                actuator.ctrllimited = True
                actuator.ctrlrange = [slider.lowest, slider.highest]
            for key in spec.keys:
                key.ctrl = np.zeros(0)

        load = partial(load_model, model, timestep=simulation.model.opt.timestep)
        try:
            self.model = load(edit=partial(add_sliders, short=True))
        except LeglabError:  # another plugin of the model refers to an actuator by its name
            self.model = load(edit=partial(add_sliders, short=False))
        self.data = mujoco.MjData(self.model)
        self._ghost = mujoco.MjData(self.model)
        self._option, self._perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        for flag in (mujoco.mjtVisFlag.mjVIS_TENDON, mujoco.mjtVisFlag.mjVIS_STATIC):
            self._option.flags[flag] = 0
        self.reset_sliders()
        self.show()

    def reset_sliders(self) -> None:
        """Sets the sliders to the session's values."""
        self.data.ctrl[self._actuators :] = list(self._session.values.values())

    def show(self) -> None:
        """Copies the machine's state to the display."""
        source = self._session.simulation.data
        self.data.time = source.time + _NOT_RESET
        for name in ("qpos", "qvel", "act", "plugin_state"):
            getattr(self.data, name)[:] = getattr(source, name)
        self.data.ctrl[: self._actuators] = source.ctrl
        mujoco.mj_forward(self.model, self.data)

    def take_over(self) -> bool:
        """Applies the user's inputs, sliders and pushes, to the machine.

        Returns:
            True if the user reset the viewer, so that the session should restart.
        """
        session = self._session
        if self.data.time != session.simulation.data.time + _NOT_RESET:
            return True
        for name, value in zip(session.sliders, self.data.ctrl[self._actuators :], strict=True):
            session.move(name, float(value))
        self.reset_sliders()  # "Clear all" asks for 0, which is not in every range
        session.simulation.data.xfrc_applied[:] = self.data.xfrc_applied
        return False

    def draw_ghost(self, scene: mujoco.MjvScene, eye: np.ndarray) -> None:
        """Replaces a scene's content by a ghost: the machine with driven joints at the reference.

        The ghost is moved a little away from the camera, which is at `eye` [m], (3,). Otherwise the
        surfaces of ghost and leg would flicker where they coincide.
        """
        ghost, simulation = self._ghost, self._session.simulation
        ghost.qpos[:] = self.data.qpos
        ghost.qpos[simulation.qpos_index] = self._session.point.position
        mujoco.mj_kinematics(self.model, ghost)
        scene.ngeom = 0
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
        mujoco.mjv_addGeoms(self.model, ghost, self._option, self._perturb, moving, scene)
        for geom in scene.geoms[: scene.ngeom]:
            geom.pos[:] += _GHOST_SHIFT * (geom.pos - eye)
            geom.rgba[:] = _GHOST
            geom.matid = -1
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR

    def eye(self, camera: mujoco.MjvCamera) -> np.ndarray:
        """Returns the position of a camera [m], (3,)."""
        if camera.type == mujoco.mjtCamera.mjCAMERA_FIXED:
            return self.data.cam_xpos[camera.fixedcamid]
        turn, rise = np.deg2rad([camera.azimuth, camera.elevation])
        ahead = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        return camera.lookat - camera.distance * ahead

    def figures(self, viewport: mujoco.MjrRect) -> list[tuple[mujoco.MjrRect, mujoco.MjvFigure]]:
        """Returns figures of the RMS error, and of command and feed-forward of the worst joint."""
        moments = list(self._session.moments)[:: -max(len(self._session.moments) // _POINTS, 1)]
        if not moments:
            return []
        now = moments[0].time
        ages = np.array([moment.time - now for moment in moments])
        errors = 1e3 * np.array([moment.error for moment in moments])
        tracking = rms(errors, axis=1)
        worst = int(np.argmax(np.abs(errors).mean(axis=0)))
        command = np.array([moment.command[worst] for moment in moments])
        feedforward = np.array([moment.feedforward[worst] for moment in moments])
        joint = self._session.joints[worst].replace("_", " ")
        title, lines = f"command of {joint}", {"command": command}
        if np.isfinite(feedforward).all():
            title += ", dashed: feed-forward"
            lines["feed-forward"] = feedforward
        sizes = zip(_SHARE, (viewport.width, viewport.height), _LEAST, strict=True)
        width, height = (min(max(round(share * size), least), size) for share, size, least in sizes)
        # The figures are on the right because every machine's camera sees knees bend to the left.
        left, bottom = viewport.left + viewport.width - width, viewport.bottom
        upper = mujoco.MjrRect(left, bottom + height, width, height)
        lower = mujoco.MjrRect(left, bottom, width, height)
        above = f"RMS error [{self._session.unit}], last 10 s", {"error": tracking}
        return [(upper, _figure(ages, *above)), (lower, _figure(ages, title, lines))]

    def texts(self, *, paused: bool) -> tuple[str, str]:
        """Returns two columns of text: names and values."""
        session = self._session
        rows = {"time": f"{session.time:.1f} s", "scenario": session.scenario.name}
        rows["fault"] = "on" if session.fault else "off" if session.scenario.changes else "none"
        rows |= session.named()
        for name, slider in session.sliders.items():
            rows[name.replace("_", " ")] = f"{slider.present():.3g} {slider.unit}"
        recent = list(session.moments)[-round(session.window / session.period) :]
        if recent:
            size = rms([moment.error for moment in recent])
            rows["RMS error"] = f"{1e3 * size:.1f} {session.unit} over {session.window:.2g} s"
        if paused:
            rows["paused"] = "Space goes on"
        if session.failure:
            rows["failed"] = session.failure
        return "\n".join(rows), "\n".join(rows.values())


def short_label(name: str) -> str:
    """Shortens the name of an actuator to fit the control panel."""
    short = name if len(name) <= LABEL else name.removesuffix("_valve")
    return short if len(short) <= LABEL else f"{short[: LABEL - 1]}~"


def _figure(ages: np.ndarray, title: str, lines: dict[str, np.ndarray]) -> mujoco.MjvFigure:
    """Makes a figure of lines over the last `HISTORY` seconds; the first line is solid."""
    figure = mujoco.MjvFigure()
    mujoco.mjv_defaultFigure(figure)
    figure.title = title
    figure.yformat = "%.3g"
    figure.figurergba[:] = (0.1, 0.1, 0.1, 0.6)
    figure.gridsize[:] = (3, 4)
    figure.range[0] = (-HISTORY, 0.0)
    values = np.concatenate(list(lines.values()))
    figure.range[1] = (min(0.0, float(values.min())), max(float(values.max()), 1e-3))
    # MuJoCo draws earlier lines on top, so dashes come first: the solid line shows in their gaps.
    whole, *dashed = lines
    starts = range(0, len(ages), 2 * _DASH)
    pieces = [(name, slice(i, i + _DASH + 1)) for name in dashed for i in starts]
    for i, (name, part) in enumerate([*pieces, (whole, slice(None))]):
        points = np.column_stack([ages[part], lines[name][part]])
        figure.linergb[i] = _COLOURS[name]
        figure.linepnt[i] = len(points)
        figure.linedata[i, : points.size] = points.ravel()
    return figure
