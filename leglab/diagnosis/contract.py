"""The content of diagnosis.json."""

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from leglab.diagnosis.result import Diagnosis


def content(result: "Diagnosis") -> dict[str, Any]:
    """What diagnosis.json holds; keys are fixed, readers rely on them."""
    gap = result.gap
    return {
        "verdict": result.verdict,
        "effects": [
            {
                "name": e.name,
                "element": e.element,
                "onset": {name: _digits(time) for name, time in e.onset} or None,
                "confidence": _digits(e.confidence),
                "contribution": _digits(e.contribution),
                "parameters": {
                    p.name: {
                        "value": _digits(p.value),
                        "unit": p.unit,
                        "interval": [_digits(x) for x in p.interval],
                        "nominal": _digits(p.nominal),
                    }
                    for p in e.parameters
                },
                "indistinguishable_from": list(e.indistinguishable_from),
            }
            for e in result.effects
        ],
        "where": [
            {
                "residual": w.residual,
                "element": w.element,
                "level": _digits(w.level),
                "region": w.region,
            }
            for w in result.where
        ],
        "not_testable": sorted({n.name for n in result.not_testable}),
        "gap": {
            "metric": gap.metric,
            "noise_floor": gap.noise_floor,
            "before": _digits(gap.before),
            "recalibrated": _digits(gap.baseline),
            "after": _digits(gap.after),
            "closed_fraction": _digits(gap.closed_fraction),
            "held_out": list(gap.held_out),
        },
        "recordings": [
            {
                "name": r.name,
                "held_out": r.held_out,
                "before": _digits(r.before),
                "recalibrated": _digits(r.baseline),
                "after": _digits(r.after),
            }
            for r in result.recordings
        ],
        "ceiling": _digits(result.ceiling),
        "next_experiment": None
        if result.next_experiment is None
        else {
            "name": result.next_experiment.name,
            "description": result.next_experiment.description,
            "rivals": list(result.next_experiment.rivals),
            "separation": _digits(result.next_experiment.separation),
            "separation_now": _digits(result.next_experiment.separation_now),
        },
        "notes": list(result.notes),
        "model": result.model or None,
    }


def _digits(value: float | None) -> float | None:
    """Five significant digits: more would pretend; None for what JSON cannot hold."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.5g}")
