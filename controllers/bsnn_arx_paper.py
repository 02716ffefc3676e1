"""The paper's BSNN-ARX model, unchanged, as adaptive feed-forward added to PD.

Folgheraiter's model (Algorithm 1) learns the inverse of each joint: its input is the measured
velocity, its output the valve command that caused this velocity. As in the paper, it learns by the
local spline rule and by recursive least squares without forgetting or resets of the gain.
"""

import numpy as np
from pydantic import Field

from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.feedforward.motion import ReferenceMotion, SmoothingWindow
from leglab.controllers.pd import Pd, PdConfiguration
from leglab.identification import Basis, Bsnn, BsnnArx, BsnnArxSettings, Rls


class PaperConfiguration(PdConfiguration):
    """Settings of `bsnn_arx_paper`.

    Attributes:
        na: Past commands in the regressor.
        nb: Past network outputs in the regressor.
        splines: Of the network, over twice the full speed of the joint.
        learning_constant: eta of Eq. 12; the constant that the paper prints.
        initial_gain: F(0).
        window: Samples over which measured motion is smoothed; odd.
        limit: Largest feed-forward [valve command].
    """

    na: int = Field(default=0, ge=0, le=20)
    nb: int = Field(default=3, ge=1, le=20)
    splines: int = Field(default=8, ge=3, le=100)
    learning_constant: float = Field(default=0.004, ge=0)
    initial_gain: float = Field(default=5.6, gt=0)
    window: int = Field(default=21, ge=7, le=201)
    limit: float = Field(default=0.95, gt=0, le=1)


@register_controller(
    "bsnn_arx_paper",
    summary="adds to pd the command of the paper's BSNN-ARX from velocity to command, learned "
    "online by plain RLS",
    configuration=PaperConfiguration,
)
class BsnnArxPaper:
    """u = model(r', past of r') + PD; learned from measured velocities and the commands sent."""

    def __init__(self, setup: ControllerSetup, config: PaperConfiguration) -> None:
        self._pd = Pd(setup, config)
        maps = setup.machine.valve_maps
        latency = setup.machine.latency
        joints, period = len(setup.joints), setup.control_period
        self._joints, self._limit = joints, config.limit
        self._speed = np.array([m.velocity[-1] for m in maps])
        network = Bsnn(
            basis=(Basis.uniform(-2.0, 2.0, config.splines),),
            learning_constant=(config.learning_constant,),
        )
        self._settings = BsnnArxSettings(
            na=config.na,
            nb=config.nb,
            nk=0,
            network=network,
            rls=Rls(initial_gain=config.initial_gain),
        )
        self._window = SmoothingWindow(2 * joints, config.window, period)
        self._motion = ReferenceMotion(
            joints, period, lead=period - latency, position_delay=0.0, velocity_delay=0.0
        )
        self._sent = self._feedforward = np.zeros(joints)

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the paper's initial parameters, uniform in +-0.25."""
        self._pd.reset(measurement)
        self._window.clear()
        self._motion.clear()
        self._learner = BsnnArx(self._settings, joints=self._joints)
        self._learner.randomise(np.random.default_rng(0))
        # A copy that is evaluated at the reference, so its regressor holds the reference's history.
        self._driver = self._learner.copy()
        self._driver.freeze()
        self._sent = self._feedforward = np.zeros(self._joints)

    def freeze(self) -> None:
        """Stops adapting until the next `reset`."""
        self._learner.freeze()

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        self._window.push(measurement.position, self._sent)
        if self._window.full:
            command, velocity = self._window.middle()[:2]
            self._learner.update(*self._samples(velocity[: self._joints], command[self._joints :]))
        self._driver.parameters = self._learner.parameters
        later, _ = self._motion.take(reference)
        velocity, _ = self._samples(later[1], self._sent)
        wish = np.reshape(self._driver.predict(velocity), self._joints)
        self._feedforward = np.nan_to_num(wish).clip(-self._limit, self._limit)
        self._driver.update(*self._samples(later[1], self._feedforward))
        command = self._feedforward + self._pd.correct(measurement, reference)
        self._sent = command.clip(-1.0, 1.0)
        return command

    def _samples(self, velocity: np.ndarray, command: np.ndarray) -> tuple:
        scaled = velocity / self._speed
        if self._joints == 1:
            return float(scaled[0]), float(command[0])
        return scaled, np.ascontiguousarray(command)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns feed-forward and feedback parts of the command, each (joints,)."""
        return {"feedforward": self._feedforward, **self._pd.diagnostics()}
