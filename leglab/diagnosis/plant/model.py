"""The machine under diagnosis: its model, compiled variants, and indices of parameters."""

import math
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from threading import Lock

import mujoco
import numpy as np

import leglab.machine.plugin
from leglab.base.errors import ModelError, SettingsError
from leglab.diagnosis.plant.activation import stateful, unusable
from leglab.diagnosis.plant.as_compiled import AsCompiled
from leglab.diagnosis.plant.followers import Followers, determined
from leglab.diagnosis.plant.hidden_states import HiddenStates
from leglab.diagnosis.plant.paths import CommandPath, Correction, take_out
from leglab.diagnosis.thresholds import NEGLIGIBLE
from leglab.machine.files import changed_meanwhile, model_digest
from leglab.machine.library import model_path
from leglab.machine.parameters import Parameter, PluginTable, plugin_tables
from leglab.machine.sensors import CHAMBERS as CHAMBERS
from leglab.machine.simulation import actuator_moments

CYLINDER = "leglab.cylinder"
FRICTION = "leglab.joint_friction"
SPRING = "leglab.spring_damper"
SUPPLY = "leglab.supply"

Edit = tuple[Hashable, Callable[[mujoco.MjSpec], None]]
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_KINDS = {int(mujoco.mjtJoint.mjJNT_FREE): "free", int(mujoco.mjtJoint.mjJNT_BALL): "ball"}
_WAY_OUT = {
    int(mujoco.mjtJoint.mjJNT_FREE): "hinges and slides; --fix-base holds the base where the model "
    "has it",
    int(mujoco.mjtJoint.mjJNT_BALL): "hinges and slides, three hinges in place of a ball",
}
_OFF = mujoco.mjtDisableBit
_CACHED_VARIANTS = 64
# Lock by which only one model is compiled at a time.
_COMPILING = Lock()
# Share of the largest moment (or inertia) below which a value is a rounding error; see `moved`.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Variant:
    """A compiled model with the indices and initial values of its plugin states."""

    model: mujoco.MjModel  #: Compiled at the replay's time step
    #: First index in `plugin_state`, and parameter table, of every plugin instance by name.
    elements: dict[str, tuple[int, PluginTable]]
    joint_of: dict[str, str]  #: Joint that a passive plugin instance acts on, by instance
    drawn_by: dict[str, tuple[str, ...]]  #: Cylinders fed by each supply instance
    plugin_state: np.ndarray  #: Parameters and initial states after a reset, (npluginstate,)

    def slot(self, element: str, name: str) -> int:
        """Returns the index in `plugin_state` of a parameter or state.

        Raises:
            LeglabError: If the element or the parameter does not exist.
        """
        if element not in self.elements:
            raise SettingsError.unknown("element", element, self.elements)
        start, table = self.elements[element]
        return start + table.entry(name).offset


