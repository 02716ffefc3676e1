// A native actuator: force = gain(length, velocity) input + bias.
#pragma once

#include <mujoco/mujoco.h>

namespace leglab::plugin {

struct NativeActuator {
  int id;      // actuator
  int ctrl;    // index in mjData.ctrl
  int output;  // index in mjData.actuator_force

  static NativeActuator at(const mjModel* m, int id) {
    return {id, m->actuator_ctrladr[id], m->actuator_outadr[id]};
  }

  bool disabled(const mjModel* m) const {
    const int group = m->actuator_group[id];
    return group >= 0 && group < 31 && (m->opt.disableactuator & (1 << group));
  }

  // The command as MuJoCo applies it: clamped to its range, 0 if it is not finite or too large.
  double command(const mjModel* m, const mjData* d) const;

  // Tests whether force = gain (input - length) - damping x velocity.
  bool position_servo(const mjModel* m) const;

  // Activation of an actuator with dynamics.
  double activation(const mjModel* m, const mjData* d) const {
    return d->act[m->actuator_actadr[id] + m->actuator_actnum[id] - 1];
  }

  // dForce/dInput at the present length and velocity; fixed or affine gain.
  double gain(const mjModel* m, const mjData* d) const;
};

// The actuator that the attribute `actuator` names; rejects the same actuators as `require_native`.
NativeActuator actuator_attribute(const mjModel* m, int instance);

// Rejects an actuator that is a plugin itself, or has several inputs or a nonlinear gain or bias.
void require_native(const mjModel* m, int instance, int actuator);

}  // namespace leglab::plugin
