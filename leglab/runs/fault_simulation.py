"""Fault bank: simulation of the nominal machine with every fault, at commissioning.

It simulates a separate machine, so no information on the changes of the actual run can leak in.
"""

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from leglab.base.errors import LeglabError
from leglab.base.scenario import (
    Healthy,
    Options,
    ParameterChange,
    Scenario,
    joint_pattern,
    of_joint,
)
from leglab.causes.fault_names import ALL
from leglab.causes.record import Cause, Side
from leglab.causes.table import CAUSES
from leglab.commissioning.setup import model_digest
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve, Moments
from leglab.control.feedforward.judge import explained_share
from leglab.control.feedforward.thresholds import DISCREPANCY, RIDGE
from leglab.controllers.bsnn_arx import AdaptiveController
from leglab.data import write_atomically
from leglab.jobs.fingerprint import fingerprint
from leglab.machine.changes import healthy_values
from leglab.machine.plugin import headless
from leglab.machine.simulation import Simulation
from leglab.runs.preparation import Preparation, RunSettings, prepared, reference_config

# Numbers of strides: `_SETTLED` before sampling starts, `_SAMPLED` with sampling. For a motion that
# does not repeat, its nominal period counts as a stride.
_SETTLED, _SAMPLED = 3, 3

_SAMPLES = 64  # number of learning samples that are collected before they are added to the moments

# Index and sign of each valve parameter in the valve state (see `FaultCurve.valves`). The null bias
# has a negative sign, because the plugin adds it to the command.
_OF_VALVES = {"null_bias": (0, -1.0), "lap": (1, 1.0), "hysteresis": (2, 1.0)}

_banks: dict[str, FaultBank] = {}


# Makes a closed loop from settings, with the keyword arguments `preparation` and `scenario`.
MakeLoop = Callable[..., Any]


def fault_bank(settings: RunSettings, scenario: Scenario, make_loop: MakeLoop) -> FaultBank:
    """Makes the fault bank for a run's model, sensors and reference, or reads a cached one.

    Banks are stored in `cache_folder()` by a digest of the nominal machine and the settings; a bank
    of another code version is replaced. Making the leg's bank takes half a minute to a minute.

    Args:
        settings: Settings of the run; changes and specimen are not used.
        scenario: Scenario of the run; only its reference is used.
        make_loop: The class `leglab.runs.loop.Loop`.

    Raises:
        LeglabError: A simulation of the nominal machine fails.
    """
    common = replace(
        settings,
        scenario="nominal",
        controller="bsnn_arx",
        controller_config={},
        duration=None,
        severity=None,
        ramp_duration=0.0,
        element=None,
        seed=0,
        tolerance=0.0,
        reference=settings.reference or scenario.reference,
        reference_config=reference_config(replace(settings, vary=False), scenario),
        vary=False,
    )
    preparation = prepared(common)
    told = repr(replace(common, model="")).encode()
    key = hashlib.sha256(model_digest(preparation.nominal) + told).hexdigest()[:32]
    if key not in _banks:
        file = cache_folder() / f"fault_bank_{key}.npz"
        bank = _read(file)
        if bank is None:
            bank = _make(common, preparation, make_loop)
            _write(bank, file)
        _banks[key] = bank
    return _banks[key]


def cache_folder() -> Path:
    """Returns the folder of stored banks: $LEGLAB_CACHE, or `leglab` in the user's cache folder."""
    own = os.environ.get("LEGLAB_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "leglab"


def _write(bank: FaultBank, file: Path) -> None:
    """Stores a bank; does nothing if the folder is not writable, so it is made again next time."""
    names = np.array([(curve.fault, curve.element, curve.meaning) for curve in bank.curves])
    arrays: dict[str, Any] = {"names": names, "code": np.array(fingerprint())}
    for i, curve in enumerate(bank.curves):
        arrays |= {f"sizes_{i}": curve.sizes, f"shifts_{i}": curve.shifts}
        if curve.valves is not None:
            arrays[f"valves_{i}"] = curve.valves
    arrays["explains"] = np.array([curve.explains for curve in bank.curves])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(file, lambda stream: np.savez(stream, **arrays))
    except (OSError, LeglabError):
        return


def _read(file: Path) -> FaultBank | None:
    """Reads a stored bank; None if it is missing, unreadable or of another code version."""
    try:
        with np.load(file, allow_pickle=False) as kept:
            if str(kept["code"]) != fingerprint():
                return None
            return FaultBank(
                curves=tuple(
                    FaultCurve(
                        fault=str(fault),
                        element=str(element),
                        meaning=str(meaning),
                        sizes=kept[f"sizes_{i}"],
                        shifts=kept[f"shifts_{i}"],
                        valves=kept.get(f"valves_{i}"),
                        explains=float(kept["explains"][i]),
                    )
                    for i, (fault, element, meaning) in enumerate(kept["names"])
                )
            )
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, LeglabError):
        return None


