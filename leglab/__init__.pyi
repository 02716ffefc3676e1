# The public names, and where they are defined: `__init__.py` loads from this list.
from .base.errors import LeglabError as LeglabError
from .base.recording import Recording as Recording
from .base.scenario import Options as Options
from .base.scenario import ParameterChange as ParameterChange
from .base.scenario import Scenario as Scenario
from .base.scenario import Severity as Severity
from .base.scenario import register_scenario as register_scenario
from .base.settings import Configuration as Configuration
from .control.contract import Controller as Controller
from .control.contract import ControllerSetup as ControllerSetup
from .control.contract import Measurement as Measurement
from .control.contract import NominalMachine as NominalMachine
from .control.contract import ReferencePoint as ReferencePoint
from .control.contract import register_controller as register_controller
from .controllers import controller_names as controller_names
from .controllers import make_controller as make_controller
from .data import read as read
from .data import read_column_map as read_column_map
from .data import write as write
from .diagnosis.effects import Effect as Effect
from .diagnosis.effects import EffectParameter as EffectParameter
from .diagnosis.effects import register_effect as register_effect
from .diagnosis.output import write_improved as write_improved
from .diagnosis.result import Diagnosis as Diagnosis
from .diagnosis.verdict import diagnose as diagnose
from .diagnosis.workflow import DiagnosisSettings as DiagnosisSettings
from .machine.library import register_model as register_model
from .machine.plugin import load_plugin as load_plugin
from .machine.simulation import Simulation as Simulation
from .machine.simulation import load_model as load_model
from .references import make_reference as make_reference
from .references import reference_names as reference_names
from .references import register_reference as register_reference
from .runs.folder import read_run as read_run
from .runs.folder import write_run as write_run
from .runs.loop import Loop as Loop
from .runs.preparation import RunSettings as RunSettings
from .runs.run import Run as Run
from .runs.run import run_scenario as run_scenario
from .runs.sweep import Comparison as Comparison
from .runs.sweep import compare as compare
from .runs.sweep import run_all as run_all
from .scenarios import get_scenario as get_scenario
from .scenarios import scenario_names as scenario_names

__version__: str
__all__: list[str]
