"""Cutting recordings into windows that start where it is calm."""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.ndimage import maximum_filter1d

from leglab.diagnosis.machine import CYLINDER, Machine
from leglab.diagnosis.series import Channel, Series, filter_difference, noise_level, smoothed

# Smoothing filters reach this far to both sides of a window's start.
MARGIN = 12  # samples
# Windows start at the calmest sample within this share of their length from the regular grid.
_ROOM = 0.35
# A chamber this low may hold vapour, whose amount no pressure sensor tells: no window starts there.
VAPOUR = 2e4  # Pa gauge


@dataclass(kw_only=True)
class Cut:
    """Windows of one series.

    Attributes:
        series: The recording.
        firsts: Samples at which windows start, shape (windows,).
        levers: d(actuator length)/d(joint position) of the cylinders, each (n,).
        smooth: Smoothed samples and their derivative by column, each (n,).
    """

    series: Series
    firsts: np.ndarray
    levers: dict[str, np.ndarray] = field(default_factory=dict)
    smooth: dict[str, tuple[np.ndarray, ...]] = field(default_factory=dict)


def cut_series(
    machine: Machine, series: Series, channels: tuple[Channel, ...], samples: int, lead: int
) -> Cut:
    """Cuts a series into windows of `samples`, none before `lead` samples have passed."""
    last = series.time.size - samples - MARGIN - 1
    unrest = _unrest(machine, series, channels)
    room = round(_ROOM * samples)
    grid = np.arange(max(MARGIN, lead), last + 1, samples)
    calm = [g + int(np.argmin(unrest[g : min(g + room, last) + 1])) for g in grid.tolist()]
    firsts = np.array(calm, dtype=np.int64)
    missing = np.concatenate([[0], np.cumsum(~series.valid)])
    keep = missing[firsts + samples + 1] == missing[firsts - lead]
    for channel in channels:
        if channel.chamber:
            level = smoothed(series.columns[channel.column], channel.filter)
            keep &= level[firsts] > VAPOUR
    cut = Cut(series=series, firsts=firsts[keep])
    for cylinder in machine.instances(CYLINDER):
        cut.levers[cylinder] = _lever(machine, series, cylinder)
    return cut


def _unrest(machine: Machine, series: Series, channels: tuple[Channel, ...]) -> np.ndarray:
    """How badly smoothing serves around each sample, (n,): windows start where it is calm.

    What two filters disagree about, in noise levels, and jumps of the commands.
    """
    total = np.zeros(series.time.size)
    for channel in channels:
        samples = series.columns[channel.column]
        level = noise_level(samples, channel.filter) or 1.0
        length = max(2 * MARGIN - 3, channel.filter[0])
        total += (filter_difference(samples, (length, 4)) / level) ** 2
    for actuator in machine.actuators:
        command = series.columns[f"{actuator}_command"]
        jump = np.abs(np.gradient(command)) / (command.std() or 1.0)
        total += (10.0 * jump) ** 2
    return maximum_filter1d(total, 2 * MARGIN + 1)


def _lever(machine: Machine, series: Series, cylinder: str) -> np.ndarray:
    """d(actuator length)/d(joint position) over a series, shape (n,), every tenth exact."""
    model = machine.base.model
    data = mujoco.MjData(model)
    actuator = model.actuator(cylinder).id
    joint = machine.driven[cylinder][0]
    dof = int(model.joint(joint).dofadr[0])
    moment = np.zeros((model.nu, model.nv))
    chosen = np.arange(0, series.time.size, 10)
    lever = np.empty(chosen.size)
    addresses = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    positions = np.stack([series.columns[f"{name}_position"] for name in machine.joints], 1)
    for i, row in enumerate(positions[chosen]):
        data.qpos[addresses] = row
        mujoco.mj_fwdPosition(model, data)
        mujoco.mju_sparse2dense(
            moment,
            data.actuator_moment,
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind,
        )
        lever[i] = moment[actuator, dof]
    return np.interp(np.arange(series.time.size), chosen, lever)
