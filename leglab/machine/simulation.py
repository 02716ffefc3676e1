"""A model with its data: loading, hydraulic states by name, stepping."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

import leglab.machine.plugin
from leglab.base.errors import ModelError, SettingsError, SimulationError
from leglab.machine.cylinder import Cylinder
from leglab.machine.library import model_path
from leglab.machine.native import NativeActuator, joint_range
from leglab.machine.parameters import Parameter

CYLINDER = "leglab.cylinder"
# Parameters of a cylinder that relate a chamber's pressure to its amount of oil.
_COMPRESSIBILITY = ("bulk_modulus", "entrained_air", "polytropic_index")
# Joint speed [rad/s or m/s] above which a leg simulation counts as diverged.
SPEED_LIMIT = 1e3
# `_LEAST_LEVER`: least lever arm of a cylinder over its largest in the joint's range. `_LOOKED_AT`:
# number of positions in the range at which it is checked.
_LEAST_LEVER, _LOOKED_AT = 1e-3, 9
# A NaN among the numbers of an attribute; MuJoCo warns of it and reports whatever it leads to.
_NAN = re.compile(rb'\b(?!name|class)(\w+)="[-+.\deE\s]*nan\b', re.IGNORECASE)
# Joint types with one coordinate, and whether they slide.
_SLIDES = {int(mujoco.mjtJoint.mjJNT_HINGE): False, int(mujoco.mjtJoint.mjJNT_SLIDE): True}


def load_model(
    model: str | Path,
    *,
    timestep: float | None = None,
    visual: bool = True,
    edit: Callable[[mujoco.MjSpec], None] | None = None,
) -> mujoco.MjModel:
    """Loads a model with the plugins registered.

    Args:
        model: A name from `model_names()` or the path of an MJCF file.
        timestep: Overrides the file's time step [s].
        visual: Whether to keep shapes used for display only; without them the motion is the same
            and takes less time.
        edit: Changes the specification before it is compiled.

    Raises:
        LeglabError: If there is no such model or MuJoCo rejects it; a one-line message.
    """
    if timestep is not None and not (math.isfinite(timestep) and timestep > 0):
        text = f"timestep = {timestep:g} s; allowed: "
        raise SettingsError(text, given=timestep, allowed="more than 0")
    leglab.machine.plugin.load_plugin()
    path = model_path(model)
    spec = None
    if path.is_file() and (found := _NAN.search(content := path.read_bytes())):
        line, name = content[: found.start()].count(b"\n") + 1, found[1].decode()
        text = f"{path.name}, line {line}: attribute {name!r} is NaN; allowed: "
        raise ModelError(text, given="nan", allowed="a finite number")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if timestep is not None:
            spec.option.timestep = timestep
        spec.compiler.discardvisual = not visual
        # A diverged simulation keeps its state for inspection instead of being reset.
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if edit:
            edit(spec)
        compiled = spec.compile()
        mujoco.MjData(compiled)  # the plugins check the compiled model once more
    except (ValueError, mujoco.FatalError) as error:
        raise leglab.machine.plugin.load_error(error, path.name, spec) from error
    return compiled


def actuator_moments(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Returns lever arms of actuators on degrees of freedom [m/rad or 1], (nactuator, nv).

    Of an actuator with several outputs, which leglab does not command, the first output counts.
    """
    moments = np.zeros((data.moment_rownnz.size, model.nv))
    mujoco.mju_sparse2dense(
        moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return moments[model.actuator_outadr]


class Simulation:
    """A model with driven joints, whose parameters and states are accessed by name.

    Args:
        model: The model; every actuator moves one joint and is a `leglab.cylinder` or one of
            MuJoCo's built-in actuators (`leglab.machine.native`).
        keyframe: Name of the keyframe to start from; None for the model's zero position.

    Attributes:
        model: The MuJoCo model.
        data: The MuJoCo data.
        actuators: Names of the actuators, in MuJoCo's order.
        joints: Name of the joint that each actuator drives.
        cylinders: Names of the actuators that are cylinders.
        native: MuJoCo's built-in actuators of the model, by name.
        centre: Control at command 0, (actuators,); 0 for a cylinder.
        half: Change of the control per unit of command, (actuators,); 1 for a cylinder.
        varied: Whether parameters were varied to make a specimen (`leglab.machine.changes`).

    Raises:
        LeglabError: If an actuator is of another kind or moves no joint or several joints, two
            actuators move the same joint, or a cylinder does not fit the range of its joint.
    """

    def __init__(self, model: mujoco.MjModel, *, keyframe: str | None = "home") -> None:
        self.model = model
        self.varied = False
        self.data = mujoco.MjData(model)
        count = model.nactuator
        if not count:
            text = "the model has no actuator; allowed: "
            raise ModelError(text, allowed="one for each driven joint")
        self._elements = leglab.machine.plugin.elements(model)
        mujoco.mj_forward(model, self.data)
        moments = actuator_moments(model, self.data)
        names = [model.actuator(i).name for i in range(count)]
        plugins = self.elements
        own = [plugins.get(name) == CYLINDER for name in names]
        natives = {i: NativeActuator.of(model, i, moments[i]) for i in range(count) if not own[i]}
        self.actuators = tuple(natives[i].name if i in natives else names[i] for i in range(count))
        self.cylinders = tuple(name for name, mine in zip(names, own, strict=True) if mine)
        self.native = {drive.name: drive for drive in natives.values()}
        self.centre, self.half = np.zeros(count), np.ones(count)
        for i, drive in natives.items():
            self.centre[i], self.half[i] = drive.centre, drive.half
        still = [name for name, row in zip(self.actuators, moments, strict=True) if not row.any()]
        if still:
            text = f"actuator {still[0]!r} moves no joint; allowed: "
            raise ModelError(text, given=still[0], allowed="actuators on a hinge or slide joint")
        self._joint_ids = model.dof_jntid[np.abs(moments).argmax(axis=1)]
        self.joints = tuple(model.joint(i).name for i in self._joint_ids)
        for i, joint in enumerate(self.joints):
            if joint in self.joints[:i]:
                first = self.actuators[self.joints.index(joint)]
                both = f"{first!r} and {self.actuators[i]!r}"
                text = f"joint {joint!r} is driven by actuators {both}; allowed: "
                raise ModelError(text, given=joint, allowed="one")
        self.qpos_index = model.jnt_qposadr[self._joint_ids]
        self.dof_index = model.jnt_dofadr[self._joint_ids]
        self.reset(keyframe)
        self._rest = self.position().copy()
        self._check_cylinders()

    def reset(self, keyframe: str | None = "home") -> None:
        """Resets everything, parameters included, to a keyframe of the model.

        Raises:
            LeglabError: If the model has keyframes, but none of this name.
        """
        if keyframe is None or self.model.nkey == 0:
            mujoco.mj_resetData(self.model, self.data)
        else:
            names = [self.model.key(i).name for i in range(self.model.nkey)]
            if keyframe not in names:
                raise SettingsError.unknown("keyframe", keyframe, names)
            mujoco.mj_resetDataKeyframe(self.model, self.data, names.index(keyframe))
        mujoco.mj_forward(self.model, self.data)

    @property
    def elements(self) -> dict[str, str]:
        """Names of all elements with parameters and the plugin each belongs to."""
        return {name: table.plugin for name, (_, table) in self._elements.items()}

    def slot(self, element: str, name: str) -> int:
        """Returns the index in `data.plugin_state` of a parameter or state of an element.

        Raises:
            LeglabError: If the element or the parameter does not exist.
        """
        if element not in self._elements:
            raise SettingsError.unknown("element", element, self._elements)
        address, table = self._elements[element]
        return address + table.entry(name).offset

    def has(self, element: str, name: str) -> bool:
        """Tests whether an element has a parameter or state of this name that takes effect.

        A cylinder on a shared supply uses the supply's pressure, not its own `supply_pressure`.
        """
        _, table = self._elements[element]
        if name == "supply_pressure" and table.plugin == CYLINDER and self._supply_of(element):
            return False
        return name in table.parameters or name in table.states

    @property
    def supply_slot(self) -> int:
        """Index in `data.plugin_state` of the supply pressure [Pa] that the cylinders see."""
        first = self.cylinders[0]
        supply = self._supply_of(first)
        return self.slot(*((supply, "pressure") if supply else (first, "supply_pressure")))

    def slots(self, name: str) -> np.ndarray:
        """Returns the index in `data.plugin_state` of `name` for all cylinders, (cylinders,)."""
        return np.array([self.slot(element, name) for element in self.cylinders], dtype=int)

    def parameter(self, element: str, name: str) -> float:
        """Returns the current value of a parameter or state, in its SI unit."""
        return float(self.data.plugin_state[self.slot(element, name)])

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets a physical parameter of an element from now on.

        When the compressibility of the oil changes, the chambers keep their pressures; their
        amounts of oil are adjusted.

        Raises:
            LeglabError: If element or name do not exist or the value is out of bounds.
        """
        slot = self.slot(element, name)
        table = self._elements[element][1]
        entry = table.entry(name)
        if isinstance(entry, Parameter):
            value = entry.check(value, f"element {element!r}")
        if table.plugin != CYLINDER or name not in _COMPRESSIBILITY:
            self.data.plugin_state[slot] = value
            return
        before = Cylinder(self.cylinder_parameters(element)).native
        self.data.plugin_state[slot] = value
        after = Cylinder(self.cylinder_parameters(element)).native
        for chamber in "ab":
            # An amount N fills the volume N w(p); the volume stays.
            pressure = self.parameter(element, f"pressure_{chamber}")
            ratio = before.relative_volume(pressure) / after.relative_volume(pressure)
            self.data.plugin_state[self.slot(element, f"amount_{chamber}")] *= ratio

    def set_pressures(self, pressure_a: np.ndarray, pressure_b: np.ndarray) -> None:
        """Prescribes all chamber pressures [Pa], each (cylinders,), at the present position.

        Needed after joint positions were set directly, because otherwise the chambers keep their
        amounts of oil, which the jump in position compresses or stretches.
        """
        state = self.data.plugin_state
        state[self.slots("pressure_a")] = pressure_a
        state[self.slots("pressure_b")] = pressure_b
        state[self.slots("amount_a")] = 0.0
        state[self.slots("amount_b")] = 0.0

    def cylinder_parameters(self, actuator: str) -> dict[str, float]:
        """Returns all present parameters of a cylinder, with the present pressure of its supply."""
        address, table = self._elements[actuator]
        values = {
            name: float(self.data.plugin_state[address + parameter.offset])
            for name, parameter in table.parameters.items()
        }
        supply = self._supply_of(actuator)
        if supply:
            values["supply_pressure"] = self.parameter(supply, "pressure")
        return values

    @property
    def hydraulic_joints(self) -> tuple[str, ...]:
        """Joints that cylinders drive, in the order of `cylinders`."""
        pairs = zip(self.joints, self.actuators, strict=True)
        return tuple(joint for joint, name in pairs if name not in self.native)

    def commands(self, control: np.ndarray) -> np.ndarray:
        """Converts controls (..., actuators) to commands in [-1, 1]."""
        return (control - self.centre) / self.half

    def position(self) -> np.ndarray:
        """Returns the true joint positions [rad], (joints,)."""
        return self.data.qpos[self.qpos_index]

    def velocity(self) -> np.ndarray:
        """Returns the true joint velocities [rad/s], (joints,)."""
        return self.data.qvel[self.dof_index]

    @property
    def passive_joints(self) -> dict[str, int]:
        """Indices in qpos of the hinge and slide joints without an actuator, by name."""
        model = self.model
        return {
            model.joint(i).name: int(model.jnt_qposadr[i])
            for i in range(model.njnt)
            if i not in self._joint_ids and int(model.jnt_type[i]) in _SLIDES
        }

    @property
    def slides(self) -> dict[str, bool]:
        """Flags, by joint name: true for a slide joint, false for a hinge."""
        model = self.model
        return {
            model.joint(i).name: _SLIDES[int(model.jnt_type[i])]
            for i in range(model.njnt)
            if int(model.jnt_type[i]) in _SLIDES
        }

    def joint_range(self) -> np.ndarray:
        """Returns lower and upper joint positions [rad], (joints, 2).

        A joint without a range that a native actuator drives gets the default travel of
        `leglab.machine.native` about its initial position.
        """
        ranges = self.model.jnt_range[self._joint_ids]
        for i, name in enumerate(self.actuators):
            if name in self.native:
                ranges[i] = joint_range(self.model, int(self._joint_ids[i]), float(self._rest[i]))
        return ranges

    def levers(self) -> np.ndarray:
        """Returns lever arms on the joints [m/rad], (joints,), > 0 if extension increases q."""
        moments = actuator_moments(self.model, self.data)
        return moments[np.arange(len(self.actuators)), self.dof_index]

    def lever_tables(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tabulates lever arms [m/rad or 1] and actuator lengths [m] over the joint ranges.

        A joint without a range stays at its position; afterwards the pose is restored.

        Args:
            count: Number of positions.

        Returns:
            Joint positions, lever arms and actuator lengths, each (joints, count).
        """
        pose = self.data.qpos.copy()
        low, high = self.joint_range().T
        low, high = np.where(low == high, self.position(), (low, high))
        position = np.linspace(low, high, count, axis=1)
        lever, length = np.empty_like(position), np.empty_like(position)
        for column in range(count):
            # Every cylinder spans one joint alone, so all joints can be moved at once.
            self.data.qpos[self.qpos_index] = position[:, column]
            mujoco.mj_fwdPosition(self.model, self.data)
            lever[:, column] = self.levers()
            length[:, column] = self.data.actuator_length
        self.data.qpos[:] = pose
        mujoco.mj_forward(self.model, self.data)
        return position, lever, length

    def step(self, count: int = 1) -> None:
        """Advances by a number of time steps with the present `data.ctrl`."""
        mujoco.mj_step(self.model, self.data, count)

    def check(self, time: float | None = None, velocity: np.ndarray | None = None) -> None:
        """Raises an error if the simulation has diverged (joint speed at or above `SPEED_LIMIT`).

        Args:
            time: Time of the velocities [s]; None for the present time.
            velocity: Velocities of all degrees of freedom, (nv,); None for the present ones.

        Raises:
            SimulationError: Names the time, the joint and its value.
        """
        velocity = self.data.qvel if velocity is None else velocity
        speed = np.abs(velocity)
        if np.all(speed < SPEED_LIMIT):  # false for NaN as well
            return
        dof = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
        joint = self.model.joint(self.model.dof_jntid[dof]).name
        raise SimulationError(
            f"the simulation blew up at {self.data.time if time is None else time:.6g} s: velocity "
            f"of joint {joint!r} is {velocity[dof]:g}, allowed ",
            given=float(velocity[dof]),
            allowed=f"below {SPEED_LIMIT:g}",
        )

    def _check_cylinders(self) -> None:
        """Rejects cylinders whose anchors do not fit the ranges of their joints.

        Over the joint's range the lever arm must keep its sign, and both chamber volumes must stay
        positive; owing to the dead volumes the piston may go beyond its stroke, into the stops.
        """
        tables = self.lever_tables(_LOOKED_AT) if self.cylinders else ((), (), ())
        rows = zip(self.actuators, self.joints, *tables, strict=False)
        for name, joint, position, lever, length in rows:
            if name in self.native:
                continue
            sheet = self.cylinder_parameters(name)
            unit = "m" if self.slides[joint] else "rad"
            stroke, middle = sheet["stroke"], sheet["mid_length"]
            area_a = np.pi / 4 * sheet["bore"] ** 2
            area_b = area_a - np.pi / 4 * sheet["rod"] ** 2
            extended = length - middle + stroke / 2
            volume = np.minimum(
                sheet["dead_volume_a"] + area_a * extended,
                sheet["dead_volume_b"] + area_b * (stroke - extended),
            )
            worst = int(volume.argmin())
            if volume[worst] <= 0.0:
                raise ModelError(
                    f"cylinder {name!r} with joint {joint!r} at {position[worst]:.3g} {unit}: its "
                    f"anchors are {length[worst]:.4g} m apart; allowed: {middle - stroke / 2:.4g} "
                    f"to {middle + stroke / 2:.4g} m (mid_length {middle:g} m, stroke "
                    f"{stroke:g} m)",
                    given=name,
                )
            signed = lever * np.sign(lever[np.abs(lever).argmax()])
            zero = int(np.abs(lever).argmin())
            if signed.min() <= _LEAST_LEVER * signed.max():
                raise ModelError(
                    f"cylinder {name!r}: its lever arm on joint {joint!r} passes zero near "
                    f"{position[zero]:.3g} {unit}, within the range {position[0]:.3g} to "
                    f"{position[-1]:.3g} {unit}; allowed: anchors, or a range, by which it keeps "
                    "one sign",
                    given=name,
                )

    def _supply_of(self, actuator: str) -> str:
        """Returns the name of a cylinder's supply; empty if the cylinder refers to none."""
        instance = self.model.actuator_plugin[self.model.actuator(actuator).id]
        return leglab.machine.plugin.text_attribute(self.model, instance)  # first: its supply
