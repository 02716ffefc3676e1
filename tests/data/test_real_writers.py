"""Files by the writers that users have, read with no option or with the map that is proposed."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from leglab import data
from leglab.base.errors import LeglabError
from tests.cli.test_cli import leglab

RATE, ROWS = 50, 300
TIME = np.arange(ROWS) / RATE
POSITION = np.sin(3 * TIME)
EPOCH = 1_700_000_000 * 10**9


def lerobot(root, version, names=("knee.pos", "gripper.pos"), episodes=(0, 1, 2)):
    """A dataset as LeRobot lays it out; positions are smaller by a tenth an episode."""
    rows = [
        {"observation.state": [scale * q, 0.0], "action": [q, 0.0], "timestamp": t}
        | {"frame_index": k, "episode_index": e}
        for e, scale in ((e, 1 - e / 10) for e in episodes)
        for k, (t, q) in enumerate(zip(TIME.tolist(), POSITION.tolist(), strict=True))
    ]
    rows = [r | {"index": i, "task_index": 0, "next.done": False} for i, r in enumerate(rows)]
    pair = pa.list_(pa.float32(), 2) if version == "v3.0" else pa.list_(pa.float32())
    counters = ("frame_index", "episode_index", "index", "task_index")
    fields = {"observation.state": pair, "action": pair, "timestamp": pa.float32()}
    schema = pa.schema(fields | dict.fromkeys(counters, pa.int64()) | {"next.done": pa.bool_()})
    folder = root / "data/chunk-000"
    folder.mkdir(parents=True)
    if version == "v3.0":
        pq.write_table(pa.Table.from_pylist(rows, schema=schema), folder / "file-000.parquet")
    for e in episodes if version == "v2.1" else ():
        own = [row for row in rows if row["episode_index"] == e]
        table = pa.Table.from_pylist(own, schema=schema)
        pq.write_table(table, folder / f"episode_{e:06}.parquet")
    feature = {"dtype": "float32", "shape": [2], "names": names}
    info = {"codebase_version": version, "fps": RATE, "features": {}}
    info["features"] = {"observation.state": feature, "action": feature}
    (root / "meta").mkdir()
    (root / "meta/info.json").write_text(json.dumps(info))
    return root


@pytest.mark.parametrize("names", [["knee.pos", "grip"], {"motors": ["knee.pos", "grip"]}])
@pytest.mark.parametrize("version", ["v3.0", "v2.1"])
def test_an_episode_of_lerobot_is_a_recording_with_columns_by_name(tmp_path, version, names):
    found = data.read_all(lerobot(tmp_path, version, names))
    assert list(found) == ["episode_0", "episode_1", "episode_2"]
    last = found["episode_2"]
    assert {"observation.state/knee.pos", "action/grip"} < last.columns.keys()
    assert not {"index", "timestamp", "frame_index"} & last.columns.keys()
    assert last.time == pytest.approx(TIME, abs=1e-6)
    assert last["observation.state/knee.pos"] == pytest.approx(0.8 * POSITION, abs=1e-6)


def test_one_file_of_a_dataset_and_the_map_that_is_proposed(tmp_path, capsys):
    lerobot(tmp_path / "set", "v3.0")
    file = str(tmp_path / "set/data/chunk-000/file-000.parquet")
    code, shown, _ = leglab("inspect", file, "--recording", "episode_1", capsys=capsys)
    assert code == 0
    assert "3 recordings" in shown
    assert "50 Hz" in shown
    code, _, error = leglab("convert", file, str(tmp_path / "out.csv"), capsys=capsys)
    assert code == 2
    assert "choose by --recording episode_0, episode_1, episode_2" in error
    with pytest.raises(LeglabError, match="unknown recording"):
        data.read(file, recording="episode_9")
