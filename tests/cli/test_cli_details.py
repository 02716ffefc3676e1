"""`leglab list NAME` and `leglab doctor`: what there is, in full, and what this computer has."""

import json

import pytest

from leglab.cli.options import names_of
from tests.cli.test_cli import leglab


@pytest.mark.parametrize("kind", ["scenarios", "controllers", "references", "effects"])
def test_every_name_is_shown_with_what_can_be_set(kind, capsys):
    for name in names_of(kind):
        status, printed, told = leglab("list", name, "--json", capsys=capsys)
        assert (status, told) == (0, "")
        found = json.loads(printed)[kind.removesuffix("s")]
        assert found["summary"]
        for row in found["rows"]:
            assert all(isinstance(text, str) for text in row.values())
            if kind in ("controllers", "references"):
                assert row["meaning"], f"{name}: {row}"


def test_settings_have_defaults_bounds_and_units(capsys):
    printed = leglab("list", "bsnn_arx", capsys=capsys)[1]
    row = next(line for line in printed.splitlines() if "rate_limit" in line)
    assert row.split()[:5] == ["rate_limit", "50.0", ">", "0", "1/s"]
    assert "--set controller.SETTING=VALUE" in printed


def test_a_name_of_two_kinds_is_shown_as_both(capsys):
    printed = leglab("list", "stiction", "--model", "knee_bench", capsys=capsys)[1]
    assert "stiction, scenario\n" in printed
    assert "--severity 4 (breakaway friction ratio; 1 to 20)" in printed
    assert "stiction, effect\n" in printed
    assert "on knee_valve of knee_bench" in printed


def test_an_unknown_name_is_one_line(capsys):
    status, _, told = leglab("list", "leakage", capsys=capsys)
    assert (status, told.count("\n")) == (2, 1)
    assert "did you mean 'internal_leakage'?" in told


def test_doctor_tells_what_a_report_of_a_bug_needs(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("LEGLAB_CACHE", str(tmp_path))
    (tmp_path / "bank.npz").write_bytes(b"x" * 2_000_000)
    status, printed, _ = leglab("doctor", "--json", capsys=capsys)
    assert status == 0
    found = json.loads(printed)
    assert found["mujoco"] == "3.17.0"
    assert found["plugin"].endswith("libleglab_plugin.so loads, and knee_bench with it")
    assert "egl" in found["opengl"]
    assert "osmesa" in found["opengl"]
    assert "notebook" in found["extras"]
    assert found["cache"] == f"{tmp_path}: 1 files, 2.0 MB"


def test_doctor_says_which_plugin_does_not_load(capsys, monkeypatch):
    import leglab.machine.plugin as plugin

    def broken():
        raise FileNotFoundError("libleglab_plugin.so is not there")

    monkeypatch.setattr(plugin, "library_path", broken)
    status, printed, _ = leglab("doctor", capsys=capsys)
    assert status == 1
    assert "fails: libleglab_plugin.so is not there" in printed
