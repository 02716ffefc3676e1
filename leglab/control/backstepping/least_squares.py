"""Recursive least squares of many joints at once, within bounds."""

import numpy as np


class BoundedLeastSquares:
    """Least squares with exponential forgetting, bounded gain and projection, for each joint.

    This is the estimator of indirect adaptive robust control (Mohanty and Yao 2011, IEEE Trans.
    Control Syst. Technol. 19(3), 567). Physical parameters are estimated by least squares from the
    plant's dynamics, not from the tracking error, with a dead zone and projection onto bounds.

    Args:
        start: Initial parameters, (parameters, joints).
        scale: Expected magnitude of a change of each parameter, (parameters, joints).
        lower: Lower bounds, (parameters, joints).
        upper: Upper bounds, (parameters, joints).
        forgetting_factor: Forgetting factor of one update.
        noise: RMS residual of an unchanged machine, (joints,).
        dead_zone: Residuals up to `dead_zone` times the noise are ignored.

    Attributes:
        values: Parameters, (parameters, joints).
    """

    def __init__(
        self,
        *,
        start: np.ndarray,
        scale: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        forgetting_factor: float,
        noise: np.ndarray,
        dead_zone: float,
    ) -> None:
        self._start, self._scale = start, scale
        self._lower, self._upper = lower, upper
        self._factor, self._noise = forgetting_factor, noise
        self._dead, self._largest = dead_zone, 40.0
        self._identity = np.eye(len(start))
        self.reset()

    def reset(self) -> None:
        """Forgets everything learned."""
        self.values = self._start.copy()
        self._information = np.tile(self._identity, (self._start.shape[1], 1, 1))

    def update(self, regressor: np.ndarray, residual: np.ndarray, usable: np.ndarray) -> None:
        """Updates by one equation per joint: residual = regressor . (true - present parameters).

        Args:
            regressor: Regressors in physical units, (parameters, joints).
            residual: Residuals, (joints,).
            usable: Mask of the joints whose equation is used, (joints,).
        """
        scaled = residual / self._noise
        # Clip residuals: a residual far beyond the noise is more often an outlier than a change.
        scaled = np.minimum(np.maximum(scaled, -self._largest), self._largest)
        usable = usable & (np.abs(scaled) > self._dead)  # false for NaN
        if not usable.any():
            return
        phi = (regressor * self._scale / self._noise).T
        phi = np.where(usable[:, None], phi, 0.0)
        scaled = np.where(usable, scaled, 0.0)
        # Forgotten information is replaced by that of the prior, the identity matrix, so that no
        # eigenvalue falls below 1 and rounding cannot make the information matrix indefinite.
        new = np.where(usable, 1.0 - self._factor, 0.0)
        information = self._information
        information *= (1.0 - new)[:, None, None]
        information += new[:, None, None] * self._identity
        information += phi[:, :, None] * phi[:, None, :]
        pull = new[:, None] * ((self._start - self.values) / self._scale).T
        step = np.linalg.solve(information, (pull + phi * scaled[:, None])[:, :, None])[:, :, 0]
        self.values = self.values + self._scale * step.T
        self.values = np.minimum(np.maximum(self.values, self._lower), self._upper)