def _make(settings: RunSettings, preparation: Preparation, make_loop: MakeLoop) -> FaultBank:
    moments = partial(_moments, settings, preparation, make_loop)
    healthy = moments(())
    base = _solve(healthy)
    # The ridge regressions of the faults shrink towards `base`, the healthy machine's parameters.
    # Even for the healthy machine they give a shift, `drawn`; it is subtracted from all shifts.
    drawn = _solve(healthy.about(base))
    normal = healthy.about(base).power / np.maximum(healthy.count, 1.0)
    joints = preparation.nominal.joints
    curves = []
    for cause, element, side in cases(joints):
        joint = None if element == ALL else element
        values = partial(healthy_values, preparation.nominal, joint=joint)
        first = cause.healthy_magnitude(values)
        shifts, sizes = [np.zeros_like(base)], [first]
        told: list[tuple[ParameterChange, ...]] = [()]
        sums = np.zeros(3)
        for size in cause.magnitudes(side.bank, first):
            changes = _changes(cause, size, joint, values)
            try:
                found = moments(changes)
            except LeglabError:
                break  # the model or joint has no such part, or cannot move at this magnitude
            changed = found.about(base)
            shifts.append(_solve(changed) - drawn)
            sizes.append(size)
            told.append(changes)
            sums += _shown(changed, shifts[-1], normal)
        if len(sizes) > 1:
            curves.append(
                FaultCurve(
                    fault=cause.name,
                    element=element,
                    meaning=cause.meaning,
                    sizes=np.array(sizes),
                    shifts=np.array(shifts),
                    valves=_valves(told, preparation.nominal),
                    # For a fault without an effect beyond noise the share is 0; 1 is stored then.
                    explains=float(explained_share(*sums.tolist())) or 1.0,
                )
            )
    return FaultBank(curves=tuple(curves))


def cases(joints: tuple[str, ...]) -> Iterator[tuple[Cause, str, Side]]:
    """Yields each fault of the bank as cause, element (a joint or "all") and direction."""
    for cause in CAUSES.values():
        for side in cause.sides:
            for element in (ALL, *(joints if cause.per_joint and len(joints) > 1 else ())):
                if side.bank:
                    yield cause, element, side


def _changes(
    cause: Cause, size: float, joint: str | None, values: Healthy
) -> tuple[ParameterChange, ...]:
    """Returns the parameter changes of a cause that is present from the start of the run."""
    changes = cause.changes(cause, Options(duration=0.0, severity=size, healthy=values))
    return changes if joint is None else of_joint(changes, joint)


def _valves(sizes: list[tuple[ParameterChange, ...]], nominal: Simulation) -> np.ndarray | None:
    """Returns `FaultCurve.valves` for the changes by magnitude; None if other parts change, too."""
    if not {change.parameter for changes in sizes for change in changes} <= set(_OF_VALVES):
        return None
    out = np.zeros((len(sizes), len(nominal.joints), 5))
    for row, changes in zip(out, sizes, strict=True):
        changed = Scenario(name="nominal", duration=1.0, changes=changes).value_at
        for j, joint in enumerate(nominal.joints):
            own = ParameterChange(parameter="", element=joint_pattern(joint), value=1.0, start=0.0)
            for element in filter(own.applies_to, nominal.elements):
                for name, (place, sign) in _OF_VALVES.items():
                    if nominal.has(element, name):
                        healthy = nominal.parameter(element, name)
                        row[j, place] = sign * (changed(0.0, name, element, healthy) - healthy)
    return out


def _moments(
    settings: RunSettings, preparation: Preparation, make_loop: MakeLoop, changes: tuple[Any, ...]
) -> Moments:
    """Simulates the nominal machine with changes; returns moments of the learning samples."""
    told = Scenario(name="nominal", duration=1.0, reference=settings.reference or "")
    period = preparation.reference(settings, told).period
    scenario = replace(told, duration=(_SETTLED + _SAMPLED) * period, changes=changes)
    loop = make_loop(settings, preparation=preparation, scenario=scenario)
    controller = loop.controller
    assert isinstance(controller, AdaptiveController)
    learning = controller.adaptation
    sums = Moments(*np.atleast_2d(learning.learner.parameters).shape)
    start = round(_SETTLED * period / loop.period)
    with headless(loop.simulation.model):
        for k in range(loop.count):
            loop.step()
            if k == start:
                learning.keep(_SAMPLES)
            if learning.kept_count() == _SAMPLES or (k == loop.count - 1):
                sums.add(learning.kept())
    loop.close()
    loop.simulation.check()
    return sums


def _shown(changed: Moments, shift: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Computes weighted squared errors: of the fault with and without `shift`, and without fault.

    Moments and shift are relative to the healthy map, whose mean squared errors are `normal`.
    """
    powers = np.stack([changed.about(shift).power, changed.power, changed.count * normal])
    return powers @ changed.weight(normal, DISCREPANCY)


def _solve(moments: Moments) -> np.ndarray:
    """Solves the ridge regression for the parameters, (joints, parameters)."""
    eye = np.eye(moments.information.shape[-1])
    solved = np.linalg.solve(moments.information + RIDGE * eye, moments.correlation[..., None])
    return solved[..., 0]
