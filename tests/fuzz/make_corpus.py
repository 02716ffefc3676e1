"""Writes the beginnings of the corpus: `python -m tests.fuzz.make_corpus`.

Small files of our own, whole ones and some that are wrong on purpose; what a fuzzer found is put
beside them by hand and stays.
"""

import json
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np

from leglab import RunSettings, data
from leglab.base.recording import Recording
from leglab.identification import (
    BsnnArx,
    Identifier,
    Rls,
    SplineNarx,
    SplineNarxSettings,
    SplineStateSpace,
    SplineStateSpaceSettings,
    StateSpace,
    save,
)
from leglab.identification.basis import Basis
from leglab.identification.features import Constant, Lags, Signal, Spline
from tests.fuzz.targets import CORPUS
from tests.helpers.plugin_models import CYLINDER, slides, valve
from tests.helpers.report_folders import write_folder
from tests.identification.test_identification import PAPER

TEXTS = {
    "csv/plain": "time,a,b\n0,1,2\n0.1,1.5,nan\n0.2,,3e5\n",
    "csv/empty_name": "time,,a\n0,1,2\n0.1,2,3\n",
    "csv/quotes": 'time,"a,b","q""x"\r\n0,1,2\r\n0.1,true,2020-01-01\r\n',
    "csv/twice": "time,a,a\n0,1,2\n0,1,2\n-1,1,2\n",
    "csv/short_row": "time,a\n0,1\n0.1\n",
    "csv/no_rows": "time,a\n",
    "column_map/plain": '[columns]\nq = "time"\ne = {name = "a", factor = 0.5, offset = 1.0}\n',
    "column_map/clock": 'clock = "/j"\nstamps = "log"\n[columns]\na = "b"\nc = "b"\n',
    "column_map/digits": "columns = " + "1" * 5000,
    "settings/plain": 'scenario = "seal_wear"\nseed = 3\n[controller]\nname = "pd"\ngain = 1.0\n',
    "settings/sections": 'scenario = "a"\ncontroller_config = 5\n[controller]\nname = "pd"\n',
    "settings/deep": 'scenario = "a"\nsensors = ' + "[" * 2000 + "]" * 2000,
    "settings/digits": 'scenario = "a"\nseed = ' + "1" * 5000,
    "sweep/grid": '[sweep]\nseeds = 2\n[grid]\nscenario = ["nominal", "seal_wear"]\n',
    "sweep/digits": "seeds = " + "1" * 5000,
}
PLANT = SplineNarxSettings(
    output=Signal(name="y"),
    inputs=(Signal(name="u"),),
    features=(
        Spline(signal="y", basis=Basis.uniform(-1.0, 1.0, 4, outside="linear")),
        Lags(signal="y", count=1),
        Constant(),
    ),
    rls=Rls(forgetting="variable", forgetting_factor=0.98, restore_interval=2),
)
STATES = SplineStateSpaceSettings(structure=StateSpace(states=2, delays=(1,), curves=1, splines=4))


def place(name: str) -> Path:
    """File of an input, its folder made."""
    path = CORPUS / name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def main() -> None:
    """Writes all files."""
    for name, text in TEXTS.items():
        place(name).write_bytes(text.encode())
    time = np.arange(4) * 0.1
    columns = {"knee_position": time**2, "knee_valve_command": -time}
    small = Recording(time=time, columns=columns, metadata={"model": "knee_bench"})
    for name, suffix in (
        ("parquet", ".parquet"),
        ("matlab", ".mat"),
        ("mcap", ".mcap"),
        ("sysid", ".npz"),
    ):
        data.write(small, place(f"{name}/plain").with_suffix(suffix)).rename(place(f"{name}/plain"))
    # From the page on sweeps: each of its examples.
    page = Path(__file__).parents[2] / "docs" / "guides" / "sweeps.md"
    for i, text in enumerate(re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL)):
        place(f"sweep/page_{i}").write_text(text)
    folder = write_folder(place("run_json/plain").with_name("made"))
    for name in ("run", "metrics"):
        content = json.loads((folder / f"{name}.json").read_text())
        place(f"{name}_json/plain").write_text(json.dumps(content))
    for path in sorted(folder.rglob("*"), reverse=True):
        path.unlink()
    folder.rmdir()
    settings = json.dumps(asdict(RunSettings(scenario="nominal")))
    place("run_json/settings").write_text(f'{{"settings": {settings}}}')
    models: dict[str, Identifier] = {
        "paper": BsnnArx(PAPER),
        "narx": SplineNarx(PLANT),
        "states": SplineStateSpace(STATES),
    }
    models["states"].parameters = np.linspace(-0.3, 0.3, STATES.structure.count)
    for name, model in models.items():
        model.run(np.linspace(0.0, 0.8, 9), np.linspace(0.5, -0.5, 9))
        save(model, place(f"identifier/{name}"))
    place("model/valve").write_text(slides(valve("v")))
    place("model/unknown").write_text(slides(valve("v", **dict.fromkeys(CYLINDER, "wide"))))
    place("model/broken").write_text(slides(valve("v", lap=0.02, play=1e-3))[:-40])


if __name__ == "__main__":
    main()
