"""Makes the bank of faults: the nominal machine with every fault in simulation, at commissioning.

A machine of its own runs, never that of the run: what happens to that one cannot get here.
"""

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from leglab.base.errors import LeglabError
from leglab.base.fault_names import ALL
from leglab.base.scenario import (
    ParameterChange,
    Scenario,
    get_scenario,
    joint_pattern,
    scenario_per_joint,
    scenario_severity,
)
from leglab.commissioning.setup import model_digest
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve, Moments
from leglab.control.feedforward.judge import explained_share
from leglab.control.feedforward.thresholds import DISCREPANCY, RIDGE
from leglab.controllers.bsnn_arx import AdaptiveController
from leglab.data import write_atomically
from leglab.jobs.fingerprint import fingerprint
from leglab.machine.plugin import headless
from leglab.runs.preparation import Preparation, RunSettings, prepared, reference_config


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Sizes of one scenario's change in the bank."""

    healthy: float  #: Size that changes nothing
    sizes: tuple[float, ...]  #: Sizes on one side of it, from small to large change


# By scenario; a second entry is the other side of the healthy value. New valves have an overlap of
# 0.02 and no hysteresis, so a `valve_wear` below 0.03 is no smaller wear: it mends the overlap.
FAULTS: Mapping[str, tuple[Faults, ...]] = {
    "seal_wear": (Faults(healthy=1.0, sizes=(3.0, 10.0, 25.0)),),
    "external_leak": (Faults(healthy=0.0, sizes=(2e-13, 5e-13, 1e-12)),),
    "friction_rise": (Faults(healthy=1.0, sizes=(2.0, 3.0, 5.0)),),
    "stiction": (Faults(healthy=1.0, sizes=(2.5, 4.0, 7.0)),),
    "spring_fatigue": (Faults(healthy=1.0, sizes=(0.7, 0.4, 0.1)),),
    "valve_wear": (Faults(healthy=0.0, sizes=(0.03, 0.06, 0.1)),),
    "valve_null_shift": (
        Faults(healthy=0.0, sizes=(0.02, 0.05)),
        Faults(healthy=0.0, sizes=(-0.02, -0.05)),
    ),
    "slow_valve": (Faults(healthy=250.0, sizes=(100.0, 60.0, 40.0, 25.0)),),
    "air_in_oil": (Faults(healthy=0.005, sizes=(0.05, 0.15)),),
    "hot_oil": (Faults(healthy=40.0, sizes=(60.0, 80.0, 100.0)),),
    "cold_oil": (Faults(healthy=40.0, sizes=(25.0, 15.0, 7.0, 0.0)),),
    "supply_drop": (Faults(healthy=160.0, sizes=(130.0, 105.0, 80.0)),),
    "supply_droop": (Faults(healthy=1.0, sizes=(0.7, 0.5, 0.35)),),
    "payload": (Faults(healthy=0.0, sizes=(2.5, 5.0, 10.0)),),
}


@dataclass(frozen=True, kw_only=True)
class PartFault:
    """A fault that is one part of a scenario's."""

    of: str  #: The scenario
    sides: tuple[Faults, ...]  #: As in `FAULTS`
    meaning: str  #: What a size says, with its unit
    #: Of a machine that has had a size of it from the start; of elements by a pattern.
    changes: Callable[[float, str], tuple[ParameterChange, ...]]


def _of(kind: str, *parameters: str) -> Callable[[float, str], tuple[ParameterChange, ...]]:
    return lambda size, element: tuple(
        ParameterChange(parameter=name, element=element, kind=kind, value=size, start=0.0)
        for name in parameters
    )


def _leak_of_one_chamber(size: float, element: str) -> tuple[ParameterChange, ...]:
    side = "external_leakage_a" if size > 0 else "external_leakage_b"
    return _of("set", side)(abs(size), element)


PARTS: Mapping[str, PartFault] = {
    "valve_deadband": PartFault(
        of="valve_wear",
        sides=(Faults(healthy=1.0, sizes=(1.5, 3.0, 5.0)),),
        meaning="lap ratio",
        changes=_of("scale", "lap"),
    ),
    "valve_hysteresis": PartFault(
        of="valve_wear",
        sides=(Faults(healthy=0.0, sizes=(0.03, 0.06, 0.1)),),
        meaning="hysteresis, of full spool travel",
        changes=_of("set", "hysteresis"),
    ),
    "coulomb_friction": PartFault(
        of="friction_rise",
        sides=(Faults(healthy=1.0, sizes=(2.0, 3.0, 5.0)),),
        meaning="ratio of Coulomb and breakaway friction",
        changes=_of("scale", "coulomb", "static"),
    ),
    "chamber_leak": PartFault(
        of="external_leak",
        sides=(
            Faults(healthy=0.0, sizes=(5e-13, 1.5e-12, 4.5e-12)),
            Faults(healthy=0.0, sizes=(-5e-13, -1.5e-12, -4.5e-12)),
        ),
        meaning="external leakage of the cap side, negative of the rod side [m^3/s/Pa]",
        changes=_leak_of_one_chamber,
    ),
}

