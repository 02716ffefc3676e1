"""The MuJoCo plugin library: loading, instances in a model, errors, and stepping without output."""

import contextlib
import ctypes
import functools
import logging
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco

import leglab._native
from leglab._native.hydraulics import parameter_tables
from leglab.base.errors import ModelError
from leglab.machine.parameters import (
    RESIDUAL,
    RESIDUAL_VARIABLES,
    PluginTable,
    plugin_tables,
    refused,
    residual_table,
    table_at_slide,
)


@functools.cache
def library() -> ctypes.CDLL:
    """Returns MuJoCo's shared library, for functions that its Python bindings do not expose."""
    (path,) = Path(mujoco.__path__[0]).glob("libmujoco.so.*")
    return ctypes.CDLL(str(path))


def library_path() -> Path:
    """Returns the path of the shared library with leglab's MuJoCo plugins.

    Raises:
        FileNotFoundError: It has not been built; lists the folders searched.
    """
    # An editable install keeps the sources and the compiled parts in different folders.
    for folder in leglab._native.__path__:
        path = Path(folder) / "libleglab_plugin.so"
        if path.exists():
            return path
    folders = ", ".join(leglab._native.__path__)
    raise FileNotFoundError(f"libleglab_plugin.so is not in {folders}: run `pip install .`")


@functools.cache
def load_plugin() -> None:
    """Registers leglab's plugins with MuJoCo; further calls do nothing.

    From then on each MuJoCo warning goes once to Python's logger "mujoco" instead of to a file
    MUJOCO_LOG.TXT in the working directory.

    Raises:
        LeglabError: The library does not load, e.g. because it was built for another MuJoCo.
    """
    path = library_path()
    mujoco.set_mju_user_warning(_log)
    try:
        mujoco.mj_loadPluginLibrary(str(path))
    except mujoco.FatalError as error:
        reason = " ".join(str(error).split())
        raise ModelError(
            f"the plugins do not load with mujoco {mujoco.__version__}: {reason}; install the "
            "version that leglab was built against, or build leglab anew",
            given=mujoco.__version__,
        ) from error


@functools.lru_cache(maxsize=1000)
def _log_once(warning: str) -> None:
    logging.getLogger("mujoco").warning(warning)


def _log(warning: str) -> None:
    _log_once(warning.partition(" Time = ")[0].strip())


def slots(names: Iterable[str]) -> dict[int, str]:
    """Returns the names of registered plugins by slot number, as in `MjModel.plugin`."""
    load_plugin()
    # MuJoCo's Python bindings do not expose mjp_getPlugin.
    look_up = library().mjp_getPlugin
    look_up.restype = ctypes.c_void_p
    found = {}
    for name in names:
        slot = ctypes.c_int(-1)
        if look_up(name.encode(), ctypes.byref(slot)):
            found[slot.value] = name
    return found


def text_attribute(model: mujoco.MjModel, instance: int, index: int = 0) -> str:
    """Reads an attribute of a plugin instance by its index among the plugin's attributes."""
    start = int(model.plugin_attradr[instance])
    return bytes(model.plugin_attr[start:]).split(b"\0", index + 1)[index].decode()


def elements(model: mujoco.MjModel) -> dict[str, tuple[int, PluginTable]]:
    """Returns address in `plugin_state` and table of the instances with parameters, by name.

    A cylinder has the name of its actuator, every other plugin instance its instance name.
    """
    tables = plugin_tables()
    names = slots(tables)
    owners = {int(model.actuator_plugin[i]): model.actuator(i).name for i in range(model.nactuator)}
    found = {}
    for i in range(model.nplugin):
        if model.plugin[i] in names:
            start = int(model.name_pluginadr[i])
            own = bytes(model.names[start:]).split(b"\0", 1)[0].decode()
            table = tables[names[model.plugin[i]]]
            joint = _named(model, i, table.plugin, "joint")
            if table.plugin == RESIDUAL:
                knots = {v: _text(model, i, RESIDUAL, f"{v}_knots") for v in RESIDUAL_VARIABLES}
                counts = {v: len(text.split()) + 2 for v, text in knots.items() if text}
                table = residual_table(
                    table, counts, "N m" if joint >= 0 else "1"
                )  # "1" for a cylinder's command
            if joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                table = table_at_slide(table)
            found[owners.get(i) or own] = int(model.plugin_stateadr[i]), table
    return found


