"""Files of identifiers that somebody else made: refused in one line, never trusted."""

import copy
import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leglab.base.errors import LeglabError
from leglab.identification import BsnnArx, Rls, SplineNarx, SplineNarxSettings, load, save
from leglab.identification.basis import Basis
from leglab.identification.features import Constant, Hammerstein, Lags, Signal, Spline
from tests.identification.test_identification import PAPER

BASIS = Basis.uniform(-1.0, 1.0, 5, outside="linear")
NARX = SplineNarxSettings(
    output=Signal(name="y"),
    inputs=(Signal(name="u"),),
    features=(
        Spline(signal="y", basis=BASIS, times=("u", 1)),
        Hammerstein(signal="u", basis=BASIS),
        Lags(signal="y", count=2),
        Constant(),
    ),
    rls=Rls(forgetting="variable", forgetting_factor=0.98, restore_interval=2),
    output_error_after=20,
)
MODELS = {"paper": lambda: BsnnArx(PAPER), "narx": lambda: SplineNarx(NARX)}


def saved(name: str, folder: Path) -> Path:
    """A file of an identifier that has learned something."""
    model, rng = MODELS[name](), np.random.default_rng(0)
    shape = (60,) if model.joints == 1 else (60, model.joints)
    model.run(rng.uniform(0.0, 0.8, shape), rng.uniform(-0.5, 0.5, shape))
    save(model, folder / "a.id")
    return folder / "a.id"


def parts(path: Path) -> tuple[bytes, dict, bytes]:
    first, line, state = path.read_bytes().split(b"\n", 2)
    return first, json.loads(line), state


def forged(path: Path, header: dict, state: bytes) -> Path:
    """The same file with another content, and a checksum that agrees."""
    header = {**header, "size": len(state), "sha256": hashlib.sha256(state).hexdigest()}
    path.write_bytes(b"leglab-identifier 1\n" + json.dumps(header).encode() + b"\n" + state)
    return path


def try_forged_states(folder: str, name: str) -> None:
    """Loads states with one word changed, and learns on where one is taken."""
    path = saved(name, Path(folder))
    _, header, state = parts(path)
    refusals = []
    for at in range(0, len(state), 4):
        for word in (b"\xff\xff\xff\xff", b"\x00\x01\x00\x00"):
            forged(path, header, state[:at] + word + state[at + 4 :])
            try:
                model = load(path)
            except LeglabError as error:
                refusals.append(str(error))
                continue
            for _ in range(3):
                model.update(0.3, 0.3)
            model.free_run(np.zeros(30))
    assert len(refusals) > len(state) / 20
    assert all("is damaged: " in told and "\n" not in told for told in refusals)


@pytest.mark.parametrize(
    "name", ["paper", pytest.param("narx", marks=pytest.mark.slow("thousands of forged states"))]
)
def test_no_forged_state_reaches_memory_that_is_not_its_own(tmp_path, name):
    # A process of its own: one that writes out of bounds dies, now or later.
    code = (
        f"from tests.identification.{Path(__file__).stem} import try_forged_states\n"
        f"try_forged_states({str(tmp_path)!r}, {name!r})"
    )
    checked = {**os.environ, "MALLOC_CHECK_": "3", "MALLOC_PERTURB_": "85"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[2],
        env=checked,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])


NASTY = (
    None,
    True,
    -1,
    0,
    2**31,
    2**70,
    1e308,
    -1e-320,
    "",
    "x",
    [],
    [[]],
    [1, 2],
    {},
    {"type": "Rls"},
)


def places(value, at=()):
    """Paths to every value within a value."""
    yield at
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*at, key))


@pytest.mark.parametrize("name", MODELS)
def test_headers_with_anything_in_them_get_one_line(tmp_path, name):
    path = saved(name, tmp_path)
    first, header, state = parts(path)
    told = set()
    for at in places(header):
        for nasty in NASTY:
            spoiled = copy.deepcopy({"": header})
            holder = spoiled
            for key in ("", *at)[:-1]:
                holder = holder[key]
            holder[("", *at)[-1]] = nasty
            path.write_bytes(first + b"\n" + json.dumps(spoiled[""]).encode() + b"\n" + state)
            try:
                load(path)
            except LeglabError as error:
                told.add(str(error).count("\n"))
    assert told == {0}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"[" * 100_000, "damaged in its header"),
        (b"[" * 900 + b"]" * 900, "damaged in its header"),
        (b'{"joints": NaN}', "damaged in its header"),
        (b'{"model": "BsnnArx", "joints": Infinity}', "damaged in its header"),
        (b'{"model": "BsnnArx", "joints": 1e400}', "damaged in its header"),
    ],
)
def test_headers_that_are_no_json_of_ours_get_one_line(tmp_path, text, reason):
    path = tmp_path / "a.id"
    path.write_bytes(b"leglab-identifier 1\n" + text + b"\n")
    with pytest.raises(LeglabError, match=rf"a\.id .*{reason}") as error:
        load(path)
    assert "\n" not in str(error.value)


def test_a_count_that_the_state_does_not_bear_out_takes_no_memory(tmp_path):
    path = saved("paper", tmp_path)
    _, header, state = parts(path)
    forged(path, {**header, "joints": 2**31 - 1}, state)
    with pytest.raises(
        LeglabError, match=r"bytes of state, its settings need \d+ for each of 2147"
    ):
        load(path)
    with pytest.raises(LeglabError, match="number of parameters is 5000: must be .* 4096"):
        replace(NARX, features=(Lags(signal="u", count=1000),) * 5)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.id")
    with pytest.raises(LeglabError, match=r"a\.id: cannot be read: it is no regular file"):
        load(tmp_path / "a.id")
