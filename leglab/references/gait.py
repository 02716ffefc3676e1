"""Joint angles of a walking adult over one stride, as Fourier series.

`python -m benchmarks fit_gait` prints these numbers. Source of all but ankle_roll: `normal.mot`,
the averaged normal gait of OpenSim's introductory tutorial (opensim-org/opensim-models), whose
curves have the form and size of those in Winter, Biomechanics and Motor Control of Human Movement,
4th ed. 2009, and Perry and Burnfield, Gait Analysis, 2nd ed. 2010. Six harmonics hold nearly all of
the power of natural gait (Winter et al. 1974, J. Biomechanics 7(6)); the comments give the RMS
residual. ankle_roll goes through key points after Perry and Burnfield's description of the subtalar
joint. Signs are those of leg.xml. Phase 0 is heel contact, the toe leaves the ground near 0.6.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Harmonics:
    """Series mean + sum_k cosine[k-1] cos(2 pi k phase) + sine[k-1] sin(2 pi k phase), k >= 1."""

    mean: float  #: Mean angle [deg]
    cosine: tuple[float, ...]  #: Cosine amplitudes [deg]
    sine: tuple[float, ...]  #: Sine amplitudes [deg]


GAIT = {
    "hip_yaw": Harmonics(  # 0.39 deg
        mean=0.007,
        cosine=(0.456, -0.177, -0.127, -0.110, 0.667, 0.012),
        sine=(-2.330, -2.145, -0.622, 0.224, 0.122, 0.060),
    ),
    "hip_roll": Harmonics(  # 0.04 deg
        mean=-1.705,
        cosine=(-0.527, -0.159, 1.212, -0.083, 0.144, 0.021),
        sine=(-4.064, 0.687, -0.379, -0.017, 0.187, -0.030),
    ),
    "hip_pitch": Harmonics(  # 0.04 deg
        mean=7.689,
        cosine=(20.709, -3.689, 0.079, -0.109, -0.180, 0.099),
        sine=(-3.797, -0.952, 1.564, -0.141, 0.198, 0.038),
    ),
    "knee": Harmonics(  # 0.08 deg
        mean=20.310,
        cosine=(-1.805, -13.827, 0.016, -0.694, -0.331, 0.245),
        sine=(-19.382, 8.289, 4.508, 0.501, 0.815, 0.148),
    ),
    "ankle_pitch": Harmonics(  # 0.53 deg
        mean=1.142,
        cosine=(-2.261, 0.946, -3.542, 1.891, -0.338, 0.401),
        sine=(5.018, -5.808, 0.521, -0.054, -1.083, 0.386),
    ),
    "ankle_roll": Harmonics(  # 0.24 deg
        mean=-0.542, cosine=(2.076, -2.546, -0.168, -0.704), sine=(2.980, 0.144, 0.591, -0.225)
    ),
}