class Machine:
    """An MJCF model whose hinge and slide joints are measured.

    `path` is a file, or the name of a model that ships with leglab. The default `timestep` [s] is
    the file's. Positions of the joints `followers` are computed from the other joints' positions.
    If `fix_base`, free joints are removed, so that the base stays at its pose in the model.

    Raises:
        LeglabError: If the model cannot be loaded or has free or ball joints.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        timestep: float | None = None,
        followers: Collection[str] = (),
        fix_base: bool = False,
    ) -> None:
        leglab.machine.plugin.load_plugin()
        self.path, self.fix_base = model_path(path), fix_base
        try:
            self._spec = mujoco.MjSpec.from_file(str(self.path))
            self._as_compiled = AsCompiled(self._spec)
            if fix_base:
                take_free_joints_out(self._spec)
        except (ValueError, mujoco.FatalError) as error:
            raise leglab.machine.plugin.load_error(error, self.path.name) from error
        self._digest = model_digest(self.path)
        self.file_timestep = float(self._spec.option.timestep)
        self.timestep = timestep or self.file_timestep
        #: Command paths and sensor corrections in the file; variants do not contain them.
        self.carried = take_out(self._spec)
        self._variants: OrderedDict[Hashable, Variant] = OrderedDict()
        self._full_names: dict[tuple[str, str], str] = {}
        self.base = self.variant(())  #: the unmodified model
        if names := leglab.machine.plugin.full_names(self.base.model):
            self._full_names = names
            self._spec = self.spec()
            self.carried = take_out(self._spec)
            self._variants.clear()
            self.base = self.variant(())
        model = self.base.model
        #: Names of all joints, by number.
        self.all_joints = tuple(model.joint(i).name for i in range(model.njnt))
        self._check_joints()
        #: Joints that equality constraints determine; None if all joints are measured.
        self.followers = Followers(model, self.all_joints, followers) if followers else None
        led = self.followers.leading if self.followers else {}
        #: Joints that are measured.
        self.joints = tuple(joint for joint in self.all_joints if joint not in led)
        self.actuators = tuple(model.actuator(i).name for i in range(model.nactuator))
        self._check_actuators()
        #: Actuators with an activation, in the order of MuJoCo's `act`.
        self.stateful = tuple(self.actuators[i] for i in stateful(model))
        data = mujoco.MjData(model)
        # The pose differs from qpos0, because at a singular pose (straight linkage) moments vanish.
        data.qpos[:] = model.qpos0 + 0.1
        mujoco.mj_forward(model, data)
        self.moments = actuator_moments(model, data)  #: of actuators near qpos0, (nu, nv)
        #: Measured joints that each actuator moves according to its moments, by actuator.
        self.driven = {}
        for name, row in zip(self.actuators, self.moments, strict=True):
            own = [self.all_joints[int(model.dof_jntid[k])] for k in moved(row)]
            self.driven[name] = tuple(dict.fromkeys(x for j in own for x in led.get(j, (j,))))
        self.cylinders = self.instances(CYLINDER)
        self.on_cylinders = frozenset(j for c in self.cylinders for j in self.driven[c])

    def _check_joints(self) -> None:
        """Raises `ModelError` if no column can measure a joint."""
        model = self.base.model
        for number, kind in enumerate(model.jnt_type):
            joint, body = self.all_joints[number], model.body(model.jnt_bodyid[number]).name
            called = repr(joint) if joint else f"{number} (without a name, of body {body!r})"
            if kind not in (_HINGE, _SLIDE):
                raise ModelError(
                    f"{self.path.name}: joint {called} is a {_KINDS[kind]} joint, whose pose no "
                    f"column measures; allowed: {_WAY_OUT[kind]}",
                    given=joint,
                    allowed=("hinge", "slide"),
                )
            if not joint:
                text = f"{self.path.name}: joint {called} is measured by no column: they go by "
                raise ModelError(f"{text}name; allowed: ", given=number, allowed='name="..."')

    def _check_actuators(self) -> None:
        """Raises `ModelError` if an actuator has no name, or replays cannot command it."""
        for number, actuator in enumerate(self.actuators):
            if not actuator:
                text = f"{self.path.name}: actuator {number} has no name, and commands go by it; "
                raise ModelError(f"{text}allowed: ", given=number, allowed='name="..."')
            if why := unusable(self.base.model, number):
                text = f"{self.path.name}: actuator {actuator!r} {why}"
                raise ModelError(text, given=actuator)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that a recording of the machine must have."""
        positions = tuple(f"{joint}_position" for joint in self.joints)
        return positions + tuple(f"{actuator}_command" for actuator in self.actuators)

    def unit(self, joint: str) -> str:
        """Returns the unit of a joint's position: "rad" for a hinge, "m" for a slide."""
        return "rad" if self.base.model.joint(joint).type[0] == _HINGE else "m"

    def at_timestep(self, timestep: float) -> "Machine":
        """Returns the machine with another time step [s]."""
        return self._with(timestep, self.follower_names)

    def _with(self, timestep: float, followers: Collection[str]) -> "Machine":
        found = Machine(self.path, timestep=timestep, followers=followers, fix_base=self.fix_base)
        if found._digest != self._digest:
            raise changed_meanwhile(self.path)
        return found

    @property
    def follower_names(self) -> tuple[str, ...]:
        """Joints that are not measured, since equality constraints determine them."""
        return self.followers.names if self.followers else ()

    @property
    def leading(self) -> frozenset[str]:
        """Joints that move followers."""
        led = self.followers.leading.values() if self.followers else ()
        return frozenset(joint for each in led for joint in each)

    def measured_by(self, columns: Collection[str]) -> "Machine":
        """Returns the machine with unmeasured joints as followers if equalities determine them."""
        absent = {j for j in self.all_joints if f"{j}_position" not in columns}
        found = determined(self.base.model, self.all_joints, absent)
        same = found == set(self.follower_names)
        return self if same else self._with(self.timestep, found)

    def spec(self, *, whole: bool = False) -> mujoco.MjSpec:
        """Returns a new specification of the model, read from the file.

        Values that the compiler derives from inertia are fixed, see `AsCompiled`. If `whole`, free
        joints that `fix_base` removes are kept. An actuator without a name gets its joint's name,
        and names in plugin settings get the prefix of an attached model.

        Raises:
            LeglabError: The model's files have changed since they were read.
        """
        if model_digest(self.path) != self._digest:
            raise changed_meanwhile(self.path)
        # MjSpec.copy() of MuJoCo 3.17.0 loses passive plugin instances.
        spec = mujoco.MjSpec.from_file(str(self.path))
        self._as_compiled.keep(spec)
        names = {actuator.name for actuator in spec.actuators}
        for actuator in spec.actuators:
            on_joint = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
            if not actuator.name and on_joint and actuator.target not in names:
                actuator.name = actuator.target
                names.add(actuator.target)
        plugins = {
            **{a.name: a.plugin for a in spec.actuators},
            **{p.name: p for p in spec.plugins},
        }
        for (owner, attribute), name in self._full_names.items():
            plugins[owner].config = {**plugins[owner].config, attribute: name}
        if self.fix_base and not whole:
            take_free_joints_out(spec)
        return spec

    def instances(self, plugin: str) -> tuple[str, ...]:
        """Returns the instances of a plugin in the model; a cylinder has its actuator's name."""
        return tuple(name for name, (_, t) in self.base.elements.items() if t.plugin == plugin)

    def native_actuators(self) -> tuple[str, ...]:
        """Returns the names of the actuators that are not plugins."""
        model = self.base.model
        return tuple(name for i, name in enumerate(self.actuators) if model.actuator_plugin[i] < 0)

    def parameter(self, element: str, name: str) -> float:
        """Returns the value of a plugin parameter in the unmodified model."""
        return float(self.base.plugin_state[self.base.slot(element, name)])

    def moment(self, actuator: str, joint: str) -> float:
        """Returns the moment of an actuator on a joint near qpos0 [m, or 1 on a slide]."""
        dof = self.base.model.joint(joint).dofadr[0]
        return float(self.moments[self.actuators.index(actuator), dof])

    def instance_on(self, plugin: str, attribute: str, target: str) -> str | None:
        """Returns a plugin's first instance whose `attribute` ("joint", "actuator") is `target`."""
        of_it = (one for one in self._spec.plugins if one.plugin_name == plugin)
        return next((str(one.name) for one in of_it if one.config.get(attribute) == target), None)

    def free_name(self, name: str) -> str:
        """Returns the name, with a number appended if an element has this name already."""
        spec = self._spec
        taken = {part.name for part in (*spec.plugins, *spec.actuators, *spec.bodies)}
        numbered = (f"{name}_{number}" for number in count(2))
        return next(one for one in chain([name], numbered) if one not in taken)

    def spring_of(self, joint: str) -> str | None:
        """Returns the name of the spring-damper instance that acts on a joint."""
        return self.instance_on(SPRING, "joint", joint)

    def variant(self, edits: tuple[Edit, ...]) -> Variant:
        """Returns the model after edits of its specification; compiled models are cached.

        Raises:
            LeglabError: If MuJoCo refuses the edited model.
        """
        key = tuple(key for key, _ in edits)
        if key in self._variants:
            self._variants.move_to_end(key)
            return self._variants[key]
        with _COMPILING:
            return self._compiled(edits, key)

    def _compiled(self, edits: tuple[Edit, ...], key: Hashable) -> Variant:
        spec = self.spec()
        take_out(spec)
        spec.option.timestep = self.timestep
        spec.compiler.discardvisual = True
        spec.option.disableflags |= int(_OFF.mjDSBL_AUTORESET) | int(_OFF.mjDSBL_SENSOR)
        try:
            for _, edit in edits:
                edit(spec)
            model = spec.compile()
            if not (model.geom_contype.any() or model.geom_conaffinity.any() or model.npair):
                # If no contact is possible, a replay without collision detection saves a fifth.
                model.opt.disableflags |= int(_OFF.mjDSBL_CONTACT)
            plugin_state = mujoco.MjData(model).plugin_state.copy()
        except (ValueError, mujoco.FatalError) as error:
            raise leglab.machine.plugin.load_error(error, self.path.name, spec) from error
        elements = leglab.machine.plugin.elements(model)
        fed = {a.name: a.plugin.config.get("supply") for a in spec.actuators if a.name in elements}
        drawn_by = {
            name: tuple(cylinder for cylinder, source in fed.items() if source == name)
            for name, (_, table) in elements.items()
            if table.plugin == SUPPLY
        }
        joint_of = {p.name: p.config["joint"] for p in spec.plugins if "joint" in p.config}
        self._variants[key] = Variant(model, elements, joint_of, drawn_by, plugin_state)
        if len(self._variants) > _CACHED_VARIANTS:
            self._variants.popitem(last=False)
        return self._variants[key]


