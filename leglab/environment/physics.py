"""dm_control's physics of a simulation: the same model and data, stepped by the closed loop."""

from collections.abc import Callable

from dm_control.mujoco import Physics, wrapper

from leglab.machine.plugin import without_warnings
from leglab.machine.simulation import Simulation


class LegPhysics(Physics):
    """The physics of an environment, on the data of a `Simulation`.

    The state that `get_state()` returns includes the plugins' states and parameters. A copy of the
    physics is independent and advances by time steps, without sensors and scenario.
    """

    # dm_control's non-legacy step does whole time steps from the present state, also in a copy.
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
        """Advances by one control period; a copy of the physics advances by `nstep` time steps."""
        if self._advance is None:
            super().step(nstep)
            return
        with without_warnings():  # the task itself checks for the causes of the warnings
            self._advance()

    def after_reset(self) -> None:
        """Recomputes the quantities that follow from the state; valve openings are unchanged.

        Restores the solver's warm start, so that the call does not influence the next step.
        """
        warm_start = self.data.qacc_warmstart.copy()
        self.forward()
        self.data.qacc_warmstart[:] = warm_start
