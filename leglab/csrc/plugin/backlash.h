// Plugin `leglab.backlash`: play between the motor side and a joint with native actuators.
//
// The motor side is an inertia of its own, driven by the joint's actuators; a flank in contact is a
// damped spring, solved implicitly together with both inertias, so that any stiffness is stable:
//   J w' = tau - T,  phi = theta - q,  T = k (phi -+ width/2) + c phi' beyond the play, never pulling.
// The part of J that MuJoCo holds as the joint's armature is taken off the joint while there is play.
#pragma once

#include <vector>

#include <mujoco/mujoco.h>

#include "plugin/backlash_parameters.h"

namespace leglab::plugin {

class Backlash {
 public:
  Backlash(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel* m, mjData* d, int capability);
  void advance(const mjModel* m, mjData* d);

  static constexpr int kParameterCount = sizeof(BacklashParameters) / sizeof(double);
  static constexpr int kStateCount = kParameterCount + sizeof(BacklashState) / sizeof(double);

 private:
  double motor_inertia(const mjModel* m, const BacklashParameters& p) const;
  // Lets the servos see the motor side; returns -dtau/dw of the joint's actuators.
  double close_servo_loops(const mjModel* m, mjData* d, double offset, double velocity) const;
  // Generalised actuator forces within their limits, (nv,), into `actuation_`.
  void collect_actuation(const mjModel* m, const mjData* d);

  int instance_;
  int joint_, dof_;
  std::vector<int> actuators_;    // on this joint
  std::vector<int> later_paths_;  // leglab.command_path of those, computed after this instance
  BacklashParameters initial_;

  // Outputs of the latest `compute`.
  double added_ = 0;  // to qfrc_passive since it was cleared
  double offset_ = 0, velocity_ = 0, transmitted_ = 0, drive_ = 0, inertia_ = 1;
  std::vector<double> actuation_, column_, unit_, force_;  // scratch, (nv,)
};

void register_backlash();

}  // namespace leglab::plugin
