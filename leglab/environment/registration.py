"""Names of the environments in Gymnasium's registry: "leglab/SealWear-v0", one a scenario."""

import importlib.util

import leglab.scenarios  # noqa: F401  registers the scenarios
from leglab.base.scenario import scenario_names


def register() -> None:
    """Registers one environment a scenario, where Gymnasium is installed."""
    if importlib.util.find_spec("gymnasium") is None:
        return
    import gymnasium

    for scenario in scenario_names():
        gymnasium.register(
            id=environment_id(scenario),
            entry_point="leglab.environment.loading:load_gymnasium",
            vector_entry_point="leglab.environment.loading:make_batch",
            kwargs={"scenario": scenario},
        )


def environment_id(scenario: str) -> str:
    """Name of a scenario's environment, for instance leglab/SealWear-v0 for seal_wear."""
    return f"leglab/{scenario.title().replace('_', '')}-v0"
