"""Active disturbance rejection: the calibrated valve map, and an observer of disturbances."""

import numpy as np
from pydantic import Field

from leglab.base.settings import Configuration
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.extended_state_observer import DisturbanceGains, DisturbanceRejection
from leglab.control.feedforward.motion import ReferenceMotion
from leglab.controllers.static_feedforward import ValveMapTable


class AdrcConfiguration(Configuration):
    """Settings of `adrc`.

    Attributes:
        control_bandwidth: omega_c [rad/s], one a joint; None for the tuned ones of the model.
        observer_bandwidth: omega_o [rad/s], one a joint; None as above.
    """

    control_bandwidth: tuple[float, ...] | None = Field(default=None)
    observer_bandwidth: tuple[float, ...] | None = Field(default=None)


@register_controller(
    "adrc",
    summary="adds to the calibrated map what an extended state observer estimates of all "
    "disturbances, and never learns",
    configuration=AdrcConfiguration,
)
class Adrc:
    """u = map(r, r') + (omega_c e + f)/b_0, with error e and disturbance f from the observer.

    For a native actuator, which sets a force, the law has order 2: see `DisturbanceRejection`.

    The map is evaluated at the reference in the middle of the period in which the command acts. The
    error is the reference at the time of the measurement minus the measurement.
    """

    def __init__(self, setup: ControllerSetup, config: AdrcConfiguration) -> None:
        machine, period = setup.machine, setup.control_period
        self._map = ValveMapTable(machine.valve_maps)
        self._law = DisturbanceRejection(
            _gains(setup, config),
            np.asarray(machine.direction, dtype=float),
            period=period,
            latency=machine.latency,
        )
        self._motion = ReferenceMotion(
            len(setup.joints),
            period,
            lead=period / 2,
            position_delay=machine.latency,
            velocity_delay=machine.latency,
        )
        self._feedforward = self._feedback = np.zeros(len(setup.joints))

    def reset(self, measurement: Measurement) -> None:
        """Starts a run without an estimated disturbance."""
        self._law.reset()
        self._motion.clear()

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        motion, seen = self._motion.take(reference)
        self._feedforward = self._map(motion[0], motion[1])
        self._feedback = self._law(seen.position - measurement.position)
        wish = self._feedforward + self._feedback
        command = np.minimum(np.maximum(wish, -1.0), 1.0)
        self._law.sent(command - self._feedforward)
        return command

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns feed-forward, feedback and estimated disturbance, each (joints,)."""
        return {
            "feedforward": self._feedforward,
            "feedback": self._feedback,
            "disturbance": self._law.disturbance,
        }


def _gains(setup: ControllerSetup, config: AdrcConfiguration) -> DisturbanceGains:
    tuned = setup.machine.tuned["adrc"]
    chosen = {"plant_gain": tuned.plant_gain, "order": tuned.order}
    for name in ("control_bandwidth", "observer_bandwidth"):
        values = getattr(config, name)
        values = getattr(tuned, name) if values is None else values
        if len(values) != len(setup.joints):
            raise setup.wrong_length(name, values, "adrc")
        chosen[name] = np.asarray(values, dtype=float)
    return DisturbanceGains(**chosen)
