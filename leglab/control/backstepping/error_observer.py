"""Observer of tracking error, error rate, force error and two lumped disturbances.

In piston coordinates the errors of one joint are e = x_d - x and p = (F - F_d)/k, with F the load
force, F_d the model's force for the reference, k the stiffness of the oil and w^2 = k/m. They obey

    e'' = -w^2 (p - phi) - (b/m) e'      phi k: unmodelled force
    p'  = v + e' - eta                   v: flow in addition to the reference's; eta: lost flow

The lumped disturbances phi and eta are modelled as random walks and estimated as by an extended
state observer (Yao, Jiao and Ma 2014, IEEE Trans. Ind. Electron. 61(11), 6285). The Kalman gains
are stationary. e and p are measured `latency` before the command is sent, which acts after the
valve's delay; therefore the estimate is predicted over latency and valve delay.
"""

import numpy as np

_STATES = 5  # e, e', p, phi, eta


def _sampled(a: np.ndarray, b: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Computes transition matrices (n, s, s) and responses to a constant input (n, s) in a time."""
    from scipy.linalg import expm  # an import of half a second, only needed by this controller

    n, states = b.shape
    block = np.zeros((n, states + 1, states + 1))
    block[:, :states, :states] = a
    block[:, :states, states] = b
    full = np.stack([expm(matrix * time) for matrix in block])
    return full[:, :states, :states], full[:, :states, states]


class ErrorObserver:
    """Kalman filter of the error dynamics of all joints.

    Args:
        frequency: w of each joint [rad/s], (joints,).
        damping: b/m [1/s], (joints,).
        period: Control period [s].
        delay: Time from a measurement to the instant at which its command begins to act [s], at
            most two periods.
        noise: RMS noise of measured e and p [m], (2, joints).
        drift: Random walks of phi [m/sqrt(s)] and of eta [m/s/sqrt(s)], (2, joints).

    Attributes:
        state: Estimates of (e, e', p, phi, eta) at the latest measurement, (joints, 5).
        past: Number of whole periods in the delay.
    """

    def __init__(
        self,
        *,
        frequency: np.ndarray,
        damping: np.ndarray,
        period: float,
        delay: float,
        noise: np.ndarray,
        drift: np.ndarray,
    ) -> None:
        n = len(frequency)
        a = np.zeros((n, _STATES, _STATES))
        a[:, 0, 1] = 1.0
        a[:, 1, 1], a[:, 1, 2], a[:, 1, 3] = -damping, -(frequency**2), frequency**2
        a[:, 2, 1], a[:, 2, 4] = 1.0, -1.0
        b = np.zeros((n, _STATES))
        b[:, 2] = 1.0
        # Between two measurements the command of `past` + 1 periods ago acts, then the next one.
        self.past = int(delay / period - 1e-9)
        share = delay - self.past * period
        whole, _ = _sampled(a, b, period)
        late, early_input = _sampled(a, b, period - share)
        _, late_input = _sampled(a, b, share)
        self._transition = whole
        self._older = np.einsum("nij,nj->ni", late, late_input)
        self._newer = early_input
        # The state is predicted for the middle of the period in which the new command acts.
        self._ahead, self._ahead_input = _sampled(a, b, delay + period / 2)
        rows = zip(whole, noise.T, drift.T, frequency, strict=True)
        self._gain = np.stack([self._kalman(a, period, *row) for a, *row in rows])
        self.state = np.zeros((n, _STATES))
        self.clear()

    @staticmethod
    def _kalman(
        transition: np.ndarray,
        period: float,
        noise: np.ndarray,
        drift: np.ndarray,
        frequency: float,
    ) -> np.ndarray:
        """Computes the stationary Kalman gain of the measurement update, (5, 2)."""
        from scipy.linalg import solve_discrete_are

        c = np.zeros((2, _STATES))
        c[0, 0] = c[1, 2] = 1.0
        # Lengths are in units of noise, times of 1/w; in SI units the equation is ill-conditioned.
        scale = noise[0] * np.array([1.0, frequency, 1.0, 1.0, frequency])
        process = np.zeros((_STATES, _STATES))
        process[3, 3], process[4, 4] = period * (drift / scale[3:]) ** 2
        spread = np.diag((noise / noise[0]) ** 2)
        a = transition * scale / scale[:, None]
        p = solve_discrete_are(a.T, c.T, process, spread)
        gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + spread)
        return gain * scale[:, None] / noise[0]

    def clear(self) -> None:
        """Sets the state and the past inputs to zero."""
        self.state[:] = 0.0
        self._inputs = [np.zeros(len(self.state)) for _ in range(self.past + 2)]

    def start(self, error: np.ndarray, force_error: np.ndarray) -> None:
        """Starts at rest with measured e and p [m]; assumes phi = p, so that no force results."""
        self.clear()
        self.state[:, 0] = error
        self.state[:, 2] = self.state[:, 3] = force_error

    def predict(self, error: np.ndarray, force_error: np.ndarray) -> np.ndarray:
        """Updates with measured e, p [m]; predicts the state for the new command, (joints, 5)."""
        state, inputs = self.state, self._inputs
        state = np.matmul(self._transition, state[:, :, None])[:, :, 0]
        state += self._older * inputs[0][:, None]
        state += self._newer * inputs[1][:, None]
        innovation = np.empty((len(state), 2))
        innovation[:, 0] = error - state[:, 0]
        innovation[:, 1] = force_error - state[:, 2]
        state += np.matmul(self._gain, innovation[:, :, None])[:, :, 0]
        self.state = state
        ahead = np.matmul(self._ahead, state[:, :, None])[:, :, 0]
        return ahead + self._ahead_input * inputs[-1][:, None]

    def sent(self, velocity: np.ndarray) -> None:
        """Records the input v of this period, the speed demanded of the valve [m/s], (joints,)."""
        self._inputs = [*self._inputs[1:], velocity]

    def matrices(self, joint: int) -> tuple[np.ndarray, ...]:
        """Returns the matrices of one joint, in the order of the code, for linear analysis."""
        parts = (self._transition, self._older, self._newer)
        return tuple(part[joint] for part in (*parts, self._gain, self._ahead, self._ahead_input))
