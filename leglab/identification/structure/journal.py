"""Results of a search that was interrupted, one JSON line each."""

import json
from collections import defaultdict
from pathlib import Path

import numpy as np

from leglab.identification.storage import decode, encode
from leglab.identification.structure.fit import Fit
from leglab.identification.structure.library import Orders
from leglab.identification.structure.search import Candidate, Plan


class Journal:
    """Keeps candidates in a file, and finds those of an earlier search with the same key.

    Args:
        path: The file; one with another key is begun anew.
        key: Digest of data and code.
    """

    def __init__(self, path: Path, key: str) -> None:
        self.path = path
        self.kept: dict[str, dict[Plan, Candidate]] = defaultdict(dict)
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        if lines[:1] != [key]:
            path.write_text(key + "\n", encoding="utf-8")
            return
        whole = [key]
        for line in lines[1:]:
            try:
                output, candidate = _read(line)
            except (ValueError, LookupError, TypeError):
                break  # the line in which the earlier search was interrupted
            self.kept[output][candidate.plan] = candidate
            whole.append(line)
        path.write_text("\n".join(whole) + "\n", encoding="utf-8")

    def keep(self, output: str, candidate: Candidate) -> None:
        """Writes a result."""
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(_line(output, candidate) + "\n")

    def done(self) -> None:
        """Removes the file: the search is over."""
        self.path.unlink(missing_ok=True)


def _line(output: str, candidate: Candidate) -> str:
    plan, orders = candidate.plan, candidate.plan.orders
    content = {
        "output": output,
        "plan": [plan.kind, plan.length, plan.strength, plan.most, plan.budget],
        "orders": [orders.outputs, orders.inputs, list(orders.delays)],
        "features": encode(candidate.fit.features),
        "theta": candidate.fit.theta.tolist(),
        "error": candidate.fit.error,
        "held_out": candidate.held_out,
        "path": list(candidate.path),
    }
    return json.dumps(content)


def _read(line: str) -> tuple[str, Candidate]:
    content = json.loads(line)
    outputs, inputs, delays = content["orders"]
    kind, length, strength, most, budget = content["plan"]
    plan = Plan(kind, Orders(outputs, inputs, tuple(delays)), length, strength, most, budget)
    fit = Fit(decode(content["features"]), np.array(content["theta"]), content["error"])
    held_out = tuple(map(tuple, content["held_out"]))
    return content["output"], Candidate(plan, fit, held_out, tuple(content["path"]))
