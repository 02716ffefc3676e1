"""Prints the Fourier coefficients in leglab/references/gait.py.

Usage: python -m benchmarks fit_gait normal.mot

`normal.mot` is the averaged normal gait of OpenSim's introductory tutorial, in the repository
opensim-org/opensim-models under Tutorials/Intro_to_Musculoskeletal_Modeling. It is not ours to
ship, so it has to be fetched first.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from leglab.base.scale import rms

HARMONICS = 6

# leglab's joint, OpenSim's coordinate, and the sign between them: OpenSim counts internal rotation
# and adduction positive and knee flexion negative.
SOURCES = {
    "hip_yaw": ("hip_rotation_r", -1),
    "hip_roll": ("hip_adduction_r", -1),
    "hip_pitch": ("hip_flexion_r", 1),
    "knee": ("knee_angle_r", -1),
    "ankle_pitch": ("ankle_angle_r", 1),
}

# Subtalar inversion [deg] by phase, which the OpenSim file does not hold: key points as described
# by Perry and Burnfield, Gait Analysis, 2nd ed. 2010, chapter on ankle and foot (slight inversion
# at contact, greatest eversion of 4 to 6 deg at 14 %, neutral by 40 %, greatest inversion of 6 to
# 7 deg at 52 %, then back to neutral in swing). Numbers within those words are our choice.
INVERSION = {0.0: 2.0, 0.14: -5.0, 0.4: 0.0, 0.52: 6.5, 0.65: 3.0, 0.8: 0.5, 0.9: 1.5}
INVERSION_HARMONICS = 4


def fit(phase: np.ndarray, angle: np.ndarray, harmonics: int) -> tuple[np.ndarray, float]:
    """Returns (mean, cos 1, sin 1, cos 2, ...) by least squares, and the RMS residual."""
    order = np.arange(1, harmonics + 1)
    turns = 2 * np.pi * np.outer(phase, order)
    waves = np.stack([np.cos(turns), np.sin(turns)], axis=-1).reshape(len(phase), -1)
    basis = np.column_stack([np.ones_like(phase), waves])
    coefficients = np.linalg.lstsq(basis, angle, rcond=None)[0]
    return coefficients, float(rms(basis @ coefficients - angle))


def show(joint: str, coefficients: np.ndarray, residual: float) -> None:
    cosine, sine = (", ".join(f"{c:.3f}" for c in coefficients[k::2]) for k in (1, 2))
    print(f'"{joint}": Harmonics(  # {residual:.2f} deg')
    print(f"    mean={coefficients[0]:.3f},\n    cosine=({cosine}),\n    sine=({sine}),\n),")


def main() -> None:
    lines = Path(sys.argv[1]).read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.strip() == "endheader") + 1
    names = lines[start].split()
    rows = [line.split() for line in lines[start + 1 :] if line.strip()]
    table = dict(zip(names, np.array(rows, dtype=float).T, strict=True))
    for joint, (coordinate, sign) in SOURCES.items():
        show(joint, *fit(table["time"], sign * table[coordinate], HARMONICS))
    phase = np.array(list(INVERSION))
    angle = np.array(list(INVERSION.values()))
    turns = PchipInterpolator(np.concatenate([phase - 1, phase, phase + 1]), np.tile(angle, 3))
    dense = np.arange(100) / 100
    show("ankle_roll", *fit(dense, -turns(dense), INVERSION_HARMONICS))
