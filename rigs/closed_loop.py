"""A rough bench under a controller of leglab: the closed loop on a machine that shares no code.

The controller is commissioned on the model, as for any run; its commands move the bench of
`rigs/csrc/rough_bench.h`, which becomes another one on the way.
"""

import copy
from collections.abc import Sequence

import mujoco

from leglab.machine.simulation import Simulation
from leglab.runs.history import History
from leglab.runs.loop import Loop
from leglab.runs.preparation import RunSettings, prepared
from rigs._native import rough_bench as native
from rigs.rough_bench import SAMPLING_PERIOD, STEPS, RoughBench


class BenchSimulation(Simulation):
    """The bench where a loop expects a simulation: the joint is where the bench's encoder says.

    Args:
        model: Of the knee bench; its own dynamics are not used.
        benches: From which time on the bench is which [s], in order, the first one from 0.
    """

    def __init__(self, model: mujoco.MjModel, benches: Sequence[tuple[float, RoughBench]]) -> None:
        self._benches = benches
        super().__init__(model)

    def reset(self, keyframe: str | None = "home") -> None:
        """Resets the model; the bench rests there when it is stepped next."""
        super().reset(keyframe)
        self._plant: native.Plant | None = None

    def step(self, count: int = 1) -> None:
        """Advances the bench by a number of the model's time steps with the present command."""
        data, timestep = self.data, self.model.opt.timestep
        steps = round(STEPS * timestep / SAMPLING_PERIOD)
        if self._plant is None:
            self._plant = native.Plant(dict(self._benches[0][1].values), timestep / steps)
            self._plant.start(float(self.position()[0]))
            self._left = list(self._benches[1:])
        while self._left and data.time >= self._left[0][0] - 0.5 * timestep:
            self._plant.change(dict(self._left.pop(0)[1].values))
        data.qpos[self.qpos_index] = self._plant.advance(float(data.ctrl[0]), count * steps)
        data.time += count * timestep


def bench_loop(settings: RunSettings, benches: Sequence[tuple[float, RoughBench]]) -> Loop:
    """The closed loop of a run's controller and reference on a bench, with the bench's noise."""
    preparation = prepared(settings)
    simulation = BenchSimulation(copy.copy(preparation.nominal.model), benches)
    return Loop(settings, preparation=preparation, simulation=simulation)


def run_bench(settings: RunSettings, benches: Sequence[tuple[float, RoughBench]]) -> History:
    """Runs a controller on a bench and returns the recorded history.

    Args:
        settings: Of the run, of the nominal scenario; its machine is not used but for
            commissioning.
        benches: As of `BenchSimulation`.
    """
    return bench_loop(settings, benches).run()


def bench_settings(bench: RoughBench, controller: str, **more: object) -> RunSettings:
    """Settings of a run on a bench: its model, its noise; the bench itself rounds readings."""
    return RunSettings(
        scenario="nominal",
        controller=controller,
        model="knee_bench",
        sensors={"position_noise": bench.position_noise, "encoder_counts": 0},
        **more,  # type: ignore[arg-type]
    )
