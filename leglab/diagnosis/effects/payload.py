"""Payload: an additional mass on a moving body."""

import mujoco

from leglab.diagnosis.effects.base import Effect, EffectParameter, Values, register_effect
from leglab.diagnosis.plant.model import Change, Machine


@register_effect
class Payload(Effect):
    """A point mass fixed to a moving body."""

    name = "payload"
    group = "mechanics"
    physics = "Point mass m at a distance r along the line from the joint to the body's centre."
    source = "mechanics; bounds: tools and loads of a leg of 5 to 80 kg"
    excitation = "positions away from the balance point; speed changes separate m r from m r^2"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Bodies with a name and mass that a joint moves."""
        model = machine.base.model
        return tuple(
            model.body(i).name
            for i in range(1, model.nbody)
            if model.body_jntnum[i] and model.body_mass[i] > 0 and model.body(i).name
        )

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Mass and distance."""
        body = machine.base.model.body(element)
        own, reach = float(body.mass[0]), float((body.ipos**2).sum() ** 0.5)
        mass = EffectParameter("mass", "kg", upper=5.0 * own, trials=(0.05 * own, 0.4 * own))
        if reach == 0.0:  # nowhere along the line: at the centre itself
            return (mass,)
        nominal, lower, upper = 1.5 * reach, 0.1 * reach, 3.0 * reach
        return mass, EffectParameter(
            "distance", "m", nominal=nominal, lower=lower, upper=upper, role="shape"
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Adds a body with the mass; the model is compiled anew for every value."""
        mass, distance = values["mass"], values.get("distance", 0.0)
        if mass == 0.0:
            return
        centre = change.machine.base.model.body(element).ipos
        reach = float((centre @ centre) ** 0.5)
        position = centre * (distance / reach) if reach > 0.0 else centre

        def add(spec: mujoco.MjSpec) -> None:
            load = spec.body(element).add_body(name=f"{element}_payload", pos=position)
            load.mass = mass
            load.ipos = [0.0, 0.0, 0.0]  # left alone, MuJoCo puts the body's position here again
            load.inertia = [1e-9, 1e-9, 1e-9]  # MuJoCo wants a positive one; a point has none
            load.explicitinertial = True

        change.edit(("payload", element, mass, distance), add)
