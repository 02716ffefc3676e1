"""Trajectories from a file: recorded or computed positions, approached from the rest pose."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.interpolate import CubicSpline, make_smoothing_spline

from leglab.base.errors import LeglabError, SettingsError
from leglab.base.input import read_bytes
from leglab.base.recording import Recording
from leglab.base.settings import Configuration
from leglab.data import SUFFIXES, read
from leglab.data.units_in_names import NamedUnit, split
from leglab.references.base import Joint, Motion, Samples, register_reference
from leglab.references.blending import scaled, smooth_step

NAME = "file"
# Names of columns with the positions of a joint, in order of preference.
_COLUMNS = ("{}_reference", "{}_position", "{}")
_FEWEST = 5  # minimum number of samples for a smoothing spline


class FromFile(Configuration):
    """Settings of `file`.

    Attributes:
        file: Recording with a column JOINT_reference, JOINT_position or JOINT for each joint that
            moves, in rad unless the column names another unit; any format that `leglab inspect`
            reads.
        digest: SHA-256 of the file, by which a repeated run notices that it has changed; set by
            `--reference FILE`.
        lead: Time from the rest pose to the first sample, and again that in which the clock of the
            file starts from 0, and stops at its end [s]; 0 plays the file as it is.
        repeat: Whether the file, which has to end where it begins, is played again and again.
        smooth: Whether positions are smoothed, by a spline whose stiffness is chosen by
            generalised cross-validation: noise of a sensor would be differentiated twice.
    """

    file: str = ""
    digest: str | None = None
    lead: float = Field(default=1.0, ge=0)
    repeat: bool = False
    smooth: bool = False


def is_file(reference: str | None) -> bool:
    """Tests whether the text given for a reference is a file instead of a name, by its suffix."""
    return Path(reference or "").suffix.lower() in SUFFIXES


def digest_of(file: str | Path) -> str:
    """Returns the SHA-256 of a file.

    Raises:
        LeglabError: The file cannot be read.
    """
    return hashlib.sha256(read_bytes(Path(file))).hexdigest()


@register_reference(NAME, summary="positions from a file", configuration=FromFile)
def from_file(joints: tuple[Joint, ...], config: FromFile) -> tuple[Motion, float]:
    """Makes the motion: to the first sample, then along a cubic spline through all samples.

    The clock of the file starts and stops smoothly: position, velocity and acceleration are
    continuous, and a joint leaves the range between its rest and the file's positions only where
    the spline overshoots. Joints without a column stay at rest.

    Raises:
        LeglabError: The file cannot be read, has changed, or has no column for any joint.
    """
    if not config.file:
        text = "reference 'file' needs the setting "
        raise SettingsError(text, allowed=("file", "or --reference FILE"))
    if config.digest not in (None, digest_of(config.file)):
        text = f"{config.file} has changed since these settings were made; to play it as it is: "
        raise SettingsError(text, given=config.file, allowed=f"--reference {config.file}")
    times, positions = _positions(joints, config)
    if config.repeat:
        positions = _closed(joints, positions, config.file)
    end = "periodic" if config.repeat else "natural"
    spline = CubicSpline(times, positions, bc_type=end)
    length, rest = times[-1], np.array([joint.rest for joint in joints])
    ease = config.lead if config.repeat else min(config.lead, length)

    def clock(since: np.ndarray) -> Samples:
        """Returns the time in the file and its first two derivatives, each (n, 1)."""
        begun = _begun(since, ease)
        if config.repeat:
            return begun._replace(position=begun.position % length)
        ending = _begun(length + ease - since, ease)  # the start, reversed in time
        late = since[:, None] > (length + ease) / 2
        return Samples(
            np.where(late, length - ending.position, begun.position),
            np.where(late, ending.velocity, begun.velocity),
            np.where(late, -ending.acceleration, begun.acceleration),
        )

    def play(at: np.ndarray) -> Samples:
        there = smooth_step(at, 0.0, config.lead)
        first = scaled(rest, positions[0] - rest, there)
        when = clock(at - config.lead)
        value, slope, bend = (spline(when.position[:, 0], k) for k in range(3))
        return Samples(
            first.position + (value - positions[0]),
            first.velocity + slope * when.velocity,
            first.acceleration + bend * when.velocity**2 + slope * when.acceleration,
        )

    return play, length if config.repeat else _cycle(length, positions)


def _begun(since: np.ndarray, ease: float) -> Samples:
    """Returns time, rate and acceleration of a clock whose rate grows from 0 to 1 within `ease`."""
    rate = smooth_step(since, 0.0, ease)
    after = np.maximum(since, 0.0)[:, None]
    s = np.minimum(after / ease, 1.0) if ease else np.ones_like(after)
    gone = ease * s**4 * (2.5 + s * (s - 3.0))  # integral of the rate
    return Samples(gone + np.maximum(after - ease, 0.0), rate.position, rate.velocity)


def played(file: str, joints: Iterable[str]) -> tuple[Recording, dict[str, NamedUnit]]:
    """Reads a file; returns it and, by joint, the column that the joint follows and its unit.

    Raises:
        LeglabError: The file cannot be read, the unit of a column is not one of a position, or no
            joint has a column.
    """
    recording = read(file)
    known = {split(name).stem: name for name in recording.columns}
    found = {}
    for joint in joints:
        stems = [form.format(joint) for form in _COLUMNS]
        stem = next((one for one in stems if one in known), None)
        if stem is None:
            continue
        column = split(known[stem])
        if column.si not in ("", "rad", "m"):
            text = f"{file}: column {known[stem]!r} is no position; allowed are units such as "
            raise SettingsError(text, given=column.unit, allowed=("rad", "deg", "m", "mm"))
        found[joint] = column._replace(stem=known[stem])
    if not found:
        text = f"{file}: none of the columns {', '.join(recording.columns)} is one of "
        wanted = [_COLUMNS[1].format(joint) for joint in joints]
        raise SettingsError(text, given=tuple(recording.columns), allowed=wanted)
    return recording, found


def _positions(joints: tuple[Joint, ...], config: FromFile) -> tuple[np.ndarray, np.ndarray]:
    """Returns times from 0 on, (n,), and positions of all joints, (n, joints)."""
    recording, found = played(config.file, [joint.name for joint in joints])
    times = recording.time - recording.time[0]
    if len(times) < _FEWEST:
        text = f"{config.file} has {len(times)} samples; allowed: "
        raise SettingsError(text, given=len(times), allowed=f"{_FEWEST} or more")
    columns = []
    for joint in joints:
        if joint.name not in found:
            columns.append(np.full(len(times), joint.rest))
            continue
        name, _, factor, _ = found[joint.name]
        column = factor * recording[name]
        gaps = np.flatnonzero(~np.isfinite(column))
        if gaps.size:
            raise LeglabError(f"{config.file}: {name} has no value at {times[gaps[0]]:g} s")
        columns.append(make_smoothing_spline(times, column)(times) if config.smooth else column)
    return times, np.column_stack(columns)


def _closed(joints: tuple[Joint, ...], positions: np.ndarray, file: str) -> np.ndarray:
    """Sets the last sample to the first, if they differ by at most the largest sample step."""
    step = np.abs(np.diff(positions, axis=0)).max(axis=0)
    away = np.abs(positions[-1] - positions[0])
    for joint, missed, most in zip(joints, away, step, strict=True):
        if missed > most:
            text = f"{file}: {joint.name} ends {missed:.3g} rad off its begin; repeat allows "
            raise SettingsError(text, given=missed, allowed=f"at most {most:.3g} rad, its step")
    return np.concatenate([positions[:-1], positions[:1]])


def _cycle(length: float, positions: np.ndarray) -> float:
    """Returns the mean time between upward crossings of mid-range, of the joint that moves most."""
    most = positions[:, int(np.argmax(np.ptp(positions, axis=0)))]
    above = most > (most.min() + most.max()) / 2
    return length / max(1, int(np.sum(above[1:] & ~above[:-1])))
