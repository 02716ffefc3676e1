"""Content of the JSON files of a run, `metrics.json` and `run.json`, with reading."""

from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from leglab.base.errors import FileError
from leglab.base.input import read_json
from leglab.base.notebook import data_frame, data_index, html_table
from leglab.base.settings import first_problem
from leglab.base.units import error_unit
from leglab.causes.fault_names import FaultEvent, FaultTrend, Name

METRICS, CONFIGURATION, RECORDING = "metrics.json", "run.json", "recording.parquet"
RUN_FILES = (METRICS, CONFIGURATION, RECORDING)
MODEL = "model"  # folder of the model's files, for a model that does not ship with leglab
# All files and folders that commands write into the folder of a run.
RUN_FOLDER = (
    *RUN_FILES, MODEL, "tracking.png", "tracking_change.png", "pressures.png", "commands.png",
    "report.html", "report.mp4", "video.mp4",
)  # fmt: skip

ByJoint = dict[str, FiniteFloat]


class PhaseMetrics(BaseModel):
    """One phase of `metrics.json`: errors and costs, by joint and under "all"."""

    name: Name  #: "before", "during", "after" or "whole"
    start: FiniteFloat  #: [s]
    end: FiniteFloat  #: [s]
    rms_rad: ByJoint  #: RMS tracking error [rad]
    peak_rad: ByJoint  #: Largest error [rad]
    p95_rad: ByJoint = {}  #: Error that 95 % of the samples do not exceed [rad]
    effort: ByJoint = {}  #: RMS valve command
    valve_activity_per_s: ByJoint = {}  #: RMS rate of the command [1/s]
    energy_j: ByJoint = {}  #: Energy drawn from the supply [J]
    #: RMS error of the controller's model, in its own unit; without "all".
    model_error: ByJoint = {}


class AdaptationMetrics(BaseModel):
    """How a run took its change, in `metrics.json`; see `leglab.runs.clock`.

    Errors are RMS over joints and time, of the true positions; that after the change is the phase
    "after". A figure that cannot be told is None.
    """

    span_s: FiniteFloat | None = None  #: The whole strides that a quarter of the run has [s]
    stride_s: FiniteFloat | None = None  #: Period of the reference [s]
    #: Error over `span_s` before the change [rad], by joint and under "all".
    before_rad: ByJoint | None = None
    end_rad: ByJoint | None = None  #: Error over the last `span_s` [rad], by joint and under "all"
    #: What the change costs: error of the frozen twin after the change less `before_rad` [rad]. The
    #: frozen twin is the same run with adaptation stopped just before the change; for a controller
    #: that has none, the worst stride of the run itself.
    damage_rad: FiniteFloat | None = None
    damage_of: str | None = None  #: "frozen twin" or "own peak"
    #: Error of the frozen twin over the last `span_s` [rad]; None without one.
    twin_end_rad: FiniteFloat | None = None
    #: Share of the damage that is undone at the end: 1 where `end_rad` is `before_rad`.
    recovered: FiniteFloat | None = None
    #: From the change until no stride that begins later has an error above `level_rad` [s]; None
    #: where the last one still has.
    t90_s: FiniteFloat | None = None
    level_rad: FiniteFloat | None = None  #: `before_rad` and a tenth of the damage [rad]
    reason: str | None = None  #: Why `recovered` and `t90_s` cannot be told


class CommandTime(BaseModel):
    """How long the controller's `command` took, in `metrics.json`."""

    median: FiniteFloat  #: [s]
    worst: FiniteFloat  #: [s]
    late: FiniteFloat  #: Share of the control periods that it took longer than


