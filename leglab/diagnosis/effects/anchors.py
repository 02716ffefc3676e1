"""Mounting points of cylinders, which differ between good machines: fitted but never named."""

import math

import mujoco
import numpy as np

from leglab.diagnosis.effects.base import EffectParameter, TableEffect, Values, register_effect
from leglab.diagnosis.plant.model import Change, Machine

# Name of a site, its vector from the axis of a joint [m], and the derivative of its position by the
# joint angle [m/rad], both in the frame of the site's body.
Anchor = tuple[str, np.ndarray, np.ndarray]


def _row(name: str, unit: str, own: float) -> EffectParameter:
    return EffectParameter(
        name,
        unit,
        nominal=own,
        lower=own - 0.1,
        upper=own + 0.1,
        trials=(own - 0.02, own + 0.02),
        tolerance=0.005,
    )


@register_effect
class Anchors(TableEffect):
    """Misplaced mounting points: a cylinder's lever and length differ from the drawing."""

    name = "anchors"
    group = "mechanics"
    physics = (
        "Distances of a cylinder's fixed and moving anchor from the joint, as factors, and a turn "
        "of the moving one about it."
    )
    source = "general tolerances of machined parts, ISO 2768-1 m: 0.3 mm on 50 mm, of several parts"
    excitation = "a wide range of positions under load"
    nameable = False
    rows = (
        _row("fixed_distance", "1", 1.0),
        _row("moving_distance", "1", 1.0),
        _row("moving_angle", "rad", 0.0),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the cylinders whose two anchors move about one hinge relative to each other."""
        return tuple(c for c in machine.cylinders if anchors(machine, c))

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Moves the sites; each new value requires a compilation of the model."""
        fixed, moving, angle = values.values()
        if (fixed, moving, angle) == (1.0, 1.0, 0.0):
            return
        (base, out, _), (rod, away, along) = anchors(change.machine, element)
        turned = moving * (math.cos(angle) * away + math.sin(angle) * along)
        moves = {base: (fixed - 1.0) * out, rod: turned - away}

        def edit(spec: mujoco.MjSpec) -> None:
            for site, by in moves.items():
                spec.site(site).pos += by

        change.edit(("anchors", element, fixed, moving, angle), edit)


def anchors(machine: Machine, cylinder: str) -> tuple[Anchor, ...]:
    """Returns a cylinder's fixed and moving anchor; () unless one hinge alone moves them."""
    model, driven = machine.base.model, machine.driven[cylinder]
    actuator, joint = model.actuator(cylinder), model.joint(driven[0])
    on_tendon = int(actuator.trntype[0]) == int(mujoco.mjtTrn.mjTRN_TENDON)
    if not on_tendon or len(driven) != 1 or machine.unit(driven[0]) != "rad":
        return ()
    tendon = int(actuator.trnid[0])
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    if model.wrap_type[first : first + count].tolist() != [int(mujoco.mjtWrap.mjWRAP_SITE)] * 2:
        return ()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    centre, axis = data.xanchor[joint.id], data.xaxis[joint.id]
    found: dict[bool, Anchor] = {}
    for site in model.wrap_objid[first : first + count]:
        body = int(model.site_bodyid[site])
        frame = data.xmat[body].reshape(3, 3)
        away = data.site_xpos[site] - centre
        away = away - axis * (axis @ away)
        anchor = model.site(site).name, frame.T @ away, frame.T @ np.cross(axis, away)
        while body not in (0, int(joint.bodyid[0])):
            body = int(model.body_parentid[body])
        found[body != 0] = anchor
    return (found[False], found[True]) if len(found) == 2 else ()
