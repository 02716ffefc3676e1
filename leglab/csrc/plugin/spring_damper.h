// Passive plugin `leglab.spring_damper`: nonlinear spring, damper and soft stops beside a joint.
#pragma once

#include <mujoco/mujoco.h>

#include "plugin/spring_damper_parameters.h"

namespace leglab::plugin {

class SpringDamper {
 public:
  SpringDamper(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel* m, mjData* d);
  void visualize(const mjModel* m, mjData* d, mjvScene* scene) const;

  static constexpr int kStateCount = sizeof(SpringParameters) / sizeof(double);

 private:
  int instance_;
  int qpos_, dof_;
  int strut_ = -1;  // tendon along which the spring is drawn
  SpringParameters initial_;
};

void register_spring_damper();

}  // namespace leglab::plugin
