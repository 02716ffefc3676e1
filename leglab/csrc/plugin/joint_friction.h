// Passive plugin `leglab.joint_friction`: LuGre friction of a joint that grows with wear.
#pragma once

#include <mujoco/mujoco.h>

#include "plugin/joint_friction_parameters.h"

namespace leglab::plugin {

class JointFriction {
 public:
  JointFriction(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel* m, mjData* d);
  void advance(const mjModel* m, mjData* d);

  static constexpr int kParameterCount = sizeof(FrictionParameters) / sizeof(double);
  static constexpr int kStateCount = kParameterCount + sizeof(FrictionState) / sizeof(double);

 private:
  int instance_;
  int dof_;
  FrictionParameters initial_;
};

void register_joint_friction();

}  // namespace leglab::plugin