def take_free_joints_out(spec: mujoco.MjSpec) -> None:
    """Deletes free joints in place, so that their bodies stay at their poses in the model."""
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    for joint in free:
        spec.delete(joint)
    for key in list(spec.keys) if free else ():  # keyframes have another number of positions
        spec.delete(key)


def moved(moments: np.ndarray) -> np.ndarray:
    """Returns the degrees of freedom that an actuator moves, by its moments, (nv,).

    A tendon's moments are differences of lengths as large as the machine. So the moments on joints
    that the tendon does not cross are rounding errors instead of 0: 1e-16 of the largest moment, or
    1e-13 if a lever is a thousandth of the machine's size.
    """
    size = np.abs(moments)
    return np.flatnonzero(size > ROUNDING * size.max())


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Smoothed measured series of one recording, from which hidden states are reconstructed."""

    period: float  #: Sampling period [s]
    position: dict[str, np.ndarray]  #: Joint positions by joint, each (n,)
    velocity: dict[str, np.ndarray]  #: Joint velocities by joint, each (n,)
    #: d(actuator length)/dt of the cylinders by actuator [m/s], each (n,).
    piston_velocity: dict[str, np.ndarray]
    #: d(actuator length)/d(joint position) of the cylinders by actuator, each (n,).
    lever: dict[str, np.ndarray]
    command: dict[str, np.ndarray]  #: Commands at each actuator, after its command path, each (n,)
    #: Measured pressures by "<joint>_pressure_a" and so on, each (n,).
    pressure: dict[str, np.ndarray]
    samples: np.ndarray  #: Samples at which windows start, (windows,)
    start: float = 0.0  #: Time of the first sample [s]
    #: Part of the velocity that commands of native actuators cause, by joint, each (n,); commands
    #: change its slope abruptly.
    pushed: dict[str, np.ndarray] = field(default_factory=dict)
    #: Whether a body that a joint moves is in contact, by joint, each (n,).
    touched: dict[str, np.ndarray] = field(default_factory=dict)
    #: MuJoCo's activation `act` of each actuator that has one, each (n,).
    activation: dict[str, np.ndarray] = field(default_factory=dict)
    hidden_states: HiddenStates = field(default_factory=HiddenStates)  #: Cache along the recording


@dataclass(frozen=True)
class ForceLeft:
    """A joint's motion at some instants, and the residual force on the joint; all (moments,).

    The residual force is M a + bias minus all forces of the model [N m or N].
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray


