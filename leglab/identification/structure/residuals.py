"""Tests of residuals: whiteness and correlation with inputs (Ljung 1999, section 16.6)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]
LAGS = 25
_QUANTILE = 2.5758  # two-sided 99 % quantile of the standard normal distribution


@dataclass(frozen=True)
class ResidualTest:
    """Correlations of a residual over lags.

    Attributes:
        name: Name of the signal with which the residual is correlated, or "itself".
        lags: (L,).
        correlation: (L,).
        band: Bound within which 99 % of the values lie if there is no correlation.
    """

    name: str
    lags: NDArray[np.int64]
    correlation: Array
    band: float

    @property
    def outside(self) -> float:
        """Share of lags whose correlation exceeds the band; 0.01 without any correlation."""
        counted = self.lags != 0 if self.name == "itself" else np.ones(len(self.lags), bool)
        return float(np.mean(np.abs(self.correlation[counted]) > self.band))

    @property
    def white(self) -> bool:
        """True if the autocorrelation passes the test of whiteness at the 99 % level.

        N times the sum of squared autocorrelations is chi-square distributed (Ljung 1999, 16.6).
        """
        scaled = _QUANTILE * self.correlation[1:] / self.band
        return float(np.sum(scaled**2)) <= float(chi2.ppf(0.99, len(scaled)))


def residual_tests(residual: Array, inputs: dict[str, Array]) -> tuple[ResidualTest, ...]:
    """Computes correlations of one-step residuals with themselves and with past inputs.

    Args:
        residual: (N,), NaN where the output is missing.
        inputs: Columns of shape (N,) by name.
    """
    e = np.nan_to_num(residual - np.nanmean(residual))
    n = len(e)
    most = min(LAGS, n // 4)
    lags = np.arange(most + 1)
    power = float(np.sqrt(np.sum(e**2))) or 1.0
    own = np.array([np.sum(e[k:] * e[: n - k]) for k in lags]) / power**2
    tests = [ResidualTest("itself", lags, own, _QUANTILE / np.sqrt(n))]
    for name, column in inputs.items():
        u = column - column.mean()
        scale = power * (float(np.sqrt(np.sum(u**2))) or 1.0)
        cross = np.array([np.sum(e[k:] * u[: n - k]) for k in lags]) / scale
        # Variance of a cross-correlation: sum_k R_e(k) R_u(k) / N (Ljung, eq. 16.69).
        auto = np.array([np.sum(u[k:] * u[: n - k]) for k in lags]) / max(
            float(np.sum(u**2)), 1e-300
        )
        spread = max(1.0 + 2.0 * float(np.sum(own[1:] * auto[1:])), 0.1)
        tests.append(ResidualTest(name, lags, cross, _QUANTILE * np.sqrt(spread / n)))
    return tuple(tests)
