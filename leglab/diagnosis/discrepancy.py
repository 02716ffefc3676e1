"""Errors of a model whose structure is only nearly right, beside the noise of its sensors.

No model of a real machine is exact: with its best parameters it misses the recordings by many noise
levels, and judged by noise alone every explanation is as bad as any other. The errors of the best
fit so far say how far the model is to be trusted, channel by channel and recording by recording
(Kennedy and O'Hagan 2001); as explanations get better, so does the trust.
"""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrepancy:
    """Covariance of the model's own error in a window: a shape by channel, a size by recording.

    Attributes:
        pattern: Covariance over the bins of a window, of trace `bins`, (channels, bins, bins):
            model errors have a memory of their own in every channel.
        variance: Mean over the bins, (recordings, channels).
    """

    pattern: np.ndarray
    variance: np.ndarray

    def covariance(self, recording: np.ndarray) -> np.ndarray:
        """Covariance of windows of recordings, shape (windows, size, size)."""
        channels, bins, _ = self.pattern.shape
        whole = np.zeros((len(self.variance), channels, bins, channels, bins))
        for channel, pattern in enumerate(self.pattern):
            whole[:, channel, :, channel] = self.variance[:, channel, None, None] * pattern
        return whole.reshape(len(whole), channels * bins, channels * bins)[recording]

    def scaled(self, factor: float) -> "Discrepancy":
        """The same with all variances multiplied."""
        return replace(self, variance=factor * self.variance)


def from_errors(errors: np.ndarray, recording: np.ndarray, excess: np.ndarray) -> Discrepancy:
    """The discrepancy that errors of a fitted model show.

    Args:
        errors: Measured less predicted, shape (windows, channels, bins).
        recording: Of each window, shape (windows,).
        excess: Share of the errors' variance that sensors do not explain, (recordings, channels).
    """
    windows, _, bins = errors.shape
    # The middle of all windows counts: single ones start in stick-slip or beside a jump.
    size = np.sqrt((errors**2).mean(axis=2))
    usual = np.stack([np.median(size[recording == r], axis=0) for r in np.unique(recording)])
    places = np.searchsorted(np.unique(recording), recording)
    scale = np.maximum(usual[places], 1e-300)
    normal = errors / np.maximum(size, scale)[:, :, None]
    shape = np.einsum("wki,wkj->kij", normal, normal) / windows
    # Few windows say little about how bins go together (Ledoit and Wolf 2004, with a fixed share).
    share = bins / (bins + windows)
    diagonal = np.einsum("kii->ki", shape)
    shape = (1.0 - share) * shape
    index = np.arange(bins)
    shape[:, index, index] += share * diagonal
    shape /= diagonal.mean(axis=1)[:, None, None]
    return Discrepancy(pattern=shape, variance=excess * usual**2)