# Function that returns the values of a plugin state at the window starts, (windows,).
Start = Callable[[Measured, Variant, np.ndarray], np.ndarray]


class Change:
    """Builder that collects the changes of an unmodified machine by effects, in order."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.edits: list[Edit] = []
        self.parameters: dict[tuple[str, str], float] = {}
        #: Plugin of each instance that edits insert, by instance name.
        self.inserted: dict[str, str] = {}
        self.beyond = False  #: Whether a value was outside the bounds of its plugin's parameter
        # Command and sensor paths of the model file are applied first.
        commands, corrections = machine.carried
        self.commands = {actuator: list(paths) for actuator, paths in commands.items()}
        self.corrections = {column: list(undone) for column, undone in corrections.items()}
        self.starts: dict[tuple[str, str], Start] = {}

    @property
    def variant(self) -> Variant:
        """The model after the edits."""
        return self.machine.variant(tuple(self.edits))

    def parameter(self, element: str, name: str) -> float:
        """Returns the value of a plugin parameter: as set by this change, else as in the model."""
        if (element, name) in self.parameters:
            return self.parameters[element, name]
        return self.machine.parameter(element, name)

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets a plugin parameter through `plugin_state`, without compiling the model again.

        The element may be inserted by an `edit`. A value outside the plugin's bounds becomes the
        nearest bound; see `within` if the minimum itself is excluded.
        """
        elements, own = self.machine.base.elements, math.nan
        if element in elements:
            table, own = elements[element][1], self.machine.parameter(element, name)
        elif element in self.inserted:
            table = plugin_tables()[self.inserted[element]]
            own = table.parameters[name].nominal
        else:  # an instance of another library, or a coefficient of a learned part
            self.parameters[element, name] = float(value)
            return
        self.parameters[element, name] = self.within(table.parameters[name], value, own)

    def within(self, row: Parameter, value: float, own: float) -> float:
        """Limits a value to its bounds; an excluded minimum is raised slightly toward `own`."""
        low = row.minimum
        if not row.minimum_allowed:
            low += NEGLIGIBLE * (own - low)
        self.beyond |= not low <= value <= row.maximum
        return float(min(max(value, low), row.maximum))

    def add_parameter(self, element: str, name: str, difference: float) -> None:
        """Adds a difference to a plugin parameter, so that several effects on it add up.

        The sum is limited to the plugin's bounds.
        """
        self.set_parameter(element, name, self.parameter(element, name) + difference)

    def edit(self, key: Hashable, function: Callable[[mujoco.MjSpec], None]) -> None:
        """Edits the specification: inserts an element, or changes a native attribute.

        Compiled models are cached by the keys of their edits, so the key must contain every value
        that `function` writes. To compile only once, insert an element with neutral parameters and
        set these by `set_parameter`.
        """
        if key not in [known for known, _ in self.edits]:
            self.edits.append((key, function))

    def command(self, actuator: str, function: CommandPath) -> None:
        """Applies a function (a fault) to the measured command before it reaches the actuator."""
        if actuator not in self.machine.actuators:
            raise SettingsError.unknown("actuator", actuator, self.machine.actuators)
        self.commands.setdefault(actuator, []).append(function)

    def correct(self, column: str, function: Correction, *, noise_gain: float = 1.0) -> None:
        """Corrects a sensor fault in a measured column, before states are reconstructed from it.

        Predictions are compared with corrected values. `function` multiplies noise by `noise_gain`
        (1/scale of a gain fault). Errors are divided by it, as less noise alone is no better fit.
        """
        self.corrections.setdefault(column, []).append((function, noise_gain))

    def start(self, element: str, state: str, function: Start) -> None:
        """Sets the function that gives a hidden plugin state at window starts from measured series.

        Only plugins that `leglab.diagnosis.replay.starts` does not handle need such a function.
        """
        self.starts[element, state] = function
