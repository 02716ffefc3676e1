"""dm_control's view of a simulation: the same model and data, stepped by the sampled machine."""

from collections.abc import Callable

from dm_control.mujoco import Physics, wrapper

from leglab.machine.plugin import without_warnings
from leglab.machine.simulation import Simulation


class LegPhysics(Physics):
    """The physics of an environment, on the data of a `Simulation`.

    Its state, `get_state()`, contains the plugins' states and parameters too. A copy is independent
    and advances by time steps, without sensors and scenario.
    """

    # A copy, too, makes whole steps from its state.
    legacy_step = False
    _advance: Callable[[], None] | None = None

    @classmethod
    def of(cls, simulation: Simulation) -> "LegPhysics":
        """Makes the physics of a simulation; both share model and data."""
        return cls(wrapper.MjData(simulation.data))

    def drive(self, advance: Callable[[], None]) -> None:
        """Sets the function by which `step` advances one control period."""
        self._advance = advance

    def step(self, nstep: int = 1) -> None:
        """Advances by one control period; a copy by a number of time steps."""
        if self._advance is None:
            super().step(nstep)
            return
        with without_warnings():  # the task itself checks for their causes
            self._advance()

    def after_reset(self) -> None:
        """Recomputes the quantities that follow from the state; valve openings are unchanged.

        The solver starts the first step where it would have started without this.
        """
        warm_start = self.data.qacc_warmstart.copy()
        self.forward()
        self.data.qacc_warmstart[:] = warm_start
