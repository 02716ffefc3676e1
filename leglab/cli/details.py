"""`leglab list NAME`: one scenario, controller, reference, model or effect with its settings."""

from functools import cache
from typing import TYPE_CHECKING, Any

import typer

from leglab.base.errors import SettingsError
from leglab.base.registry import Registry
from leglab.base.settings import Configuration, documented_settings
from leglab.causes.table import CAUSES
from leglab.cli.options import names_of
from leglab.cli.terminal import output, plain_table, print_json, print_wide, tell

_SENSORS = "sensors"

if TYPE_CHECKING:
    from leglab.base.scenario import Healthy
    from leglab.machine.simulation import Simulation


def show_details(name: str, model: str, *, as_json: bool) -> None:
    """Prints all objects of this name, since objects of different kinds may have the same name.

    Args:
        name: Name of a scenario, controller, reference, model or effect, or "sensors".
        model: Machine on which a scenario or an effect is shown.
        as_json: Whether to print JSON.

    Raises:
        LeglabError: Nothing has this name, or the model does not exist.
    """
    known, found = {_SENSORS, *names_of("effects")}, {}
    for kind, registry in registries().items():
        known.update(registry.names())
        if name in registry.names():
            found[kind] = _DETAILS[kind](kind, name, registry.get(name), model)
    if name in names_of("effects"):
        found["effect"] = _effect(name, model)
    if name == _SENSORS:
        found["settings"] = _sensors()
    if not found:
        raise SettingsError.unknown("name", name, known, "`leglab list` prints all")
    if as_json:
        print_json(found)
        return
    for number, (kind, details) in enumerate(found.items()):
        if number:
            typer.echo()
        _print(kind, name, details)


def registries() -> dict[str, Registry[Any]]:
    """Returns the registries of scenarios, controllers, references and models, by kind."""
    import leglab.controllers
    import leglab.scenarios  # noqa: F401  registers the scenarios
    from leglab.base.scenario import SCENARIOS
    from leglab.control.contract import CONTROLLERS
    from leglab.machine.library import MODELS
    from leglab.references.base import REFERENCES

    return {
        "scenario": SCENARIOS,
        "controller": CONTROLLERS,
        "reference": REFERENCES,
        "model": MODELS,
    }


def model_values(model: str) -> "Healthy":
    """Returns a function that maps the name of a parameter to its values in a model."""

    def values(parameter: str) -> tuple[float, ...]:
        from leglab.machine.changes import healthy_values

        return healthy_values(_machine(model), parameter)

    return values


@cache
def _machine(model: str) -> "Simulation":
    from leglab.machine.simulation import Simulation, load_model

    return Simulation(load_model(model, visual=False))


def _scenario(_: str, name: str, entry: Any, model: str) -> dict[str, Any]:
    from leglab.base.scenario import get_scenario, scenario_severity

    values = model_values(model)
    scenario, severity = get_scenario(name, healthy=values), scenario_severity(name, values)
    options = [f"--duration {scenario.duration:g} [s]", f"--reference {scenario.reference}"]
    if severity:
        bounds = f"{severity.lowest:g} to {severity.highest:g}"
        options.append(f"--severity {severity.default:g} ({severity.meaning}; {bounds})")
    if scenario.changes:
        options.append("--ramp 0 [s]")
    if entry.per_joint:
        options.append("--element JOINT (default: all joints)")
    changes = [
        {
            "parameter": change.parameter,
            "elements": change.element,
            "change": f"{'times' if change.kind == 'scale' else 'to'} {change.value:g}",
            "from [s]": f"{change.start:g}",
        }
        for change in scenario.changes
    ]
    effects = [CAUSES[name].effect] if name in CAUSES and CAUSES[name].effect else []
    told = {"summary": scenario.summary, "options": options}
    return {**told, "effects": effects, "rows": changes}


def _sensors() -> dict[str, Any]:
    from leglab.machine.sensors import SensorConfiguration

    options = ["--set sensors.SETTING=VALUE"]
    rows = _setting_rows(SensorConfiguration)
    return {"summary": "Sensors and timing of every run", "options": options, "rows": rows}


def _settings(section: str, _: str, entry: Any, model: str) -> dict[str, Any]:
    rows = _setting_rows(entry.configuration)
    text = f"--set {section}.SETTING=VALUE" if rows else "no settings"
    return {"summary": entry.summary, "options": [text], "rows": rows}


def _setting_rows(configuration: type[Configuration]) -> list[dict[str, str]]:
    return [
        {
            "setting": setting.name,
            "default": setting.default,
            "allowed": setting.allowed,
            "unit": setting.unit,
            "meaning": setting.meaning,
        }
        for setting in documented_settings(configuration)
    ]


def _model(_: str, name: str, entry: Any, __: str) -> dict[str, Any]:
    machine = _machine(name)
    rows = []
    for i, (joint, actuator) in enumerate(zip(machine.joints, machine.actuators, strict=True)):
        low, high = machine.joint_range()[i]
        rows.append(
            {
                "joint": joint,
                "unit": "m" if machine.slides[joint] else "rad",
                "from": f"{low:.4g}",
                "to": f"{high:.4g}",
                "actuator": actuator,
                "drive": "MuJoCo's own" if actuator in machine.native else "cylinder",
            }
        )
    options = [f"file {entry.path}", f"timestep {machine.model.opt.timestep:g} s"]
    return {"summary": entry.summary, "options": options, "rows": rows}


# Function by kind that describes an entry, from kind, name, entry and the model to show it on.
_DETAILS = {"scenario": _scenario, "controller": _settings, "reference": _settings, "model": _model}


def _effect(name: str, model: str) -> dict[str, Any]:
    from leglab.diagnosis.effects import all_effects
    from leglab.diagnosis.plant.model import Machine

    machine = Machine(model)
    variants = [effect for effect in all_effects() if effect.name == name]
    fitting = [(effect, effect.elements(machine)) for effect in variants]
    effect, elements = next(((e, places) for e, places in fitting if places), (variants[0], ()))
    rows = [
        {
            "parameter": p.name,
            "unit": p.unit,
            "nominal": f"{p.nominal:.4g}",
            "lower": f"{p.lower:.4g}",
            "upper": f"{p.upper:.4g}",
        }
        for p in (effect.parameters(machine, elements[0]) if elements else ())
    ]
    where = f"on {elements[0]} of {model}" if elements else f"{model} has nothing it can sit on"
    live = [cause.name for cause in CAUSES.values() if name in cause.effect.split(" and ")]
    return {
        "summary": " ".join(effect.physics.split()),
        "options": [
            f"source: {' '.join(effect.source.split())}",
            f"shown by: {effect.excitation}",
            *([f"scenario or live name: {', '.join(live)}"] if live else []),
            where,
        ],
        "rows": rows,
    }


def _print(kind: str, name: str, details: dict[str, Any]) -> None:
    output.print(f"[bold]{name}[/bold], {kind}")
    tell(details["summary"])
    for line in details["options"]:
        tell(f"  {line}")
    if details.get("effects"):
        tell(f"  in a diagnosis: {', '.join(details['effects'])}")
    rows = details["rows"]
    if rows:
        print_wide(plain_table(list(rows[0]), [list(row.values()) for row in rows]))
