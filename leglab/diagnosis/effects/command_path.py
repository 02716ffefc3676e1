"""Writes command faults of native actuators into a model."""

from collections.abc import Mapping

import mujoco

from leglab.diagnosis.effects import joints
from leglab.diagnosis.paths import COMMAND_PATH


def write_command_path(spec: mujoco.MjSpec, actuator: str, values: Mapping[str, float]) -> None:
    """Sets parameters of an actuator's `leglab.command_path`; inserts one if there is none."""
    for plugin in spec.plugins:
        if plugin.plugin_name == COMMAND_PATH and plugin.config.get("actuator") == actuator:
            plugin.config = {**plugin.config, **{k: repr(float(v)) for k, v in values.items()}}
            return
    joints.insert(spec, COMMAND_PATH, f"{actuator}_path", {"actuator": actuator, **values})
