"""Blind cases on the two rigs without hydraulics: `python -m benchmarks diagnosis_rigs`.

Sizes are random; recordings come from rigs, which knows nothing of leglab's effects. Prints
one line a case and how many were named.
"""

import math
from dataclasses import fields

import numpy as np

from leglab.diagnosis.intake.recordings import held_out_choice
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.verdict.verdict import diagnose
from rigs import PENDULUM, SLIDE_AXIS, Truth, record

KINDS = ("multisine", "slow", "fast", "stairs")


def draw(rng, rounds=4):
    for i in range(rounds):
        side = ("forward", "backward")[i % 2]
        tolerance = {"viscous_factor": rng.uniform(0.9, 1.1)}
        yield "asymmetric_friction", SLIDE_AXIS, {side: rng.uniform(1.5, 12.0), **tolerance}
        yield (
            "load_dependent_friction",
            PENDULUM,
            {"gear_loss": rng.uniform(0.03, 0.3), **tolerance},
        )
        play = math.exp(rng.uniform(math.log(0.006), math.log(0.08)))
        yield "backlash", PENDULUM, {"play": play, **tolerance}
        yield "", (SLIDE_AXIS, PENDULUM)[i % 2], {"viscous_factor": rng.uniform(0.85, 1.15)}


def main():
    right = total = 0
    for number, (name, rig, values) in enumerate(draw(np.random.default_rng(7))):
        truth = Truth(**values)
        recordings = {
            kind: record(rig, kind, truth, seed=100 + 10 * number + i, seconds=6.0)
            for i, kind in enumerate(KINDS)
        }
        held_out = held_out_choice(recordings, Machine(rig.model))
        result, _ = diagnose(rig.model, recordings, held_out=held_out)
        found = [effect.name for effect in result.effects]
        right += found == ([name] if name else [])
        total += 1
        hidden = {f.name: round(values[f.name], 4) for f in fields(Truth) if f.name in values}
        fitted = [
            (p.name, round(p.value, 4)) for effect in result.effects for p in effect.parameters
        ]
        print(
            f"{rig.joint:5s} {name or 'nothing':24s} {hidden} -> {result.verdict} {found} {fitted} "
            f"gap {result.gap.before:.2f} -> {result.gap.after:.2f}, {result.seconds:.0f} s",
            flush=True,
        )
    print(f"{right} of {total} right")
