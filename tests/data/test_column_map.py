import numpy as np
import pytest

from leglab import data
from leglab.base.errors import LeglabError


def write(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text)
    return path


def test_names_units_and_signs(tmp_path):
    (tmp_path / "a.csv").write_text("t_ms,enc,u,oil\n0,90,1,300\n1,180,-1,310\n")
    path = write(
        tmp_path,
        """[columns]
        t_ms = {name = "time", factor = 1e-3}
        enc = {name = "knee_position", factor = -0.017453292519943295}
        oil = {name = "oil_temperature", offset = -273.15}
        u = "knee_valve_command"
        """,
    )
    recording = data.read(tmp_path / "a.csv", columns=path)
    np.testing.assert_array_equal(recording.time, [0.0, 1e-3])
    np.testing.assert_allclose(recording["knee_position"], [-np.pi / 2, -np.pi])
    np.testing.assert_allclose(recording["oil_temperature"], [26.85, 36.85])
    np.testing.assert_array_equal(recording["knee_valve_command"], [1, -1])
    assert data.read(tmp_path / "a.csv", columns=data.read_column_map(path)) == recording


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("columns = [", "not a column map in TOML"),
        ("", "map.toml needs the setting 'columns'"),
        ("[columns]", "map.toml needs the setting 'columns'"),
        ("[column]\na = 'b'", "'columns'|unknown setting .*'column'"),
        ("[columns]\nenc = 3", "column 'enc' is 3; allowed: enc = \"our_name\""),
        ("[columns]\nenc = ''", "column 'enc': setting 'name' is ''"),
        ("[columns]\nenc = {factor = 2.0}", "column 'enc' needs the setting 'name'"),
        (
            "[columns]\nenc = {name = 'a', scale = 2.0}",
            "unknown setting of .*column 'enc' 'scale': choose one of factor, name, offset",
        ),
        (
            "[columns]\nenc = {name = 'a', factor = 'x'}",
            "column 'enc': setting 'factor' is 'x': .*number",
        ),
        ("[columns]\nenc = {name = 'a', factor = 0}", "'factor' is 0.* must not be 0"),
        ("[columns]\nenc = {name = 'a', factor = nan}", "'factor' is nan.* finite"),
        ("[columns]\nb = 'a'\nc = 'a'", "'b' and 'c' both become 'a'"),
        ("stamps = 'x'\n[columns]\nb = 'a'", "'stamps' is 'x': .*'header' or 'log'"),
    ],
)
def test_a_wrong_map_is_refused_with_file_key_value_and_choices(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(LeglabError, match=message) as caught:
        data.read_column_map(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_map(tmp_path):
    with pytest.raises(LeglabError, match="none.toml: cannot be read: No such file"):
        data.read_column_map(tmp_path / "none.toml")


TWO = "enc = 'knee_position'\nu = 'knee_valve_command'"


@pytest.mark.parametrize(
    ("text", "rules", "message"),
    [
        ("time,x,y\n0,1,2\n", TWO, "none of .*names 'enc', 'u'; .* has 'time', 'x', 'y'"),
        ("time,enc\n0,1\n", TWO, r"a.csv: no 'u' of the columns of .*map.toml is there"),
        ("time,enc,a\n0,1,2\n", "enc = 'a'", "two columns are called 'a'"),
    ],
)
def test_a_map_of_another_recording_lists_both_sides(tmp_path, text, rules, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(LeglabError, match=message):
        data.read(tmp_path / "a.csv", columns=write(tmp_path, f"[columns]\n{rules}\n"))
