"""Model-based adaptive robust control with measured pressures: the field's way."""

import math

import numpy as np
from pydantic import Field

from leglab.backstepping.adaptation import Adaptation
from leglab.backstepping.cylinder import CylinderModel
from leglab.backstepping.data import BacksteppingGains
from leglab.backstepping.feedback import Feedback, no_load_speed
from leglab.backstepping.friction import Bristles
from leglab.configuration import Configuration
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.feedforward.motion import ReferenceMotion

_NAME = "adaptive_backstepping"


class BacksteppingConfiguration(Configuration):
    gains: dict | None = None
    pressure_cutoff: float = Field(default=60.0, gt=0)
    load_share: float = 0.0
    memory: float = 1.0
    dead_zone: float = 0.5
    adapt_flow: bool = True
    adapt_force: bool = True
    limit: float = Field(default=1.0, gt=0, le=1)


@register_controller(_NAME, summary="x", configuration=BacksteppingConfiguration)
class AdaptiveBackstepping:
    uses_pressures = True

    def __init__(self, setup: ControllerSetup, config: BacksteppingConfiguration) -> None:
        data = setup.require("cylinders", _NAME)
        latency = setup.require("latency", _NAME)
        self._torque = setup.require("inverse_dynamics", _NAME)
        self._model = CylinderModel(data)
        self._data = data
        self._config = config
        n = len(setup.joints)
        self._n = n
        period = setup.control_period
        self._period = period
        g = config.gains
        self._law = Feedback(
            self._model,
            BacksteppingGains(**{k: np.broadcast_to(np.array(v, float), (n,)) for k, v in g.items()}),
            position_noise=setup.require("position_noise", _NAME),
            pressure_noise=setup.require("pressure_noise", _NAME),
            period=period,
            latency=latency,
        )
        self._lead = period / 2 + self._law.valve_delay
        self._motion = ReferenceMotion(
            n, period, lead=self._lead, position_delay=latency, velocity_delay=latency
        )
        self._back = (self._lead + latency) / period
        self._smooth = 1 - math.exp(-config.pressure_cutoff * period)
        self._bristles = Bristles(data)
        self.adaptation = Adaptation(self._model, self._torque, period=period, latency=latency,
            valve_delay=self._law.valve_delay, speed=no_load_speed(data),
            memory=config.memory, dead_zone=config.dead_zone)

    def reset(self, measurement):
        self._motion.clear()
        self._started = False
        self.adaptation.reset()
        self._theta = (self.adaptation.flow.values.copy(), self.adaptation.force.values.copy())
        self._bristles.reset()
        self._last = np.zeros(self._n)
        self._pressure = np.stack([measurement.pressure_a, measurement.pressure_b])

    def command(self, measurement, reference):
        data, model, law = self._data, self._model, self._law
        raw = np.stack([measurement.pressure_a, measurement.pressure_b])
        self._pressure = self._pressure + self._smooth * (raw - self._pressure)
        self.adaptation.take(measurement.position, raw, measurement.supply_pressure, self._last)
        c = self._config
        viscous, coulomb, offset, share = self.adaptation.force.values if c.adapt_force else self._theta[1]
        flow = self.adaptation.flow.values if c.adapt_flow else self._theta[0]
        null, lap = flow[3:]
        motion, seen = self._motion.take(reference)
        lever, piston = model.geometry(motion[0])
        velocity = lever * motion[1]
        torque = self._torque(motion[0], motion[1], motion[2])
        force = (
            (1 + share) * torque / lever
            + viscous * velocity
            + coulomb * self._bristles.advance(velocity, self._period) + offset
        )
        if not self._started:
            self._forces = [force] * 4
            self._rate = np.zeros(self._n)
        forces = [force, *self._forces[:3]]
        last = self._rate
        self._rate = (force - forces[1]) / self._period
        rate = 1.5 * self._rate - 0.5 * last
        self._forces = forces
        whole = int(self._back)
        part = self._back - whole
        then = forces[whole] + part * (forces[whole + 1] - forces[whole])
        load = data.area[0] * raw[0] - data.area[1] * raw[1]
        measured_lever = model.geometry(measurement.position)[0]
        e = measured_lever * (seen.position - measurement.position)
        p = (load - then) / law.stiffness
        if not self._started:
            law.observer.start(e, p)
            self._started = True
        feedback = law(e, p)
        state = law.observer.state
        first = model.chambers(self._pressure, measurement.supply_pressure, piston)
        wa, wb = first.weight
        k = first.stiffness
        S = wb * self._pressure[0] + wa * self._pressure[1]
        F = force + law.stiffness * (state[:, 3] + self._config.load_share*(state[:,2]-state[:,3]))
        pressure = np.stack([(data.area[1] * S + wa * F) / k, (data.area[0] * S - wb * F) / k])
        pressure = np.clip(pressure, 0, measurement.supply_pressure)
        chambers = model.chambers(pressure, measurement.supply_pressure, piston)
        stiffness = chambers.stiffness
        rest = rate + model.rate_for(velocity, pressure, flow[:3], chambers)
        spool = model.spool_for(rest + stiffness * feedback, chambers, lap)
        limit = self._config.limit
        sent = (spool - null).clip(-limit, limit) + null
        if (sent != spool).any():
            feedback = (model.rate_of(sent, chambers, lap) - rest) / stiffness
        law.observer.sent(feedback)
        self._feedback, self._z = feedback, state
        self.pred=pressure
        self._last = sent - null
        return self._last

    def diagnostics(self):
        return {"feedback": self._feedback, "phi": self._z[:, 3], "eta": self._z[:, 4], "perr": self._z[:,2],"ee":self._z[:,0],"leak":self.adaptation.flow.values[0]*1e13,"lap":self.adaptation.flow.values[4],"null":self.adaptation.flow.values[3],"visc":self.adaptation.force.values[0],"coul":self.adaptation.force.values[1],"leakA":self.adaptation.flow.values[1]*1e13,"leakB":self.adaptation.flow.values[2]*1e13,"share":self.adaptation.force.values[3], "prA":self.pred[0],"prB":self.pred[1]}
