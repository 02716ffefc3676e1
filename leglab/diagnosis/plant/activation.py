"""Activation of MuJoCo's native actuators (filters, integrators, muscles) along a recording.

Activations depend only on the commands, so MuJoCo computes them by a simulation of a model with
these actuators alone. MuJoCo documentation, "Computation", "Activation dynamics".
"""

import mujoco
import numpy as np
from mujoco import rollout

_DYN, _OFF = mujoco.mjtDyn, mujoco.mjtDisableBit
INTEGRATOR = int(_DYN.mjDYN_INTEGRATOR)
_STATELESS = int(_DYN.mjDYN_NONE)
_SETTLES = (int(_DYN.mjDYN_FILTER), int(_DYN.mjDYN_FILTEREXACT), int(_DYN.mjDYN_MUSCLE))
_ATTRIBUTES = ("dyntype", "dynprm", "actlimited", "actrange", "ctrllimited", "ctrlrange", "group")


def unusable(model: mujoco.MjModel, actuator: int) -> str:
    """Returns the reason why replays cannot command an actuator; empty if they can."""
    if (count := int(model.actuator_ctrlnum[actuator])) != 1:
        names = [mujoco.mj_actuatorInputName(model, actuator, i) for i in range(count)]
        listed = f" ({', '.join(n for n in names if n)})" if any(names) else ""
        other = "" if count else ", or its damping and friction at the joint"
        return f"takes {count} controls{listed}; allowed: one{other}"
    if (outputs := int(model.actuator_outnum[actuator])) != 1:
        return f"has {outputs} force outputs; allowed: one"
    if mujoco.mjtGain(model.actuator_gaintype[actuator]) == mujoco.mjtGain.mjGAIN_USER:
        return "has a gain of type user, a callback; allowed: fixed, affine, muscle or dcmotor"
    if mujoco.mjtBias(model.actuator_biastype[actuator]) == mujoco.mjtBias.mjBIAS_USER:
        return "has a bias of type user, a callback; allowed: none, affine, muscle or dcmotor"
    known = (_STATELESS, INTEGRATOR, *_SETTLES)
    if not model.actuator_actnum[actuator]:
        return ""
    if int(model.actuator_dyntype[actuator]) in known and model.actuator_actnum[actuator] == 1:
        return ""
    return (
        "has a state that does not follow from its commands alone; allowed dynamics: none, "
        "integrator, filter, filterexact or muscle, or a dcmotor without states"
    )


def stateful(model: mujoco.MjModel) -> np.ndarray:
    """Returns the indices of the actuators that have an activation."""
    return np.flatnonzero(model.actuator_actnum)


def attributes(model: mujoco.MjModel) -> np.ndarray:
    """Returns the parameters that determine the activations, as one vector."""
    acting = stateful(model)
    rows = [np.ravel(getattr(model, f"actuator_{name}")[acting]) for name in _ATTRIBUTES]
    return np.concatenate([*rows, [model.opt.disableflags, model.opt.disableactuator]])


def activations(
    model: mujoco.MjModel,
    commands: np.ndarray,
    steps: int,
    timestep: float,
    integrated: np.ndarray | None = None,
) -> np.ndarray:
    """Returns the activations at the samples, (samples, stateful actuators).

    For an actuator whose activation is stepped before its force (`actearly`), it is the activation
    of one step earlier.

    Args:
        model: Model with the actuators.
        commands: Commands, held between samples, (samples, stateful actuators).
        steps: Simulation steps per sampling period.
        timestep: Time step of the simulation [s].
        integrated: Initial values of integrators, (stateful actuators,); 0 by default. Other
            actuators start in the steady state of the first command.
    """
    acting = stateful(model)
    bare = _bare(model, acting, timestep)
    data = mujoco.MjData(bare)
    clamped = bare.actuator_ctrllimited.astype(bool)
    if bare.opt.disableflags & int(_OFF.mjDSBL_CLAMPCTRL):
        clamped[:] = False
    low, high = bare.actuator_ctrlrange.T
    first = np.where(clamped, np.clip(commands[0], low, high), commands[0])
    muscles = bare.actuator_dyntype == int(_DYN.mjDYN_MUSCLE)
    first = np.where(muscles, np.clip(first, 0.0, 1.0), first)
    start = np.zeros(acting.size) if integrated is None else integrated
    first = np.where(bare.actuator_dyntype == INTEGRATOR, start, first)
    limited = bare.actuator_actlimited.astype(bool)
    first = np.where(limited, np.clip(first, *bare.actuator_actrange.T), first)
    data.act[:] = first
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(bare, kind))
    mujoco.mj_getState(bare, data, state, kind)
    control = np.repeat(commands, steps, axis=0)[None]
    states, _ = rollout.rollout(bare, data, initial_state=state[None], control=control)
    after = np.concatenate([first[None], states[0][:, 1 + bare.nq + bare.nv :]])
    place = np.arange(len(commands))[:, None] * steps - model.actuator_actearly[acting]
    return np.asarray(after[np.maximum(place, 0), np.arange(acting.size)])


def _bare(model: mujoco.MjModel, acting: np.ndarray, timestep: float) -> mujoco.MjModel:
    """Returns a model that has only the `acting` actuators, without their forces."""
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    spec.option.disableflags = int(model.opt.disableflags) | int(_OFF.mjDSBL_AUTORESET)
    spec.option.disableactuator = int(model.opt.disableactuator)
    body = spec.worldbody.add_body(name="any")
    body.mass, body.inertia, body.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
    body.add_joint(name="any")
    for number in acting:
        actuator = spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target="any")
        actuator.gainprm = np.zeros(len(actuator.gainprm))
        for name in _ATTRIBUTES:
            value = getattr(model, f"actuator_{name}")[number]
            setattr(actuator, name, value.tolist() if np.ndim(value) else int(value))
    return spec.compile()
