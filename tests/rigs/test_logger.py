"""The rig that is not there: its logger's files are its recordings, by a column map."""

import numpy as np
import pytest

from leglab import data
from leglab.base.errors import LeglabError
from leglab.data import ColumnMap
from leglab.data.column_map import ColumnRule
from rigs.logger import RigSettings, main, record, write_rig

SHORT = RigSettings(effects=("valve_deadband",), motions=("walk",), seconds=1.0, seed=3)
MAP = ColumnMap(
    rules={
        "t_ms": ColumnRule(name="time", factor=1e-3),
        "enc_deg": ColumnRule(name="knee_position", factor=-np.pi / 180),
        "valve_V": ColumnRule(name="knee_valve_command", factor=0.1),
        "cap_bar": ColumnRule(name="knee_pressure_a", factor=1e5),
        "rod_bar": ColumnRule(name="knee_pressure_b", factor=1e5),
    }
)


def test_the_file_is_the_recording(tmp_path):
    (path,) = write_rig(SHORT, tmp_path)
    read = data.read(path, columns=MAP)
    recordings, (hidden,) = record(SHORT)
    true = recordings["walk"]
    assert "1 exact repetitions" in read.metadata["repairs"][0]
    assert len(true) - 10 < len(read) <= len(true)
    for name, values in true.columns.items():
        between = np.interp(read.time, true.time, values)
        # A command is held, and a held one may be one sample older than the interpolated one.
        room = np.abs(np.diff(values)).max() if name.endswith("_command") else 1e-6 * np.ptp(values)
        assert np.abs(read[name] - between).max() <= room + 1e-3 * np.ptp(values)
    assert hidden.parameter == "lap"
    assert (tmp_path / "truth.txt").read_text() == f"valve_deadband: lap = {hidden.value:.5g}\n"


def test_same_seed_same_bytes(tmp_path):
    one, two = (write_rig(SHORT, tmp_path / name)[0].read_bytes() for name in "ab")
    assert one == two


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (RigSettings(effects=("valve_deadbnd",)), "did you mean 'valve_deadband'"),
        (RigSettings(motions=("wlak",)), "did you mean 'walk'"),
        (RigSettings(seconds=0.1), "allowed: 1 or more"),
    ],
)
def test_what_it_refuses(settings, message):
    with pytest.raises(LeglabError, match=message):
        record(settings)


def test_errors_are_one_line(tmp_path):
    with pytest.raises(SystemExit, match="error: unknown fault of the rig 'leak'"):
        main([str(tmp_path), "--effect", "leak"])
