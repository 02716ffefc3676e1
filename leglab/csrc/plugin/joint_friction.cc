// Passive plugin `leglab.joint_friction`: LuGre friction of a joint that grows with wear.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "hydraulics/friction.h"
#include "plugin/lifecycle.h"

namespace leglab::plugin {
namespace {

// Friction at a velocity: steady bristle force g and viscous coefficient.
struct Level {
  double sliding;  // N m or N, not negative
  double viscous;  // N m s/rad or N s/m
};

// Wear and slow drift scale everything, the direction of sliding shifts and scales, the load that
// the joint carries adds to Coulomb and breakaway friction alike (Duclusaud et al. 2025).
Level level(const FrictionParameters& p, const FrictionState& s, double time, double v) {
  const double drift =
      1.0 + p.drift_amplitude_ * std::sin(2.0 * std::numbers::pi * time / p.drift_period_);
  const double side = v > 0 ? 1.0 : v < 0 ? -1.0 : 0.0;
  const double scale = p.wear_ * drift * (1.0 + side * p.direction_asymmetry_);
  const double shift = 0.5 * side * p.coulomb_difference_ + s.load_;
  const double coulomb = std::max(p.coulomb_ + shift, 0.0), top = std::max(p.static_ + shift, 0.0);
  return {coulomb > 0 || top > 0
              ? hydraulics::stribeck(v, scale * coulomb, scale * top, p.stribeck_velocity_,
                                   p.stribeck_exponent_)
              : 0.0,
          scale * (p.viscous_ + 0.5 * side * p.viscous_difference_)};
}

class JointFriction : public Instance<FrictionTable> {
 public:
  JointFriction(const mjModel* m, int instance)
      : Instance(m, instance), dof_(m->jnt_dofadr[joint_attribute(m, instance)]) {
    if (initial_.static_ < initial_.coulomb_) {
      refuse(m, instance, "attribute 'static' = " + number(initial_.static_) +
                              " " + unit_at_joint(m, instance, "N m") +
                              "; allowed: at least coulomb = " + number(initial_.coulomb_));
    }
  }

  void compute(const mjModel* m, mjData* d) {
    const auto [p, s] = slots(m, d);
    const double v = d->qvel[dof_];
    const Level now = level(p, s, d->time, v);
    double force = now.viscous * v;
    if (now.sliding > 0) {
      // Mean of z' over the step: at speed a bristle relaxes within microseconds, and z' at one
      // moment would stand for the whole step.
      const double h = m->opt.timestep;
      const double next = hydraulics::advance_bristle(s.bristle_, v, now.sliding, p.sigma_0_, h);
      force += p.sigma_0_ * s.bristle_ + p.sigma_1_ * (next - s.bristle_) / h;
    }
    d->qfrc_passive[dof_] -= force;
  }

  void advance(const mjModel* m, mjData* d) {
    const auto [p, s] = slots(m, d);
    const double v = d->qvel[dof_], h = m->opt.timestep;
    // MuJoCo computes passive forces before the actuators': the load is that of the step before.
    s.load_ = std::abs(p.actuator_load_coefficient_ * d->qfrc_actuator[dof_] +
                       p.bias_load_coefficient_ * d->qfrc_bias[dof_]);
    const double g = level(p, s, d->time, v).sliding;
    s.bristle_ = g > 0 ? hydraulics::advance_bristle(s.bristle_, v, g, p.sigma_0_, h) : 0.0;
    s.sliding_distance_ += std::abs(v) * h;
    p.wear_ += p.wear_rate_ * std::abs(v) * h;
  }

 private:
  int dof_;
};

}  // namespace

mjPLUGIN_LIB_INIT(leglab_joint_friction) { register_plugin<JointFriction>(mjPLUGIN_PASSIVE); }

}  // namespace leglab::plugin
