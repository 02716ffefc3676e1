"""Folders of runs made up by hand, in the form that a run leaves behind."""

import json
from html.parser import HTMLParser

import numpy as np

from leglab import data
from leglab.base.recording import Recording

HOSTILE = '</script><img src=x onerror="window.hit=1"><script>window.hit=1</script>&\'{{7*7}}\x00'


def write_folder(
    folder,
    controller="pd",
    *,
    before=0.020,
    after=0.030,
    damage=None,
    t90=None,
    stopped=None,
    fallback=None,
    scenario="seal_wear",
    model="leg",
    joints=("hip", "knee"),
    seed=0,
    change=5.0,
    duration=10.0,
):
    """Writes a run whose errors are sines with these RMS values [rad] before and after the change.

    A run that is `stopped` at a time [s] is cut off there. `fallback` is the share of the time.
    With a `damage` [rad] there is a frozen twin, without one the run's own peak.
    """
    levels = {name: dict.fromkeys([*joints, "all"], v) for name, v in (("b", before), ("a", after))}
    lost = after - before if damage is None else damage
    told = change >= 2.0 and stopped is None
    end = duration if stopped is None else stopped
    time = np.arange(0.0, end, 0.004)
    columns = {}
    for i, joint in enumerate(joints):
        reference = np.sin(2 * np.pi * time + i)
        size = np.where(time < change, before, after) * np.sqrt(2)
        columns[f"{joint}_position"] = reference + size * np.sin(2 * np.pi * time)
        columns[f"{joint}_truth"] = columns[f"{joint}_position"]
        columns[f"{joint}_reference"] = reference
        columns[f"{joint}_valve_command"] = 0.3 * reference
        columns[f"{joint}_feedforward"] = 0.2 * reference
        columns[f"{joint}_pressure_a"] = 8e6 + 1e6 * reference
        columns[f"{joint}_pressure_b"] = 8e6 - 1e6 * reference
        columns[f"{joint}_oil_temperature"] = 40.0 + 0.5 * time
        if fallback is not None:
            columns[f"{joint}_fallback"] = (time % 1.0 < fallback).astype(float)
    parts = [("before", 0.0, change, before), ("after", change, duration, after)]
    metrics = {
        "scenario": scenario,
        "controller": controller,
        "model": model,
        "seed": seed,
        "duration": float(time[-1]) if stopped else duration,
        "severity": 10.0,
        "completed": stopped is None,
        "failure": None if stopped is None else "the knee blew up",
        "phases": [
            {
                "name": name,
                "start": start,
                "end": stop,
                "rms_rad": dict.fromkeys([*joints, "all"], level),
                "peak_rad": dict.fromkeys([*joints, "all"], 1.4142 * level),
                "p95_rad": dict.fromkeys([*joints, "all"], 1.4 * level),
                "effort": dict.fromkeys([*joints, "all"], 0.2),
                "energy_j": dict.fromkeys([*joints, "all"], 500.0),
            }
            for name, start, stop, level in parts
            if start < end
        ],
        "adaptation": {
            "span_s": 2.0,
            "stride_s": 1.0,
            "before_rad": levels["b"] if told else None,
            "end_rad": levels["a"] if told else None,
            "damage_rad": lost if told else None,
            "damage_of": "own peak" if damage is None else "frozen twin",
            "recovered": 1.0 - (after - before) / lost if told else None,
            "t90_s": t90,
            "level_rad": before + 0.1 * lost if told else None,
            "reason": None if told else "it is made up",
        },
        "excess_error_area_rad_s": 0.01,
    }
    run = {
        "settings": {
            "scenario": scenario,
            "controller": controller,
            "model": model,
            "duration": duration,
            "seed": seed,
            "severity": 10.0,
            "ramp_duration": 0.0,
            "reference": "walking_stride",
            "sensors": {"control_period": 0.004},
        },
        "window": 1.0,
        "changes": [
            {
                "parameter": "internal_leakage",
                "element": "*",
                "kind": "scale",
                "value": 10.0,
                "start": change,
                "ramp_duration": 0.0,
            }
        ],
        "versions": {"leglab": "0.1.0", "mujoco": "3.17.0"},
    }
    folder.mkdir(parents=True)
    data.write(Recording(time=time, columns=columns), folder / "recording.parquet")
    (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "run.json").write_text(json.dumps(run))
    return folder


class Elements(HTMLParser):
    """Tags with attributes in order, and the text outside scripts and styles."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts, self._silent = [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self._silent = tag in ("script", "style")

    def handle_endtag(self, tag):
        self._silent = False

    def handle_data(self, content):
        if not self._silent:
            self.texts.append(content)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]
