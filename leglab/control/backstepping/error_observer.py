"""Tracking error, its rate, the force error and two lumped disturbances, estimated and predicted.

Errors of one joint in piston coordinates, e = x_d - x and p = (F - F_d)/k, with F the load force,
F_d the force that the model predicts for the reference, k the stiffness of the oil, w^2 = k/m:

    e'' = -w^2 (p - phi) - (b/m) e'      phi k: unmodelled force
    p'  = v + e' - eta                   v: flow beyond that for the reference; eta: flow lost

phi and eta are random walks: the lumped disturbances of both equations that an extended state
observer gives (Yao, Jiao and Ma 2014, IEEE Trans. Ind. Electron. 61(11), 6285). The Kalman gains
are stationary. e and p are measured `latency` before the command, which acts after the valve's
delay: the estimate is predicted over both times.
"""

import numpy as np

_STATES = 5  # e, e', p, phi, eta


def _sampled(a: np.ndarray, b: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Discretises batches a (n, s, s) and b (n, s): transition and input response over a time."""
    from scipy.linalg import expm  # the import takes half a second, for this controller alone

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
        drift: Random walk of phi [m/sqrt(s)] and eta [m/s/sqrt(s)], (2, joints).

    Attributes:
        state: Estimate at the time of the latest measurement, (joints, 5).
        past: Whole periods in the delay.
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
        # Commands `past` + 1 and `past` periods old act in turn between two measurements.
        self.past = int(delay / period - 1e-9)
        share = delay - self.past * period
        whole, _ = _sampled(a, b, period)
        late, early_input = _sampled(a, b, period - share)
        _, late_input = _sampled(a, b, share)
        self._transition = whole
        self._older = np.einsum("nij,nj->ni", late, late_input)
        self._newer = early_input
        # Prediction to the middle of the period in which the command is held.
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
        """Computes the stationary gain (5, 2) of a filter that corrects after each measurement."""
        from scipy.linalg import solve_discrete_are

        c = np.zeros((2, _STATES))
        c[0, 0] = c[1, 2] = 1.0
        # Lengths in units of the noise and times in 1/w: the equation is ill-conditioned in SI.
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
        """Starts at rest at measured errors e and p [m]; attributes all of p to phi."""
        self.clear()
        self.state[:, 0] = error
        self.state[:, 2] = self.state[:, 3] = force_error

    def predict(self, error: np.ndarray, force_error: np.ndarray) -> np.ndarray:
        """Updates with measured e, p [m]; predicts the state when the command acts, (joints, 5)."""
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
        """Records the speed v that is sent in this period [m/s], (joints,)."""
        self._inputs = [*self._inputs[1:], velocity]

    def matrices(self, joint: int) -> tuple[np.ndarray, ...]:
        """Returns transition, older and newer input, gain, prediction and its input of a joint."""
        parts = (self._transition, self._older, self._newer)
        return tuple(part[joint] for part in (*parts, self._gain, self._ahead, self._ahead_input))
