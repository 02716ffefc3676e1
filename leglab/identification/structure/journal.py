"""File of search results, one JSON line per result, from which a search can resume."""

import json
from collections import defaultdict
from pathlib import Path

import numpy as np

from leglab.identification.storage import decode, encode
from leglab.identification.structure.fit import Fit
from leglab.identification.structure.library import Orders
from leglab.identification.structure.plans import Candidate, Plan


class Journal:
    """File of candidates; `kept` holds the candidates that an interrupted search wrote.

    Args:
        path: The file; a file with another key is overwritten.
        key: Digest of data and code, for which the results are valid.
    """

    def __init__(self, path: Path, key: str) -> None:
        self.path = path
        self.kept: dict[str, dict[Plan, Candidate]] = defaultdict(dict)
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        self._whole = [key]  # valid lines, which the next `keep` writes to a new file
        if lines[:1] != [key]:
            return
        for line in lines[1:]:
            try:
                output, candidate = _read(line)
            except (ValueError, LookupError, TypeError):
                break  # incomplete: the earlier search was interrupted while it wrote this line
            self.kept[output][candidate.plan] = candidate
            self._whole.append(line)

    def keep(self, output: str, candidate: Candidate) -> None:
        """Appends a result to the file."""
        with self.path.open("w" if self._whole else "a", encoding="utf-8") as stream:
            stream.writelines(f"{line}\n" for line in (*self._whole, _line(output, candidate)))
        self._whole = []

    def done(self) -> None:
        """Removes the file, which a completed search no longer needs."""
        self.path.unlink(missing_ok=True)


def _line(output: str, candidate: Candidate) -> str:
    plan, orders = candidate.plan, candidate.plan.orders
    content = {
        "output": output,
        "plan": [plan.kind, plan.length, plan.strength, plan.most, plan.budget, plan.sketch],
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
    kind, *rest = content["plan"]
    plan = Plan(kind, Orders(outputs, inputs, tuple(delays)), *rest)
    fit = Fit(decode(content["features"]), np.array(content["theta"]), content["error"])
    held_out = tuple(map(tuple, content["held_out"]))
    return content["output"], Candidate(plan, fit, held_out, tuple(content["path"]))
