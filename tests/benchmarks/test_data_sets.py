"""The deployed identifier on measured benchmarks; skipped where the recordings are absent."""

import pytest

from benchmarks import data_sets
from benchmarks.data_sets import ACTUATOR, SILVERBOX
from leglab.base.errors import LeglabError
from leglab.identification import SplineNarx
from tests.helpers.measured import or_skip


def free_run_errors(data, structure):
    model = SplineNarx(data_sets.spline_narx(data, **structure))
    return data_sets.free_run_errors(data_sets.train(model, data), data)


def test_silverbox_after_one_online_pass():
    errors = free_run_errors(or_skip(data_sets.silverbox), SILVERBOX)
    assert errors["multisine"] <= 0.50  # mV
    assert errors["arrow, no extrapolation"] <= 0.50
    assert errors["arrow"] <= 2.3


def test_silverbox_without_splines_stays_linear():
    data = or_skip(data_sets.silverbox)
    structure = {**SILVERBOX, "output_lags": (), "output_error_after": 0}
    errors = free_run_errors(data, structure)
    linear = dict(zip(data.tests, data.published["ARX"], strict=True))
    assert errors == pytest.approx(linear, rel=0.02)


def test_actuator_after_one_online_pass():
    errors = free_run_errors(or_skip(data_sets.actuator), ACTUATOR)
    assert errors["second half"] <= 0.55


def test_missing_folder_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("LEGLAB_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(LeglabError, match="nowhere"):
        data_sets.silverbox()


def test_missing_recording_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("LEGLAB_DATA", str(tmp_path))
    with pytest.raises(LeglabError, match="SNLS80mV"):
        data_sets.silverbox()
