"""Values that MuJoCo's compiler derives from inertia, fixed at those of the unmodified model.

For example, `dampratio` and `springdamper` are relative to inertia, but a real drive's damping does
not change with its load. Lengths and largest forces of muscles, and masses that the compiler scales
or bounds, are fixed for the same reason. MuJoCo documentation, "XML reference".
"""

import mujoco
import numpy as np

_MUSCLE_GAIN = mujoco.mjtGain.mjGAIN_MUSCLE
_MUSCLE_BIAS = mujoco.mjtBias.mjBIAS_MUSCLE


class AsCompiled:
    """Values that the compiler derives, to be written into further specifications of the same file.

    Raises:
        ValueError: MuJoCo refuses the model.
    """

    def __init__(self, spec: mujoco.MjSpec) -> None:
        compiler = spec.compiler
        self._masses = (
            compiler.settotalmass > 0.0
            or compiler.boundmass > 0.0
            or compiler.boundinertia > 0.0
            or bool(compiler.balanceinertia)
        )
        self._model: mujoco.MjModel | None = None
        if (
            self._masses
            or any(joint.springdamper.any() for joint in spec.joints)
            or any(_ratio(a) or _muscle(a) for a in spec.actuators)
        ):
            fused, compiler.fusestatic = compiler.fusestatic, False  # bodies as in the file
            try:
                self._model = spec.compile()
            finally:
                compiler.fusestatic = fused

    def keep(self, spec: mujoco.MjSpec) -> None:
        """Writes the values into a specification that was newly read from the same file."""
        model = self._model
        if model is None:
            return
        for number, actuator in enumerate(spec.actuators):
            if _ratio(actuator):
                actuator.biasprm = model.actuator_biasprm[number]
            if _muscle(actuator):
                _keep_muscle(actuator, model, number)
        for own, joint in enumerate(spec.joints):
            if joint.springdamper.any():
                dof = int(model.jnt_dofadr[own])
                joint.springdamper = [0.0, 0.0]
                joint.stiffness = [float(model.jnt_stiffness[own]), 0.0, 0.0]
                joint.damping = [float(model.dof_damping[dof]), 0.0, 0.0]
        if self._masses:
            _keep_masses(spec, model)


def _keep_muscle(actuator: mujoco.MjsActuator, model: mujoco.MjModel, number: int) -> None:
    actuator.lengthrange = model.actuator_lengthrange[number]
    for name in ("gainprm", "biasprm"):
        values = np.array(getattr(actuator, name))
        if values[2] < 0.0:  # force = scale / acc0
            values[2] = values[3] / max(mujoco.mjMINVAL, float(model.actuator_acc0[number]))
            setattr(actuator, name, values)


def _keep_masses(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    compiler = spec.compiler
    compiler.settotalmass, compiler.balanceinertia = -1.0, False
    compiler.boundmass = compiler.boundinertia = 0.0
    compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for number, body in enumerate(spec.bodies):
        if number == 0:
            continue
        body.mass, body.inertia = model.body_mass[number], model.body_inertia[number]
        body.ipos, body.iquat = model.body_ipos[number], model.body_iquat[number]
        body.fullinertia, body.explicitinertial = np.full(6, np.nan), True


def _ratio(actuator: mujoco.MjsActuator) -> bool:
    """Tests whether a servo's damping is a damping ratio, which the compiler converts."""
    return bool(actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and actuator.biasprm[2] > 0.0)


def _muscle(actuator: mujoco.MjsActuator) -> bool:
    return bool(actuator.gaintype == _MUSCLE_GAIN or actuator.biastype == _MUSCLE_BIAS)
