"""Registers the scenarios of the table of causes."""

from leglab.base.scenario import Options, ParameterChange, register_scenario
from leglab.causes.record import Cause
from leglab.causes.table import CAUSES


def register_causes() -> None:
    """Registers a scenario for every cause that has a summary."""
    for cause in CAUSES.values():
        if cause.summary:
            _register(cause)


def _register(cause: Cause) -> None:
    @register_scenario(
        cause.name,
        summary=cause.summary,
        reference_config=cause.reference_config,
        severity=cause.severity,
        per_joint=cause.per_joint,
    )
    def changes(options: Options) -> tuple[ParameterChange, ...]:
        return cause.changes(cause, options)
