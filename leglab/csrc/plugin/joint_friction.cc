// Passive plugin `leglab.joint_friction`: LuGre friction of a joint, which grows with wear.
#include <cmath>

#include "plugin/lifecycle.h"

namespace leglab::plugin {
namespace {

class JointFriction : public Instance<hydraulics::FrictionTable> {
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
    const auto now = hydraulics::FrictionLevel::at(p, v, s.load_, d->time);
    double force = now.viscous * v;
    if (now.sliding > 0) {
      // z' is a mean over the step instead of a value at its start, because at speed a bristle
      // relaxes within microseconds.
      const double h = m->opt.timestep;
      const double next = hydraulics::advance_bristle(s.bristle_, v, now.sliding, p.sigma_0_, h);
      force += p.sigma_0_ * s.bristle_ + p.sigma_1_ * (next - s.bristle_) / h;
    }
    d->qfrc_passive[dof_] -= force;
  }

  void advance(const mjModel* m, mjData* d) {
    const auto [p, s] = slots(m, d);
    const double v = d->qvel[dof_], h = m->opt.timestep;
    // MuJoCo computes passive forces before actuator forces, so the load is of the previous step.
    s.load_ = std::abs(p.actuator_load_coefficient_ * d->qfrc_actuator[dof_] +
                       p.bias_load_coefficient_ * d->qfrc_bias[dof_]);
    const double g = hydraulics::FrictionLevel::at(p, v, s.load_, d->time).sliding;
    s.bristle_ = hydraulics::advance_bristle(s.bristle_, v, g, p.sigma_0_, h);
    s.sliding_distance_ += std::abs(v) * h;
    p.wear_ += p.wear_rate_ * std::abs(v) * h;
  }

 private:
  int dof_;
};

}  // namespace

mjPLUGIN_LIB_INIT(leglab_joint_friction) { register_plugin<JointFriction>(mjPLUGIN_PASSIVE); }

}  // namespace leglab::plugin
