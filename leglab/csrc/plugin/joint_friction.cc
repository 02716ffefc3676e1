#include "plugin/joint_friction.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

#include "hydraulics/friction.h"
#include "plugin/config.h"
#include "plugin/lifecycle.h"

namespace leglab::plugin {
namespace {

// Relative friction at a time: wear times slow drift times the direction of sliding. It may be
// zero; the bristle then sees a vanishing, not a zero, friction.
double level(const FrictionParameters& p, double time, double v) {
  const double drift =
      1.0 + p.drift_amplitude_ * std::sin(2.0 * std::numbers::pi * time / p.drift_period_);
  const double side = v > 0 ? 1.0 + p.direction_asymmetry_ : 1.0 - p.direction_asymmetry_;
  return p.wear_ * drift * (v == 0 ? 1.0 : side);
}

double sliding_force(const FrictionParameters& p, double scale, double v) {
  return hydraulics::stribeck(v, scale * p.coulomb_, scale * p.static_, p.stribeck_velocity_);
}

}  // namespace

JointFriction::JointFriction(const mjModel* m, int instance) : instance_(instance) {
  require_single_stage_integrator(m, instance);
  dof_ = m->jnt_dofadr[joint_attribute(m, instance)];
  read_parameters(m, instance, kFrictionParameters, reinterpret_cast<double*>(&initial_));
  if (initial_.static_ < initial_.coulomb_) {
    refuse(m, instance, "attribute 'static' = " + number(initial_.static_) +
                            " N; allowed: at least coulomb = " + number(initial_.coulomb_));
  }
}

void JointFriction::reset(mjtNum* plugin_state) const {
  std::memcpy(plugin_state, &initial_, sizeof initial_);
  const FrictionState s{};
  std::memcpy(plugin_state + kParameterCount, &s, sizeof s);
}

void JointFriction::compute(const mjModel* m, mjData* d) {
  const mjtNum* head = state_of(m, d, instance_);
  const auto& p = *reinterpret_cast<const FrictionParameters*>(head);
  const auto& s = *reinterpret_cast<const FrictionState*>(head + kParameterCount);
  const double v = d->qvel[dof_];
  const double scale = level(p, d->time, v);
  const double g = sliding_force(p, scale, v);
  // z'/v = 1 - sgn(v) sigma_0 z / g. Bounded, since g may fall at once (wear set anew, a direction
  // without friction) and the bristle follows only with the next step.
  const double relative_rate =
      std::clamp(1.0 - std::copysign(p.sigma_0_ * s.bristle_ / g, v * s.bristle_), -4.0, 4.0);
  const double rate = v * relative_rate;
  d->qfrc_passive[dof_] -= p.sigma_0_ * s.bristle_ + p.sigma_1_ * rate + scale * p.viscous_ * v;
}

void JointFriction::advance(const mjModel* m, mjData* d) {
  mjtNum* head = state_of(m, d, instance_);
  auto& p = *reinterpret_cast<FrictionParameters*>(head);
  auto& s = *reinterpret_cast<FrictionState*>(head + kParameterCount);
  const double v = d->qvel[dof_], h = m->opt.timestep;
  const double g = sliding_force(p, level(p, d->time, v), v);
  s.bristle_ = hydraulics::advance_bristle(s.bristle_, v, g, p.sigma_0_, h);
  s.sliding_distance_ += std::abs(v) * h;
  p.wear_ += p.wear_rate_ * std::abs(v) * h;
}

void register_joint_friction() {
  static const std::vector<const char*> names = attribute_names(kFrictionParameters, {"joint"});
  register_plugin<JointFriction>("leglab.joint_friction", mjPLUGIN_PASSIVE, names);
}

}  // namespace leglab::plugin