# Attributes that name an element of the model, and the element's kind.
_NAMING = {
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "cylinder": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "supply": mujoco.mjtObj.mjOBJ_PLUGIN,
    "strut": mujoco.mjtObj.mjOBJ_TENDON,
}


def _named(model: mujoco.MjModel, instance: int, plugin: str, attribute: str) -> int:
    """Returns the id of the element that an attribute of an instance names; -1 for none.

    The plugins' `element_named` (leglab/csrc/plugin/config.h) looks the name up, because names in
    attributes lack the prefix that elements get when a model is attached to another one.
    """
    name = _text(model, instance, plugin, attribute).encode()
    if not name:
        return -1
    find = ctypes.CDLL(str(library_path())).leglab_element_named
    kind = int(_NAMING[attribute])
    return find(ctypes.c_void_p(model._address), instance, kind, name)


def full_names(model: mujoco.MjModel) -> dict[tuple[str, str], str]:
    """Returns full names of elements that attributes give without their prefix or suffix.

    Keys are the name of the actuator or plugin instance in the specification, and the attribute.
    """
    found = {}
    plugins = slots(parameter_tables())
    owners = {int(model.actuator_plugin[i]): model.actuator(i).name for i in range(model.nactuator)}
    for i in range(model.nplugin):
        plugin = plugins.get(int(model.plugin[i]), "")
        own = owners.get(i) or mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_PLUGIN, i)
        for attribute, kind in _NAMING.items() if plugin and own else ():
            number = _named(model, i, plugin, attribute)
            name = mujoco.mj_id2name(model, kind, number) if number >= 0 else ""
            if name and name != _text(model, i, plugin, attribute):
                found[own, attribute] = name
    return found


def _text(model: mujoco.MjModel, instance: int, plugin: str, name: str) -> str:
    """Returns a text attribute of a plugin instance; empty if the plugin has no such attribute."""
    texts = parameter_tables()[plugin][2]
    return text_attribute(model, instance, texts.index(name)) if name in texts else ""


def attribute_names(plugin: str) -> tuple[str, ...]:
    """Returns the names of the MJCF attributes of a leglab plugin; empty for any other plugin."""
    parameters, _, texts = parameter_tables().get(plugin, ([], [], []))
    return (*texts, *(row[0] for row in parameters))


def to_xml(spec: mujoco.MjSpec, referred: Iterable[str] = ()) -> str:
    """Writes a compiled specification as MJCF, including the plugin instances added to it.

    `MjSpec.to_xml` of MuJoCo 3.17 omits instances added through `add_plugin`; copying or attaching
    a specification drops unreferenced instances. Each unreferenced instance that is not in
    `referred` gets a massless body that refers to it, a child or sibling of its joint's body.
    """
    root = ElementTree.fromstring(spec.to_xml())
    for plugin in spec.plugins:
        known = root.find(f".//extension//instance[@name='{plugin.name}']") is not None
        if known or not plugin.name:
            continue
        extension = root.find("extension")
        if extension is None:
            extension = ElementTree.SubElement(root, "extension")
        parent = extension.find(f"plugin[@plugin='{plugin.plugin_name}']")
        if parent is None:
            parent = ElementTree.SubElement(extension, "plugin", plugin=plugin.plugin_name)
        instance = ElementTree.SubElement(parent, "instance", name=plugin.name)
        for key, value in plugin.config.items():
            ElementTree.SubElement(instance, "config", key=key, value=value)
    _refer_to_instances(root, referred)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _refer_to_instances(root: ElementTree.Element, referred: Iterable[str]) -> None:
    """Adds a body for each plugin instance that no element of the model refers to."""
    world = root.find("worldbody")
    if world is None or not (bodies := [*world.iter("body")]):
        return
    names = {body.get("name") for body in bodies}
    above = {body: parent for parent in bodies for body in parent.findall("body")}
    body_of = {
        joint.get("name"): body for body in reversed(bodies) for joint in body.findall("joint")
    }
    joint_of = {drive.get("name"): drive.get("joint") for drive in root.findall("actuator/*")}
    referred = {*referred, *(one.get("instance", "") for one in root.iter("plugin"))}
    for plugin in root.findall("extension/plugin"):
        for instance in plugin.findall("instance"):
            name = instance.get("name", "")
            if name in referred:
                continue
            text = {one.get("key"): one.get("value") for one in instance.findall("config")}
            joint = text.get("joint") or joint_of.get(text.get("actuator"))
            parent = body_of.get(joint, bodies[0])
            if parent.find("body") is None:  # MuJoCo softens constraints of childless bodies
                parent = above.get(parent, world)
            place = ElementTree.SubElement(parent, "body", name=name + "_plugin" * (name in names))
            ElementTree.SubElement(place, "plugin", instance=name)


