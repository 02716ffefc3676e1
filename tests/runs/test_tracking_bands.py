"""Tracking errors of a small matrix stay within committed bands: `helpers/tracking_bands.py`."""

import re

import pytest

from tests.helpers import tracking_bands
from tests.helpers.tracking_bands import CASES, entries, measure, outside, read, settings_of


def test_every_case_has_a_band_and_says_what_made_it():
    assert list(read()) == list(CASES)
    for case, entry in entries().items():
        assert entry["settings"] == settings_of(case)
        assert re.fullmatch(r"[0-9a-f]{7,40}\+?", entry["commit"])
        assert entry["mrad"].keys() == tracking_bands.PARTS.keys()


def test_figures_that_did_not_change_keep_the_commit_that_made_them(tmp_path, monkeypatch):
    measured = {case: dict(figures) for case, figures in read().items()}
    measured["knee_bench"]["end"] *= 1.5
    before = entries()
    text = tracking_bands.bands_text(measured, "abcdef1234")
    monkeypatch.setattr(tracking_bands, "BANDS", tmp_path / "bands.toml")
    (tmp_path / "bands.toml").write_text(text)
    for case, entry in entries().items():
        assert entry["commit"] == ("abcdef1234" if case == "knee_bench" else before[case]["commit"])
        assert entry["mrad"] == tracking_bands.rounded(measured[case])
    # Only some cases measured: the others stay.
    assert tracking_bands.bands_text({}, "f00") == text


def test_a_change_of_numbers_is_shown_before_and_now():
    measured = {case: dict(figures) for case, figures in read().items()}
    measured["knee_bench"]["end"] *= 1.5
    measured["leg walking"]["first"] *= 1.01
    page = tracking_bands.review_page(measured, "abcdef1234")
    rows = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in page.split("<tr>")[1:]]
    assert "1 of 16 cases leave their bands" in page
    old = read()["knee_bench"]["end"]
    assert rows[1][:6] == ["knee_bench", "end", "seal_wear", "bsnn_arx", "knee_bench", "0"]
    assert rows[1][7:] == [f"{old:.4g}", f"{1.5 * old:.4g}", "+50.00%", "left"]
    assert rows[2][:2] + rows[2][-2:] == ["leg walking", "first", "+1.00%", ""]
    assert "<script" not in page


@pytest.mark.slow("our own figures")
@pytest.mark.parametrize("case", CASES)
def test_tracking_error_is_in_its_band(case):
    assert not outside(case, measure(**CASES[case])), (
        "look at the change: python -m tests.helpers.tracking_bands --review out/bands.html; "
        "if it is wanted: --write"
    )


# Half the gain, and half of what each other mechanism of learning is set to.
@pytest.mark.slow("our own figures")
@pytest.mark.parametrize(
    "changed",
    [
        {"initial_gain": 1.5, "change_gain": 1.5},
        {"memory": 4000.0, "least_memory": 20.0},
        {"interval": 4},
        {"change_ratio": 1e9},
    ],
    ids=lambda changed: "-".join(changed),
)
def test_bands_are_narrow_enough_to_see_slower_learning(changed):
    case = "leg walking"
    assert outside(case, measure(**CASES[case], controller_config=changed))
