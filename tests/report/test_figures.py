import threading
import time

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.image import imread

from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.base.scenario import Phase
from leglab.report.figures import (
    add_panels,
    command_figure,
    outline,
    pressure_figure,
    save_run_figures,
    tracking_figure,
)
from leglab.report.style import VERMILION, style

STEP = (Phase(name="before", start=0, end=2), Phase(name="after", start=2, end=4))
RAMP = (
    Phase(name="before", start=0, end=2),
    Phase(name="during", start=2, end=2.5),
    Phase(name="after", start=2.5, end=4),
)


def run(joints=("knee",), n=401):
    time = np.arange(n) * 0.01
    columns = {"supply_pressure": np.full(n, 1.6e7)}
    for i, joint in enumerate(joints):
        wave = np.sin((3 + i) * time)
        columns[f"{joint}_reference"] = wave
        columns[f"{joint}_position"] = wave - np.where(time < 2, 0.01, 0.03)
        columns[f"{joint}_valve_command"] = np.clip(1.2 * wave, -1, 1)
        columns[f"{joint}_pressure_a"] = 8e6 + 1e6 * wave
        columns[f"{joint}_pressure_b"] = 8e6 - 1e6 * wave
    return Recording(time=time, columns=columns)


def curves(axes):
    return [line for line in axes.lines if len(line.get_xdata()) > 2]


def change_marks(axes):
    return [line.get_xdata()[0] for line in axes.lines if line.get_color() == VERMILION]


def test_tracking_draws_reference_measurement_and_error():
    recording = run()
    figure = tracking_figure(recording, phases=STEP, window=1.0, title="seal_wear")
    top, bottom = figure.axes
    reference, measured = curves(top)
    error, moving = curves(bottom)
    np.testing.assert_array_equal(reference.get_ydata(), recording["knee_reference"])
    np.testing.assert_array_equal(measured.get_ydata(), recording["knee_position"])
    np.testing.assert_allclose(error.get_ydata()[[0, -1]], [10, 30])
    np.testing.assert_allclose(moving.get_ydata()[[150, -1]], [10, 30])
    assert (top.get_ylabel(), bottom.get_ylabel()) == ("position [rad]", "error [mrad]")
    assert bottom.get_xlabel() == "time [s]"
    assert top.get_title("right") == "RMS [mrad]: 0 to 2 s 10, 2 to 4 s 30"
    assert [text.get_text() for text in figure.texts] == ["seal_wear"]


@pytest.mark.parametrize("draw", [tracking_figure, pressure_figure, command_figure])
def test_the_change_is_marked_everywhere(draw):
    for axes in draw(run(), phases=STEP).axes:
        assert change_marks(axes) == [2]
        assert not axes.patches
    for axes in draw(run(), phases=RAMP).axes:
        assert change_marks(axes) == [2]
        (shade,) = axes.patches
        assert (shade.get_x(), shade.get_width()) == (2, 0.5)
    for phases in ((), (Phase(name="whole", start=0, end=4),)):
        assert all(change_marks(axes) == [] for axes in draw(run(), phases=phases).axes)


def test_a_span_shows_its_samples_alone():
    figure = tracking_figure(run(), phases=STEP, window=1.0, span=(1.5, 2.5))
    for axes in figure.axes:
        for line in curves(axes):
            assert (line.get_xdata()[0], line.get_xdata()[-1]) == (1.5, 2.49)
    # The numbers are those of whole phases, and the moving RMS looks back before the span.
    assert "0 to 2 s 10, 2 to 4 s 30" in figure.axes[0].get_title("right")
    assert not np.isnan(curves(figure.axes[1])[1].get_ydata()).any()
    with pytest.raises(LeglabError, match="no sample in"):
        tracking_figure(run(), span=(7, 8))


def test_pressures_are_in_bar():
    (axes,) = pressure_figure(run()).axes
    supply, cap, rod = (line.get_ydata() for line in curves(axes))
    assert supply[0] == 160
    assert (cap[0], rod[0]) == (80, 80)
    assert axes.get_ylim() == (0, pytest.approx(168))
    assert axes.get_ylabel() == "pressure [bar]"


