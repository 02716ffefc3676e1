"""Feedback of the backstepping controller, on estimated and predicted errors."""

import numpy as np

from leglab.control.backstepping.cylinder import CylinderModel
from leglab.control.backstepping.data import BacksteppingGains, NominalCylinders
from leglab.control.backstepping.error_observer import ErrorObserver

# Lower bounds of the noise of positions [rad] and of pressures [Pa] that the observer assumes: the
# noise of the default sensors. With less noise the observer would be so fast that the loop would be
# unstable, because the observer models the valve's lag as a pure delay.
_LEAST_NOISE = (2e-5, 1.5e4)


def no_load_speed(data: NominalCylinders) -> np.ndarray:
    """Computes the no-load speed of the retracting piston, valve fully open [m/s], (joints,).

    v = K sqrt(A_B p_s/(A_A^3 + A_B^3)), case a of docs/concepts/physics.md.
    """
    return data.orifice_gain * np.sqrt(
        data.area[1] * data.supply_pressure / (data.area**3).sum(axis=0)
    )


class Feedback:
    """State feedback: piston speed, added to the reference's speed, that removes tracking errors.

    Backstepping: with virtual load force F_v = F_d - k phi + m ((k_1 + k_2) e' + k_1 k_2 e) and a
    speed that makes the force error decay at k_3, the error has the characteristic polynomial
    (s + k_1)(s + k_2)(s + k_3). Because of hold and delay, feedback cannot cancel the oil spring's
    poles s^2 + w^2; k_2 and k_3 only damp them: k_2 k_3 = w^2, k_2 + k_3 = 2 zeta w. Then

        v = k_1 e + (2 zeta k_1/w) e' - (k_1 + 2 zeta w)(p - phi) + eta

    Args:
        model: The nominal hydraulics.
        gains: Design parameters.
        position_noise: Noise of the measured joint positions [rad].
        pressure_noise: Noise of the measured pressures [Pa].
        period: Control period [s].
        latency: Age of a measurement when its command is sent [s].

    Attributes:
        stiffness: Stiffness of the oil around mid stroke [N/m], (joints,).
        frequency: w, natural frequency of the nominal mass on the oil [rad/s], (joints,).
        valve_delay: Delay of the slowest spool, 2 zeta/w_n [s].
        observer: Estimates e, e', p, phi and eta.
        weights: Feedback gains of (e, e', p, phi, eta), (joints, 5).
    """

    def __init__(
        self,
        model: CylinderModel,
        gains: BacksteppingGains,
        *,
        position_noise: float,
        pressure_noise: float,
        period: float,
        latency: float,
    ) -> None:
        data = model.data
        middle = data.position.shape[1] // 2
        half = np.tile(data.supply_pressure / 2, (2, 1))
        chambers = model.chambers(half, data.supply_pressure, data.piston[:, middle])
        self.stiffness = chambers.stiffness
        self.frequency = w = np.sqrt(self.stiffness / data.mass)
        self.valve_delay = float(np.max(2 * data.valve_damping / data.valve_frequency))
        force = data.area[0] * data.supply_pressure
        speed = no_load_speed(data)
        position_noise = max(position_noise, _LEAST_NOISE[0])
        pressure_noise = max(pressure_noise, _LEAST_NOISE[1])
        force_noise = np.sqrt((data.area**2).sum(axis=0)) * pressure_noise
        noise = [np.abs(data.lever[:, middle]) * position_noise, force_noise / self.stiffness]
        self.observer = ErrorObserver(
            frequency=w,
            damping=data.viscous / data.mass,
            period=period,
            delay=latency + self.valve_delay,
            noise=np.stack(noise),
            drift=np.stack([gains.force_drift * force / self.stiffness, gains.flow_drift * speed]),
        )
        k, zeta = gains.position_gain, gains.force_damping
        damping = k + 2 * zeta * w
        self.weights = np.stack([k, 2 * zeta * k / w, -damping, damping, np.ones_like(k)], axis=1)

    @property
    def unknown_force(self) -> np.ndarray:
        """Estimated load force that the model lacks, k phi [N], (joints,)."""
        return self.stiffness * self.observer.state[:, 3]

    def __call__(self, error: np.ndarray, force_error: np.ndarray) -> np.ndarray:
        """Computes the speed v [m/s], (joints,), from measured e and p [m], (joints,) each.

        Updates `observer`; the caller then calls `observer.sent` with the speed that was sent.
        """
        return np.einsum("ij,ij->i", self.weights, self.observer.predict(error, force_error))
