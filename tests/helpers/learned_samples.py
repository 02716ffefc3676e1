"""Made-up samples of a learner, and a bank of faults for them."""

import numpy as np

from leglab.causes.fault_names import ALL
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from leglab.control.feedforward.fault_monitor import FaultMonitor, MonitorConfiguration

JOINTS, PARAMETERS, PERIOD, BLOCK = ("hip", "knee"), 6, 0.004, 5
CONFIG = MonitorConfiguration(warm_up=200, slow_window=100)
CHANGE, END = 4.0, 8.0  # s


def curve(rng, fault, element=ALL):
    shifts = 0.1 * rng.standard_normal((3, len(JOINTS), PARAMETERS))
    shifts[0] = 0.0
    if element != ALL:
        shifts[:, 1 - JOINTS.index(element)] = 0.0
    sizes = np.array([1.0, 4.0, 9.0])
    return FaultCurve(fault=fault, element=element, meaning="ratio", sizes=sizes, shifts=shifts)


def make_bank(rng):
    names = [("leak", ALL), ("leak", "knee"), ("rub", ALL), ("rub", "hip"), ("rub", "knee")]
    return FaultBank(curves=tuple(curve(rng, *name) for name in names))


def stream(monitor, true, *, seed=1, excited=None, end=END, learned=()):
    """Feeds samples of a map `true(time)`; the learner is a fixed one that takes the best proposal.

    At the times in `learned` it has learned the map of then.

    Returns:
        Its parameters at the end, and all proposals with their time.
    """
    rng = np.random.default_rng(seed)
    parameters, given = true(0.0).copy(), []
    for number in range(int(end / PERIOD / BLOCK)):
        time = (number + 1) * BLOCK * PERIOD
        times = time - PERIOD * np.arange(BLOCK)[::-1]
        regressor = rng.standard_normal((BLOCK, len(JOINTS), PARAMETERS))
        if excited is not None:
            regressor *= excited(time)
        output = np.array(
            [np.einsum("jp,jp->j", r, true(t)) for r, t in zip(regressor, times, strict=True)]
        )
        output += 1e-3 * rng.standard_normal(output.shape)
        error = output - np.einsum("njp,jp->nj", regressor, parameters)
        parts = (regressor, output[..., None], error[..., None], np.ones((*error.shape, 1)))
        proposals = monitor.take(time, np.concatenate(parts, axis=-1), parameters)
        if proposals:
            given.append((time, proposals))
            parameters = max(proposals, key=lambda p: p.odds).parameters
        if any(time - BLOCK * PERIOD < at <= time for at in learned):
            parameters = true(time).copy()
    return parameters, given


def planted(shift, rng):
    base = rng.standard_normal((len(JOINTS), PARAMETERS))
    return base, lambda time: base + (time > CHANGE) * shift


def monitor_of(bank):
    return FaultMonitor(bank, JOINTS, CONFIG, sample_period=PERIOD)
