"""The command line: `leglab`, and `main` for scripts that define a controller or a scenario."""

from leglab.cli.app import main, run_scenario_as_script

__all__ = ["main", "run_scenario_as_script"]