class RunMetrics(BaseModel):
    """Content of `metrics.json`."""

    scenario: Name  #: Its name
    controller: Name  #: Its name
    model: Name  #: Name or path
    seed: int  #: Of sensor noise and everything random
    duration: FiniteFloat  #: How far the run came [s]
    #: Size of the fault, in the scenario's own unit; None without one.
    severity: FiniteFloat | None = None
    real_time_factor: FiniteFloat | None = None  #: Simulated time over the loop's wall time
    #: None without a controller, and of runs by versions that did not measure it.
    command_time_s: CommandTime | None = None
    completed: bool  #: Whether the run came to its end
    failure: str | None = None  #: Why it ended early
    phases: Annotated[list[PhaseMetrics], Field(min_length=1)]  #: Errors and costs by phase
    #: What the change cost, and how much of it was undone how soon.
    adaptation: AdaptationMetrics = AdaptationMetrics(reason="it was not stored")
    #: Area of the moving error above its value before [rad s].
    excess_error_area_rad_s: FiniteFloat | None = None
    #: Changes that the controller noticed and named, for one that does.
    events: list[FaultEvent] = []
    health: list[FaultTrend] = []  #: Slow wear that it followed, likewise
    #: Joints that slide: their errors are metres, in spite of the names of the entries.
    slides: list[Name] = []

    def error_unit(self, *joints: str) -> str:
        """Returns the unit of reported errors of some or all joints: "mrad", "mm", "mrad or mm"."""
        names = joints or tuple(name for name in self.phases[0].rms_rad if name != "all")
        return error_unit(name in self.slides for name in names)

    def told(self) -> str:
        """Returns a summary of the run in one line."""
        phases = ", ".join(
            f"{1e3 * p.rms_rad['all']:.3g} {self.error_unit()} {p.name}" for p in self.phases
        )
        failed = f"; ended early: {self.failure}" if self.failure else ""
        return (
            f"{self.scenario}, {self.controller} on {self.model}, seed {self.seed}, "
            f"{self.duration:g} s: RMS error {phases}{failed}"
        )

    def as_html(self) -> str:
        """Returns RMS and peak error by joint and phase as an HTML table for notebooks."""
        head = ["joint", *(f"{p.name} {p.start:g}-{p.end:g} s" for p in self.phases)]
        errors = [(p.rms_rad, p.peak_rad) for p in self.phases]
        rows = [
            [joint, *(f"{1e3 * rms[joint]:.3g} / {1e3 * peak[joint]:.3g}" for rms, peak in errors)]
            for joint in self.phases[0].rms_rad
        ]
        return html_table(f"{self.told()}; RMS / peak by joint [{self.error_unit()}]", head, rows)

    def to_pandas(self) -> Any:
        """Returns errors and costs as a `pandas.DataFrame`, by phase and joint; "all" is a joint.

        Raises:
            LeglabError: pandas is missing.
        """
        rows = {}
        for phase in self.phases:
            columns = {k: v for k, v in phase.model_dump().items() if isinstance(v, dict)}
            for joint in phase.rms_rad:
                rows[phase.name, joint] = {k: v.get(joint) for k, v in columns.items()}
        frame = data_frame(list(rows.values()), index=data_index(rows, ("phase", "joint")))
        return frame.dropna(axis="columns", how="all")


class ChangeRecord(BaseModel):
    """A changed parameter in `run.json`; see `leglab.base.scenario.ParameterChange`."""

    parameter: Name
    element: Name
    kind: Name
    value: FiniteFloat
    start: FiniteFloat
    ramp_duration: FiniteFloat = 0.0

    @property
    def place(self) -> str:
        """Changed elements for display: "all elements", a name, a pattern, or a joint name."""
        return "all elements" if self.element == "*" else self.element.partition(",")[0]


class RunConfiguration(BaseModel):
    """Content of `run.json`.

    Attributes:
        settings: Of the run, defaults filled in.
        window: Period of the reference, over which the moving error is taken [s].
        changes: What happened to the machine.
        elements: Parameters of the cylinders at the start, by actuator.
        versions: Of leglab, Python and packages.
        asked: Settings as they were asked for, where a folder is to be found again by them.
        code: Digest of leglab's code, likewise.
        model_digest: Of the model with all its files; empty of one that ships with leglab.
        model_file: Where the run's folder has the model; None of one that ships with leglab.
        model_source: Where that was when it ran; absolute.
    """

    settings: dict[str, Any]
    window: Annotated[FiniteFloat, Field(gt=0)]
    changes: list[ChangeRecord] = []
    elements: dict[str, dict[str, Any]] = {}
    versions: dict[str, str] = {}
    asked: dict[str, Any] | None = None
    code: str | None = None
    model_digest: str = ""
    model_file: str | None = None
    model_source: str | None = None


_Content = TypeVar("_Content", bound=BaseModel)


def as_json(content: BaseModel) -> dict[str, Any]:
    """Returns the explicitly set fields of a model as plain Python types."""
    return content.model_dump(exclude_unset=True)


def read(model: type[_Content], path: Path) -> _Content:
    """Reads and validates a JSON file.

    Raises:
        LeglabError: The file cannot be read or does not have the required form; the message
            names the file and the entry.
    """
    try:
        return model.model_validate(read_json(path))
    except ValidationError as error:
        where, reason = first_problem(error)
        raise FileError(f"{path}: {where or 'content'}: {reason}", given=path) from error
