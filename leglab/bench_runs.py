"""Recordings of a machine before and after its changes, for identification offline."""

from collections.abc import Callable
from dataclasses import replace

from leglab.control import ReferencePoint
from leglab.feedforward.offline import BenchRun
from leglab.recording import Recording
from leglab.rollout import History
from leglab.scenario import Scenario

# Seed of the recordings: none that a comparison uses.
BENCH_SEED = 1_000_003

_DURATION = 40.0  # s
_SETTLED = 10.0  # from then on the recorded motion is near the reference [s]
_cache: dict[str, BenchRun] = {}

Recorder = Callable[[Scenario], tuple[Recording, History]]


def bench_runs(record: Recorder, scenario: Scenario, key: str) -> tuple[BenchRun, BenchRun]:
    """Records both machines; what was recorded before under the same key is used again.

    Args:
        record: Runs a scenario with the adaptive controller.
        scenario: Whose changes are looked at.
        key: Tells everything else that the recordings depend on.
    """
    before = replace(scenario, duration=_DURATION, changes=())
    after = replace(scenario.changed_from_start(), duration=_DURATION)
    return _bench_run(record, before, key), _bench_run(record, after, key)


def _bench_run(record: Recorder, scenario: Scenario, key: str) -> BenchRun:
    key = f"{key} {scenario!r}"
    if key not in _cache:
        recording, history = record(scenario)
        kept = recording.time >= _SETTLED
        _cache[key] = BenchRun(
            time=recording.time[kept],
            position=recording.stack(recording.joints, "position")[kept],
            command=history.command[kept],
            reference=ReferencePoint(*(part[kept] for part in history.reference)),
        )
    return _cache[key]