def test_saturation_is_marked():
    recording = run()
    (axes,) = command_figure(recording).axes
    _, at_limit = curves(axes)
    saturated = np.abs(recording["knee_valve_command"]) >= 1
    marked = np.isin(recording.time, at_limit.get_xdata()[~np.isnan(at_limit.get_ydata())])
    edges = np.abs(np.diff(saturated, prepend=0, append=0)).astype(bool)
    # The first and the last sample of each time at the limit; a line of it lies between them.
    np.testing.assert_array_equal(marked, saturated & (edges[1:] | edges[:-1]))
    assert axes.get_title("right") == f"at the limit {100 * saturated.mean():.1f} % of the time"
    calm = recording.with_columns({"knee_valve_command": 0.1 * recording["knee_reference"]})
    (axes,) = command_figure(calm).axes
    assert len(curves(axes)) == 1
    assert axes.get_title("right") == ""


def test_a_long_line_is_drawn_through_its_extremes():
    values = np.random.default_rng(3).normal(size=100_003)
    values[:70] = np.nan
    values[[70, 51_234, 100_002]] = -30.0, 40.0, -50.0
    rows = outline(values)
    assert rows.size <= 20_002
    assert (np.diff(rows) > 0).all()
    assert {0, 70, 51_234, 100_002} <= set(rows.tolist())
    # No sample is farther than a piece from a drawn one that is as low, and one that is as high.
    for first in range(80, 90_000, 9_000):
        piece, drawn = (
            values[first : first + 10],
            values[rows[(rows >= first - 11) & (rows < first + 21)]],
        )
        assert drawn.min() <= piece.min() <= piece.max() <= drawn.max()
    np.testing.assert_array_equal(outline(values[:20_000]), np.arange(20_000))


@pytest.mark.parametrize("count", range(1, 8))
def test_panels_lie_inside_the_figure_and_do_not_touch(count):
    figure, panels = add_panels(count, heights=(1.0, 0.5))
    boxes = [axes.get_position() for panel in panels for axes in panel]
    assert len(panels) == count
    for i, box in enumerate(boxes):
        assert 0 < box.x0 < box.x1 < 1
        assert 0 < box.y0 < box.y1 < 1
        assert not any(box.overlaps(other) for other in boxes[i + 1 :])
    labelled = sum(axes.get_xlabel() == "time [s]" for axes in figure.axes)
    assert labelled == (1 if count <= 2 else 2)


def test_missing_columns_are_named():
    recording = run()
    for alone in ("knee_position", "knee_reference"):
        with pytest.raises(LeglabError, match="no joint has '_position' and '_reference'"):
            tracking_figure(recording.select([alone]))
    with pytest.raises(LeglabError, match="no column ends in '_pressure_a'"):
        pressure_figure(recording.select(["knee_position"]))
    with pytest.raises(LeglabError, match="no column ends in '_command'"):
        command_figure(recording.select(["knee_position"]))


def test_saves_what_there_is_to_draw(tmp_path):
    recording = run(("hip_pitch", "knee", "ankle_pitch"))
    paths = save_run_figures(recording, tmp_path, phases=RAMP, window=0.5, title="cold_oil")
    names = ["tracking.png", "tracking_change.png", "pressures.png", "commands.png"]
    assert [path.name for path in paths] == names
    for path in paths:
        pixels = imread(path)[..., :3]
        assert pixels.shape[0] > 400
        assert pixels.shape[1] > 800
        assert 0.01 < (pixels < 0.9).any(axis=2).mean() < 0.5
    again = tmp_path / "again"
    again.mkdir()
    same = save_run_figures(recording, again, phases=RAMP, window=0.5, title="cold_oil")
    assert [path.read_bytes() for path in same] == [path.read_bytes() for path in paths]
    bare = recording.select(["knee_position", "knee_reference"])
    assert [path.name for path in save_run_figures(bare, tmp_path)] == ["tracking.png"]


def test_other_figures_keep_their_look():
    before = dict(mpl.rcParams)
    command_figure(run())
    assert dict(mpl.rcParams) == before


def test_settings_of_the_caller_come_back_from_threads_that_overlap():
    def draw(begin, last):
        time.sleep(begin)
        with style():
            time.sleep(last)

    with mpl.rc_context({"lines.linewidth": 3.0, "font.size": 17.0}):
        before = dict(mpl.rcParams)
        threads = [threading.Thread(target=draw, args=a) for a in ((0.0, 0.1), (0.03, 0.2))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert dict(mpl.rcParams) == before
