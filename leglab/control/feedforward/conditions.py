"""Conditions: reversible changes of a sound machine, such as of oil temperature, but not wear."""

import numpy as np

from leglab.causes.fault_names import ALL
from leglab.causes.table import CAUSES
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve, Moments

# Names of the conditions, each with the names of the faults whose sizes are its values.
CONDITIONS = {
    condition: tuple(cause.name for cause in CAUSES.values() if cause.condition == condition)
    for condition in dict.fromkeys(c.condition for c in CAUSES.values() if c.condition)
}


def with_conditions(bank: FaultBank) -> FaultBank:
    """Returns the bank with curves of `CONDITIONS` in place of the faults that belong to them.

    The value of a condition at the start of a run is unknown. Therefore each tabulated value is the
    start of two curves, one towards larger and one towards smaller values.
    """
    curves = [c for c in bank.curves if not any(c.fault in own for own in CONDITIONS.values())]
    for name, faults in CONDITIONS.items():
        parts = [c for c in bank.curves if c.fault in faults and c.element == ALL]
        nodes: dict[float, np.ndarray] = {}
        for part in parts:
            nodes |= {float(x): y for x, y in zip(part.sizes, part.shifts, strict=True)}
        sizes = sorted(nodes)
        for i, origin in enumerate(sizes):
            for way in (sizes[i:], sizes[i::-1]):
                if len(way) < 2:
                    continue
                shifts = np.array([nodes[size] - nodes[origin] for size in way])
                curves.append(
                    FaultCurve(
                        fault=name,
                        element=ALL,
                        meaning=parts[0].meaning,
                        sizes=np.array(way),
                        shifts=shifts,
                        explains=min(part.explains for part in parts),
                    )
                )
    return FaultBank(curves=tuple(curves))


def conditions_of(bank: FaultBank) -> dict[str, FaultBank]:
    """Returns the curves of each condition in a bank."""
    found = {name: tuple(c for c in bank.curves if c.fault == name) for name in CONDITIONS}
    return {name: FaultBank(curves=curves) for name, curves in found.items() if curves}


def joint_by_joint(
    bank: FaultBank, moments: Moments, normal: np.ndarray, discrepancy: float
) -> tuple[float, np.ndarray]:
    """Fits one condition with a separate value per joint; returns total cost, values (joints,)."""
    cost, values = 0.0, np.zeros(len(normal))
    for joint in range(len(normal)):
        fit = bank.fit(moments, normal, discrepancy, joint)
        best = int(np.argmin(fit.cost))
        cost += float(fit.cost[best])
        values[joint] = fit.size[best]
    return cost, values
