"""Scenarios, controllers, references and models with their summaries."""

import leglab.controllers
import leglab.scenarios  # noqa: F401  registers the scenarios
from leglab.base.scenario import scenario_names, scenario_severity, scenario_summary
from leglab.control import controller_names, controller_summary
from leglab.machine.simulation import model_names, model_summary
from leglab.references import reference_names, reference_summary


def summaries() -> dict[str, dict[str, str]]:
    """Summaries by kind and name."""
    return {
        "scenarios": {name: scenario_summary(name) for name in scenario_names()},
        "controllers": {name: controller_summary(name) for name in controller_names()},
        "references": {name: reference_summary(name) for name in reference_names()},
        "models": {name: model_summary(name) for name in model_names()},
    }


def severity_text(scenario: str) -> str:
    """Meaning and default of a scenario's severity; empty without one."""
    severity = scenario_severity(scenario)
    return f"{severity.meaning}: {severity.default:g}" if severity else ""


def markdown() -> str:
    """All of them as Markdown, the content of docs/catalogue.md."""
    lines = [
        "# Scenarios, controllers, references, models",
        "",
        "Made by `leglab list --markdown > docs/catalogue.md`.",
    ]
    for kind, entries in summaries().items():
        scenarios = kind == "scenarios"
        lines += ["", f"## {kind.capitalize()}", ""]
        lines.append("| name | what |" + (" `--severity`: default |" if scenarios else ""))
        lines.append("|---|---|" + ("---|" if scenarios else ""))
        for name, summary in entries.items():
            row = f"| `{name}` | {summary} |"
            lines.append(row + (f" {severity_text(name)} |" if scenarios else ""))
    return "\n".join(lines) + "\n"
