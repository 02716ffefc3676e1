"""A diagnosis made up by hand, for tests of its page, words and figures."""

from dataclasses import replace

import numpy as np

from leglab.diagnosis.result import (
    Calibration,
    Diagnosis,
    Estimate,
    Gap,
    NamedEffect,
    NotTestable,
    Proposal,
    Rank,
    RecordingGap,
    Remaining,
    ResidualTrace,
    Rivals,
    Tried,
    Where,
    WholeRecording,
)
from leglab.report.diagnosis.words import sections


def effect(
    name="valve_deadband",
    element="knee_valve",
    rivals=(),
    onset=(),
    onset_interval=(),
    differences=(),
):
    return NamedEffect(
        name=name,
        element=element,
        group="valve and command",
        physics="No flow while |x| < lap.",
        onset=onset,
        onset_interval=onset_interval,
        differences=differences,
        confidence=0.91,
        contribution=0.8,
        parameters=(
            Estimate(name="lap", unit="1", value=0.05, nominal=0.02, interval=(0.04, 0.06)),
        ),
        indistinguishable_from=rivals,
    )


def trace(recording, channel, unit, seed):
    rng = np.random.default_rng(seed)
    time = np.arange(60) * 0.05
    return ResidualTrace(
        recording=recording,
        channel=channel,
        unit=unit,
        time=time,
        position=np.sin(time),
        velocity=np.cos(time),
        pressure=1e6 * np.sin(3 * time),
        before=rng.normal(size=60) + 2.0,
        after=(0.1 if unit == "rad" else 0.3) * rng.normal(size=60),
        measured=np.sin(time),
        bins=6,
    )


def left(channel, unit, before):
    return Remaining(
        channel=channel,
        unit=unit,
        horizon=0.3,
        before=before,
        after=before / 10.0,
        noise=before / 200.0,
    )


def whole(recording="walk", **changes):
    time = 3.0 + np.arange(5000) * 1e-3
    measured = np.sin(time)
    found = WholeRecording(
        recording=recording,
        joint="knee",
        unit="rad",
        actuator="knee_valve",
        time=time,
        measured=measured,
        before=measured + 0.05,
        after=measured - 0.002,
        correction_before=np.full(5000, 0.3),
        correction_after=np.full(5000, -0.01),
    )
    return replace(found, **changes)


def diagnosis(verdict="named", effects=None, recording="walk", **changes):
    gone = verdict in ("unexplained", "nothing_missing")
    rivals = ("stiction",) if verdict == "confusion_set" else ()
    if effects is None:
        effects = () if gone else (effect(rivals=rivals),)
    tried = (("valve_deadband", "knee_valve"), ("stiction", "knee_valve"), ("payload", "shank"))
    result = Diagnosis(
        verdict=verdict,
        effects=effects,
        where=(Where(residual="hydraulic", element="knee_valve", level=27.0, region="anywhere"),),
        not_testable=(NotTestable(name="backlash", element="knee", reason="needs reversals"),),
        gap=Gap(before=14.2, baseline=12.0, after=1.1, unnamed=13.0, held_out=(recording,)),
        recordings=(
            RecordingGap(name=recording, held_out=True, before=14.2, baseline=12.0, after=1.1),
            RecordingGap(name="slow", held_out=False, before=9.0, baseline=8.0, after=1.0),
        ),
        ranking=tuple(
            Rank(name=n, element=e, gain=g, added=b)
            for (n, e), g, b in zip(tried, (900.0, 300.0, -4.0), (2.0, -12.0, None), strict=True)
        ),
        tried=tuple(
            Tried(names=tried[:n], move="first order", reason=reason, level=level, behind=behind)
            for n, reason, level, behind in (
                (2, "first order promises 950 nats over no effect", 1.1, 7.0),
                (1, "the best set without stiction", 1.2, 0.0),
            )
        ),
        rivals=(
            Rivals(
                names=("valve_deadband", "payload + stiction", "nothing"),
                cost=(1.1, 1.2, 200.0),
                preference=np.array([[0.5, 0.83, 1.0], [0.17, 0.5, 1.0], [0.0, 0.0, 0.5]]),
            ),
        ),
        traces=(
            trace(recording, "knee_position", "rad", 0),
            trace(recording, "knee_pressure_a", "Pa", 1),
        ),
        remaining=(left("knee_position", "rad", 0.024), left("knee_pressure_a", "Pa", 4e5)),
        whole=whole(recording),
        next_experiment=Proposal(
            name="slow sine, 1 Hz",
            description="command slow sine, 1 Hz",
            rivals=("valve_deadband", "stiction"),
            separation=5000.0,
            separation_now=3.0,
        )
        if rivals
        else None,
        notes=("walk: 3 samples are missing",),
        model="improved.xml",
    )
    return replace(result, **changes)


def section(result, title):
    return " ".join(next(s for s in sections(result, "m") if s.title == title).lines)


CALIBRATION = Calibration(
    recordings=(("calm", 30.0, 4.0),),
    estimates=(
        (
            "supply_pressure",
            "supply",
            Estimate(
                name="pressure", unit="Pa", value=2.05e7, nominal=2.1e7, interval=(2e7, 2.1e7)
            ),
        ),
    ),
)
