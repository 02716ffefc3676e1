"""What results show in Python and notebooks: one line, a table, a plot, a data frame."""

import sys
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest

from leglab import (
    Comparison,
    RunSettings,
    ask,
    compare,
    read_run,
    read_sweep,
    run_scenario,
    write_run,
)
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.diagnosis.verdict.outcome import Outcome
from leglab.runs.comparison import run_all
from tests.helpers.made_up_diagnosis import diagnosis
from tests.helpers.report_folders import Elements
from tests.helpers.sweep_folders import write_sweep

KNEE = {"model": "knee_bench", "duration": 2.0}
LONGEST = 200  # characters of a repr


@pytest.fixture(autouse=True)
def no_window():
    mpl.use("Agg")
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


@pytest.fixture(scope="module")
def run():
    return run_scenario(RunSettings(scenario="seal_wear", controller="static_feedforward", **KNEE))


@pytest.fixture(scope="module")
def results(run, tmp_path_factory):
    """Everything that a user gets back and may have shown."""
    folder = tmp_path_factory.mktemp("results")
    comparison = Comparison(
        scenarios=("seal_wear",), controllers=("pd", "static_feedforward"), seeds=2, **KNEE
    )
    compared = compare(comparison, run_all(comparison.runs(), folder / "runs", jobs=1))
    read = read_run(str(write_run(run, folder / "run")))
    found = diagnosis("confusion_set")
    write_sweep(folder / "sweep", failed=(1,))
    return SimpleNamespace(
        run=run,
        read=read,
        recording=run.recording,
        compared=compared,
        diagnosis=found,
        swept=read_sweep(folder / "sweep"),
    )


NAMES = ("run", "read", "recording", "compared", "diagnosis", "swept")


@pytest.mark.parametrize("name", NAMES)
def test_a_result_is_one_short_line(results, name):
    text = repr(getattr(results, name))
    assert len(text) < LONGEST + len(str(results.read.folder))
    assert "\n" not in text
    assert "array" not in text


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_shows_a_table(results, name):
    page = Elements(getattr(results, name)._repr_html_())
    assert len(page.all("table")) == 1
    assert len(page.all("tr")) >= 2
    assert not page.all("script")


@pytest.mark.parametrize("name", NAMES)
def test_a_result_plots_itself(results, name):
    axes = getattr(results, name).plot()
    figure = axes[0].figure
    assert all(axis.figure is figure for axis in axes)
    assert all(axis.lines or axis.patches for axis in axes)
    assert axes[-1].get_xlabel()
    figure.canvas.draw()


@pytest.mark.parametrize("name", NAMES)
def test_a_result_becomes_a_data_frame(results, name):
    pytest.importorskip("pandas")
    frame = getattr(results, name).to_pandas()
    assert frame.shape[0] > 0
    assert frame.shape[1] > 1


def test_a_run_tells_scenario_controller_and_errors(run):
    before, after = (1e3 * phase.rms_rad["all"] for phase in run.record.phases)
    assert repr(run) == (
        "Run(seal_wear, static_feedforward on knee_bench, seed 0, 2 s: "
        f"RMS error {before:.3g} mrad before, {after:.3g} mrad after)"
    )
    assert repr(run.history) == "History(1001 periods of 1 joints, 2 s)"
    pytest.importorskip("pandas")
    frame = run.to_pandas()
    assert frame.loc[("after", "knee"), "rms_rad"] == run.record.phases[1].rms_rad["knee"]


def test_a_recording_tells_samples_and_columns_and_keeps_its_numbers():
    columns = {"knee_position": [0.0, 1.0, np.nan], "<b>": [1.0, 2.0, 3.0]}
    recording = Recording(time=[0.0, 0.5, 1.0], columns=columns)
    assert repr(recording) == "Recording(3 samples over 1 s at 2 Hz; 2 columns: knee_position, <b>)"
    assert "&lt;b&gt;" in recording._repr_html_()
    with pytest.raises(LeglabError, match="unknown column 'hip'"):
        recording.plot("hip")
    assert len(recording.plot("knee_position", "<b>")) == 2  # of two units
    assert repr(Recording(time=[0.0], columns={})) == "Recording(1 sample; 0 columns)"
    pytest.importorskip("pandas")
    frame = recording.to_pandas()
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame["knee_position"], recording["knee_position"])


def test_a_comparison_tells_what_is_in_its_file(results):
    assert repr(results.compared) == (
        "ComparisonResult(seal_wear by pd, static_feedforward on knee_bench, 2 seeds)"
    )
    pytest.importorskip("pandas")
    cell = results.compared["results"]["seal_wear"]["pd"]["after_rad"]
    frame = results.compared.to_pandas()
    assert frame.loc[("seal_wear", "pd"), "after_rad"] == cell["mean"]
    assert frame.loc[("seal_wear", "pd"), "after_rad_half"] == cell["half_width"]


def test_a_diagnosis_tells_what_is_missing(results):
    effect = results.diagnosis.effects[0]
    assert repr(results.diagnosis).startswith(f"Diagnosis(confusion_set: {effect.name} at ")
    found = SimpleNamespace(judged=SimpleNamespace(verdict="named"), named=(("a", "b"),))
    assert Outcome.__repr__(found) == "Outcome(named: a at b)"


def test_without_pandas_one_line_says_so(monkeypatch, run):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LeglabError, match="^to_pandas needs pandas: pip install pandas$"):
        run.recording.to_pandas()


def test_a_run_knows_the_units_of_its_columns():
    run = run_scenario(RunSettings(scenario="payload", model="leg_rail", duration=0.1))
    units = run.recording.metadata["units"]
    assert units["rail_position"] == units["rail_truth"] == "m"
    assert units["knee_position"] == units["knee_truth"] == units["knee_reference"] == "rad"
    assert units["knee_truth_velocity"] == "rad/s"
    assert units["shank_added_mass"] == "kg"
    assert not [unit for unit in units.values() if " or " in unit]
    assert units.keys() == set(run.recording.columns)


def test_a_sweep_tells_medians_and_draws_every_run(results):
    swept = results.swept
    assert repr(swept) == f"SweepResult(12 of 12 runs, 1 failed; {swept.folder})"
    table = [row.split("</td>") for row in swept._repr_html_().split("<tr>")[2:]]
    cells = [[cell.rpartition("<td>")[2] for cell in row[:-1]] for row in table]
    # Errors at the end are 10 mrad a run; run 1 failed, so pd has 0 and 2 to 5.
    assert cells[0] == ["seal_wear", "pd", "6", "1", "10", "40", "94", "0.5"]
    assert cells[1] == ["seal_wear", "bsnn_arx", "6", "0", "10", "95", "83", "1"]
    (axis,) = swept.plot()
    drawn = {line.get_ydata()[0]: list(line.get_xdata()) for line in axis.lines}
    assert drawn["pd"] == pytest.approx([10.0, 30.0, 40.0, 50.0, 60.0])
    assert [bar.get_width() for bar in axis.patches] == pytest.approx([40.0, 95.0])
    answer = ask(swept.folder, "SELECT run, severity FROM runs ORDER BY run")
    assert repr(answer) == "Answer(12 rows; 2 columns: run, severity)"
    assert len(Elements(answer._repr_html_()).all("tr")) == 13
    pytest.importorskip("pandas")
    assert list(answer.to_pandas()["severity"]) == [3.0] * 3 + [25.0] * 3 + [3.0] * 3 + [25.0] * 3
