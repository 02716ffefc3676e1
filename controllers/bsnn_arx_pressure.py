"""Adaptive feed-forward with measured pressures: learned maps from motion to load and to flow."""

from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

from leglab.base.errors import ModelError
from leglab.control import ControllerSetup, Measurement, register_controller
from leglab.control.backstepping.data import NominalCylinders
from leglab.control.feedforward.adaptive import AdaptiveFeedforward
from leglab.control.feedforward.inverse_map import InverseMap
from leglab.control.feedforward.valve_table import ValveTable
from leglab.controllers.bsnn_arx import AdaptiveConfiguration, AdaptiveController
from leglab.identification import Rls


class PressureConfiguration(AdaptiveConfiguration):
    """Settings of `bsnn_arx`, and those for measured pressures.

    Attributes:
        route: As `bsnn_arx`; with pressures only the inverse map is learned.
        settle_time: As `bsnn_arx`; the pressure cascade made no machine oscillate, and a slow map
            slows it down.
        leak_gain: Prior standard deviation of leak paths' parameters (splines: 1); with 10 a worn
            seal is learned sooner, but parameters burst in the squat on the ground.
        load_noise: Error of the load map [share of the piston's force] that counts as noise.
    """

    route: Literal["inverse"] = Field(default="inverse")
    settle_time: float = Field(default=0.0, ge=0)
    velocity_splines: int = Field(default=12, ge=3, le=100)
    leak_gain: float = Field(default=1.0, gt=0)
    load_noise: float = Field(default=0.015, gt=0)


@register_controller(
    "bsnn_arx_pressure",
    summary="is bsnn_arx that measures pressures: it learns the load that a motion takes, and what "
    "flow the valve must give for it, leaks as numbers of their own",
    configuration=PressureConfiguration,
)
class PressureController(AdaptiveController):
    """`bsnn_arx` with the valve equation at measured pressures instead of the calibrated map.

    A second map learns the load of a motion. See `leglab.control.feedforward.adaptive`.
    """

    name = "bsnn_arx_pressure"
    uses_pressures = True

    def _adaptation(
        self,
        setup: ControllerSetup,
        config: PressureConfiguration,  # type: ignore[override]
        rls: Rls,
    ) -> AdaptiveFeedforward:
        machine, joints = setup.machine, len(setup.joints)
        structure = partial(
            InverseMap,
            joints,
            velocity_splines=config.velocity_splines,
            position_splines=config.position_splines,
            least_memory=config.least_memory,
        )
        load_rls = config.model_copy(update={"noise": config.load_noise}).rls
        return AdaptiveFeedforward(
            structure(rls=rls, leaks=config.leak_gain),
            ValveTable.of(machine.valve_maps, np.asarray(machine.direction)),
            self._feedback.position_gain,
            self._feedback.velocity_gain,
            config,
            loads=structure(rls=load_rls),
            sheets=data_sheets(machine.cylinders),
            control_period=setup.control_period,
            latency=machine.latency,
            velocity_delay=machine.latency + machine.velocity_delay,
        )

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the nominal maps.

        Raises:
            LeglabError: The measurement lacks a pressure.
        """
        pressures = (measurement.pressure_a, measurement.pressure_b, measurement.supply_pressure)
        if any(pressure is None for pressure in pressures):
            raise ModelError(f"controller {self.name!r} needs measured pressures, there are none")
        super().reset(measurement)


def data_sheets(cylinders: NominalCylinders) -> dict[str, np.ndarray]:
    """Returns the cylinders' data as `sheets` of `AdaptiveFeedforward`, by their C++ names."""
    names = ["stroke", "orifice_gain", "laminar_transition_pressure", "lap", "edge_rounding"]
    names += ["supply_pressure", "tank_pressure", "bulk_modulus", "entrained_air"]
    names += ["polytropic_index"]
    position = cylinders.position
    return {
        **{name: getattr(cylinders, name) for name in names},
        "area_a": cylinders.area[0],
        "area_b": cylinders.area[1],
        "dead_volume_a": cylinders.dead_volume[0],
        "dead_volume_b": cylinders.dead_volume[1],
        "position_start": position[:, 0],
        "position_step": position[:, 1] - position[:, 0],
        "lever": cylinders.lever,
        "piston": cylinders.piston,
    }