# Strides before samples count, and strides of samples; of a motion that does not repeat, as many
# of its periods.
_SETTLED, _SAMPLED = 3, 3

_SAMPLES = 64  # kept between two looks
_banks: dict[str, FaultBank] = {}


# Makes a closed loop of settings, with a preparation and a scenario by name.
MakeLoop = Callable[..., Any]


def fault_bank(settings: RunSettings, scenario: Scenario, make_loop: MakeLoop) -> FaultBank:
    """Makes the bank for a run's model, sensors and reference, or reads the one made before.

    Banks are kept in `cache_folder()` by a digest of the nominal machine and the settings; one
    of other code is replaced. The leg's takes half a minute to a minute.

    Args:
        settings: Of the run; what happens in it and its specimen do not matter.
        scenario: Of the run, whose reference alone counts.
        make_loop: `leglab.runs.loop.Loop`.

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
    """Where banks are kept: $LEGLAB_CACHE, or leglab in the user's folder of caches."""
    own = os.environ.get("LEGLAB_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "leglab"


def _write(bank: FaultBank, file: Path) -> None:
    """Keeps a bank; where the folder cannot be written to, it is made anew next time."""
    names = np.array([(curve.fault, curve.element, curve.meaning) for curve in bank.curves])
    arrays: dict[str, Any] = {"names": names, "code": np.array(fingerprint())}
    for i, curve in enumerate(bank.curves):
        arrays |= {f"sizes_{i}": curve.sizes, f"shifts_{i}": curve.shifts}
    arrays["explains"] = np.array([curve.explains for curve in bank.curves])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(file, lambda stream: np.savez(stream, **arrays))
    except (OSError, LeglabError):
        return


def _read(file: Path) -> FaultBank | None:
    """A kept bank of this code; None where there is none that can be read."""
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
    # The ridge draws towards the map that it is about: what it takes off a healthy machine's own
    # map is no shift.
    drawn = _solve(healthy.about(base))
    normal = healthy.about(base).power / np.maximum(healthy.count, 1.0)
    joints = preparation.nominal.joints
    curves = []
    for fault, element, faults in cases(joints):
        shifts, sizes = [np.zeros_like(base)], [faults.healthy]
        sums = np.zeros(3)
        for size in faults.sizes:
            try:
                found = moments(_changes(fault, size, element))
            except LeglabError:
                break  # model or joint have no such part, or cannot move with so much of it
            changed = found.about(base)
            shifts.append(_solve(changed) - drawn)
            sizes.append(size)
            sums += _shown(changed, shifts[-1], normal)
        if len(sizes) > 1:
            curves.append(
                FaultCurve(
                    fault=fault,
                    element=element,
                    meaning=_meaning(fault),
                    sizes=np.array(sizes),
                    shifts=np.array(shifts),
                    # A fault that shows nothing beyond noise has no share to go by.
                    explains=float(explained_share(*sums.tolist())) or 1.0,
                )
            )
    return FaultBank(curves=tuple(curves))


def cases(joints: tuple[str, ...]) -> Iterator[tuple[str, str, Faults]]:
    """Faults of the bank with the element that has each: a joint by name, or "all"."""
    for fault, sides in (*FAULTS.items(), *((name, part.sides) for name, part in PARTS.items())):
        for faults in sides:
            yield fault, ALL, faults
            if (fault in PARTS or scenario_per_joint(fault)) and len(joints) > 1:
                for joint in joints:
                    yield fault, joint, faults


def kind(fault: str) -> tuple[str, ...]:
    """A fault of the bank, what it is a part of, and all parts of that."""
    whole = PARTS[fault].of if fault in PARTS else fault
    return whole, *(name for name, part in PARTS.items() if part.of == whole)


def _changes(fault: str, size: float, element: str) -> tuple[ParameterChange, ...]:
    """Parameter changes of a fault on a machine that has had it from the start."""
    if fault in PARTS:
        return PARTS[fault].changes(size, "*" if element == ALL else joint_pattern(element))
    joint = None if element == ALL else element
    return get_scenario(fault, severity=size, element=joint).changed_from_start().changes


def _meaning(fault: str) -> str:
    if fault in PARTS:
        return PARTS[fault].meaning
    severity = scenario_severity(fault)
    return "" if severity is None else severity.meaning


def _moments(
    settings: RunSettings,
    preparation: Preparation,
    make_loop: MakeLoop,
    changes: tuple[Any, ...],
) -> Moments:
    """Samples that the controller learns from on a nominal machine with these changes."""
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
    """Weighted squared errors of a fault, as the monitor weighs: with its shift, without, healthy.

    Moments and shift are about the healthy map, `normal` are its mean square errors.
    """
    powers = np.stack([changed.about(shift).power, changed.power, changed.count * normal])
    return powers @ changed.weight(normal, DISCREPANCY)


def _solve(moments: Moments) -> np.ndarray:
    """Parameters of ridge regression, (joints, parameters)."""
    eye = np.eye(moments.information.shape[-1])
    solved = np.linalg.solve(moments.information + RIDGE * eye, moments.correlation[..., None])
    return solved[..., 0]
