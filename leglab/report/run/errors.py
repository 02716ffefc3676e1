"""Tracking errors of a recording, as the metrics take them."""

import numpy as np

from leglab.runs.folder import ReportedRun
from leglab.runs.metrics import sliding_rms


def position_name(run: ReportedRun) -> str:
    """Ending of the columns with positions: the true ones where they were recorded."""
    whole = all(f"{joint}_truth" in run.recording for joint in run.joints)
    return "truth" if whole else "position"


def tracking_error(run: ReportedRun) -> tuple[np.ndarray, np.ndarray]:
    """Position less reference.

    Returns:
        Times [s], (n,), and errors [rad], (n, joints), of the samples that are whole.
    """
    positions = run.recording.stack(run.joints, position_name(run))
    error = positions - run.recording.stack(run.joints, "reference")
    whole = np.isfinite(error).all(axis=1)
    return run.recording.time[whole], error[whole]


def moving_error(run: ReportedRun) -> tuple[np.ndarray, np.ndarray]:
    """RMS error of all joints over one stride that ends at each time.

    Returns:
        Times [s] and errors [rad], both (n,), from the first full window on.
    """
    time, error = tracking_error(run)
    if not len(time):
        return time, time
    windowed = sliding_rms(time, error, run.configuration.window)
    full = np.isfinite(windowed)
    return time[full], windowed[full]


def fallback_shares(run: ReportedRun) -> dict[str, dict[str, float]] | None:
    """Share of the time that the nominal map stood in for the adapted one.

    Returns:
        By phase and joint; None where the controller has no such state.
    """
    if not all(f"{joint}_fallback" in run.recording for joint in run.joints):
        return None
    values = run.recording.stack(run.joints, "fallback")
    time = run.recording.time
    shares = {}
    for phase in run.metrics.phases:
        part = (time >= phase.start) & (time <= phase.end)
        if part.any():
            mean = np.nanmean(values[part] > 0.5, axis=0)
            shares[phase.name] = dict(zip(run.joints, mean.tolist(), strict=True))
    return shares


def saturation(run: ReportedRun) -> float:
    """Share of the time that at least one valve command was at its limit."""
    actuators = run.recording.actuators
    if not actuators:
        return 0.0
    commands = run.recording.stack(actuators, "command")
    return float(np.mean((np.abs(commands) >= 1.0).any(axis=1)))
