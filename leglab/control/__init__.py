"""Interface of controllers (measurements, references, commands) and their components."""

from leglab.control.contract import (
    Controller,
    ControllerSetup,
    Foreknowledge,
    Measurement,
    NominalMachine,
    ReferencePoint,
    check_command,
    controller_names,
    controller_summary,
    make_controller,
    register_controller,
)

__all__ = [
    "Controller",
    "ControllerSetup",
    "Foreknowledge",
    "Measurement",
    "NominalMachine",
    "ReferencePoint",
    "check_command",
    "controller_names",
    "controller_summary",
    "make_controller",
    "register_controller",
]