_UNKNOWN_ATTRIBUTE = re.compile(
    r"unrecognized attribute 'plugin:(?P<attribute>[^']*)' for plugin (?P<plugin>[\w.]+)"
)
_MISSING = re.compile(r"(?P<kind>site|transmission target) '(?P<name>[^']*)' not found")
# MuJoCo's note in messages that visual shapes were discarded, which has not caused the error.
_DISCARDED = re.compile(r"\s*The visual elements of the spec were discarded.*", re.DOTALL)
_ELEMENT = re.compile(r"\nElement name '(?P<element>[^']*)'.*", re.DOTALL)


def load_error(error: Exception, where: str, spec: mujoco.MjSpec | None = None) -> ModelError:
    """Turns MuJoCo's error about a model into one line.

    Args:
        error: Exception that `MjModel.from_xml_path`, `MjSpec.compile` or `MjData` raised.
        where: The file or model.
        spec: The model's specification; None if it could not be read.

    Returns:
        The error with the element's name; for a wrong plugin attribute or a missing anchor the
        message lists the existing attributes or anchors.
    """
    text = str(error).removeprefix("Error: ").removeprefix("engine error: ")
    text = _DISCARDED.sub("", text)
    element = _ELEMENT.search(text)
    if element:
        text = text[: element.start()]
        where = f"{where}: element {element['element']!r}"
    unknown = _UNKNOWN_ATTRIBUTE.search(text)
    if unknown and attribute_names(unknown["plugin"]):
        known = attribute_names(unknown["plugin"])
        kind = f"{unknown['plugin']} attribute"
        return ModelError.unknown(kind, unknown["attribute"], known).at(where)
    missing = _MISSING.search(text)
    if missing and spec is not None:
        sites = missing["kind"] == "site"
        parts = [*spec.sites] if sites else [*spec.tendons, *spec.joints]
        names = [part.name for part in parts if part.name]
        return ModelError.unknown(missing["kind"], missing["name"], names).at(where)
    return refused(where, text)


class _Suspension:
    """Context manager that removes a process-wide setting while any thread is inside it.

    Args:
        swap: Sets a value and returns the previous one; None removes the setting.
    """

    def __init__(self, swap: Callable[[Any], Any]) -> None:
        self._swap = swap
        self._taken: Any = None
        self._count = 0
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            if self._count == 0:
                self._taken = self._swap(None)
            self._count += 1
        try:
            yield
        finally:
            with self._lock:
                self._count -= 1
                if self._count == 0:
                    self._swap(self._taken)


def _swap_clock(clock: int | None) -> int | None:
    # The Python bindings install a clock that their `set_mjcb_time` cannot remove.
    place = ctypes.c_void_p.in_dll(library(), "mjcb_time")
    before, place.value = place.value, clock
    return before


def _swap_warnings(handler: Any) -> Any:
    mujoco.set_mju_user_warning(handler or (lambda warning: None))
    return _log  # the bindings do not return the previous handler


# Callers that suppress MuJoCo's warnings check for the causes themselves.
without_warnings, _without_clock = _Suspension(_swap_warnings), _Suspension(_swap_clock)


@contextlib.contextmanager
def headless(model: mujoco.MjModel) -> Iterator[None]:
    """Turns off MuJoCo's warnings, sensors and profiling timers while a model is stepped.

    The motion is bit-identical and takes about four fifths of the time.
    """
    flags = model.opt.disableflags
    with without_warnings(), _without_clock():
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        try:
            yield
        finally:
            model.opt.disableflags = flags
