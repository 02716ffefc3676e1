"""Iterative learning control: this stride's command from command and error of the last stride.

The learning function by inversion of the plant, the Q-filter, and the frequency-domain condition
under which the error decreases from stride to stride are in Bristow, Tharayil and Alleyne 2006, "A
survey of iterative learning control", IEEE Control Systems Magazine 26(3), 96. Strides follow one
another without a pause or a reset, so the same phase of the last stride was one stride duration
ago, which in general is not a whole number of control periods.
"""

import math
from dataclasses import dataclass

import numpy as np

# gamma: share of an error that the learning function removes per stride if the model is exact.
LEARNING_GAIN = 0.5

# Half length of the filters' impulse responses times the cutoff, beyond which less than 1 % lies.
_HALF_LENGTH = 12.0

# Time over which a correction is faded in or out [s].
_FADE = 0.1

# Number of samples of the inverse Fourier transforms from which the impulse responses are taken.
_TRANSFORM = 1 << 14


@dataclass(frozen=True, kw_only=True)
class LearningFilter:
    """Tuning of `IterativeLearning`, one value per joint."""

    #: Cutoff of the Q-filter, which passes frequencies below the cutoff unchanged and none above
    #: twice the cutoff [rad/s], (joints,).
    cutoff: np.ndarray
    lead: np.ndarray  #: d, compensated delay of the plant [s], (joints,)
    #: b_0, speed per command of the calibrated joint [rad/s], (joints,).
    speed_per_command: np.ndarray


def q_filter(frequency: np.ndarray, cutoff: float) -> np.ndarray:
    """Computes Q: 1 up to the cutoff [rad/s], 0 from twice the cutoff, half a cosine between."""
    place = np.clip(np.abs(frequency) / cutoff - 1.0, 0.0, 1.0)
    return 0.5 + 0.5 * np.cos(math.pi * place)


def learning_function(
    frequency: np.ndarray, *, lead: float, speed_per_command: float, crossover: float
) -> np.ndarray:
    """Computes L: gamma times the inverse of the first-order loop from command to position.

    A joint integrates the command, and its feedback loop decays at the rate of its crossover
    frequency: G = b_0 exp(-i w d)/(i w + w_x), L = gamma/G.

    Args:
        frequency: w [rad/s].
        lead: d [s].
        speed_per_command: b_0 [rad/s].
        crossover: w_x, position gain times b_0 [rad/s].
    """
    inverse = (1j * frequency + crossover) / speed_per_command
    return LEARNING_GAIN * inverse * np.exp(1j * frequency * lead)


class IterativeLearning:
    """Learned correction of the command, c(t) = Q [c + L e](t - stride).

    c is in use once the reference has repeated that of a stride earlier for a whole stride.
    Otherwise c is zero and nothing is learned. The filters are non-causal, because they use samples
    before and after t - stride.

    Args:
        filters: Tuning.
        crossover: w_x of each joint's feedback loop [rad/s], (joints,).
        direction: Sign of the joint velocity that a positive command gives, (joints,).
        stride: Time after which the reference is expected to repeat [s]; need not be a multiple of
            the control period.
        period: Control period [s].
        tolerance: Reference positions that differ by less count as equal [rad].

    Attributes:
        repeats: Whether c is in use.
    """

    def __init__(
        self,
        filters: LearningFilter,
        crossover: np.ndarray,
        direction: np.ndarray,
        *,
        stride: float,
        period: float,
        tolerance: float,
    ) -> None:
        self._joints, self._tolerance = len(filters.cutoff), tolerance
        self._nothing, self._step = np.zeros(self._joints), period / _FADE
        self._count = math.floor(stride / period)
        self._part = stride / period - self._count  # fraction of a period in the stride
        longest = math.ceil(_HALF_LENGTH / float(np.min(filters.cutoff)) / period)
        self._half = half = min(longest, self._count - 2)
        # The time one stride ago lies between two samples, so that the filters interpolate.
        shift = -self._part * period
        tuning = np.stack([filters.cutoff, filters.lead, filters.speed_per_command, crossover])
        kernels = [
            _kernels(*joint, period=period, half=half, shift=shift) for joint in tuning.T.tolist()
        ]
        sign = np.asarray(direction, dtype=float)
        self._smoothing = np.array([kernel[0] for kernel in kernels]).T
        self._learning = sign * np.array([kernel[1] for kernel in kernels]).T
        # Number of past samples kept: one stride and half the length of a filter.
        self._length = self._count + half + 1
        self.reset()

    def reset(self) -> None:
        """Forgets everything learned."""
        shape = (2 * self._length, self._joints)
        self._correction, self._error, self._reference = (np.zeros(shape) for _ in range(3))
        self._next = self._periods = self._same = 0
        self._frozen, self._share, self.repeats = False, 0.0, False

    def freeze(self) -> None:
        """Stops learning until the next `reset`; the correction of the last stride is repeated."""
        self._frozen = True

    def correction(self, reference: np.ndarray) -> np.ndarray:
        """Computes command corrections, (joints,), for reference positions [rad], (joints,)."""
        half, last = self._half, slice(self._next, self._next + self._length)
        # In the kept samples, oldest first, the sample at index `half + 1` is `_count` periods old.
        then = self._reference[last][half : half + 2]
        earlier = then[1] + self._part * (then[0] - then[1])
        known = self._periods > self._count
        same = known and bool(np.abs(reference - earlier).max() <= self._tolerance)
        self._same = self._same + 1 if same else 0
        self._store(self._reference, reference)
        self.repeats = self._same > self._count + half
        step = self._step if self.repeats else -self._step
        self._share = min(max(self._share + step, 0.0), 1.0)
        if not self._share:
            return self._nothing
        if self._frozen:
            before, now = self._correction[last][half : half + 2]
            return self._share * (now + self._part * (before - now))
        window = slice(self._next + 1, self._next + 2 * half + 2)
        correction = np.einsum("kj,kj->j", self._smoothing, self._correction[window])
        correction += np.einsum("kj,kj->j", self._learning, self._error[window])
        return self._share * correction

    def take(self, error: np.ndarray, correction: np.ndarray) -> None:
        """Ends a period; call it once after `correction`.

        Args:
            error: Measured tracking errors of this period [rad], (joints,); NaN if missing.
            correction: Correction that the commands contain after clipping, (joints,).
        """
        self._store(self._error, np.nan_to_num(error))
        self._store(self._correction, correction)
        self._next = (self._next + 1) % self._length
        self._periods += 1

    def _store(self, rows: np.ndarray, values: np.ndarray) -> None:
        # Ring buffer: every sample is written twice, so that the latest samples are one slice.
        rows[self._next] = rows[self._next + self._length] = values


def _kernels(
    cutoff: float,
    lead: float,
    speed_per_command: float,
    crossover: float,
    *,
    period: float,
    half: int,
    shift: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Computes impulse responses of Q and Q L, oldest sample first, (2 half + 1,) each.

    `shift` is the time from the middle sample to the output [s]; negative for an earlier output.
    """
    frequency = 2 * math.pi * np.fft.rfftfreq(_TRANSFORM, period)
    passed = q_filter(frequency, cutoff) * np.exp(1j * frequency * shift)
    learning = learning_function(
        frequency, lead=lead, speed_per_command=speed_per_command, crossover=crossover
    )
    # Sample n of a response weights the input n samples earlier, so that n = half is the oldest.
    wanted = np.arange(half, -half - 1, -1)
    return tuple(  # type: ignore[return-value]
        np.fft.irfft(response, _TRANSFORM)[wanted] for response in (passed, passed * learning)
    )
