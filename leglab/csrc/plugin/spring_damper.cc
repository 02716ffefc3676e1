// Passive plugin `leglab.spring_damper`: nonlinear spring, damper and soft stops of a joint.
#include <cmath>
#include <numbers>

#include "plugin/drawing.h"
#include "plugin/lifecycle.h"

namespace leglab::plugin {
namespace {

class SpringDamper : public Instance<SpringTable> {
 public:
  SpringDamper(const mjModel* m, int instance) : Instance(m, instance) {
    const int joint = joint_attribute(m, instance);
    qpos_ = m->jnt_qposadr[joint];
    dof_ = m->jnt_dofadr[joint];
    if (initial_.stop_lower_ >= initial_.stop_upper_) {
      refuse(m, instance, "attribute 'stop_lower' = " + number(initial_.stop_lower_) +
                              " " + unit_at_joint(m, instance, "rad") +
                              "; allowed: less than stop_upper = " + number(initial_.stop_upper_));
    }
    const std::string strut = text_attribute(m, instance, "strut");
    if (!strut.empty()) {
      strut_ = element_named(m, instance, mjOBJ_TENDON, m->ntendon, strut);
      if (strut_ < 0) refuse(m, instance, "attribute 'strut' = '" + strut + "' names no tendon");
    }
  }

  // tau = -(k1 y + k2 y^3 sin^2 y + k3 y^3) - d1 y' - d2 |y'| y' + offset + ripple(q) - stops.
  void compute(const mjModel* m, mjData* d) {
    const Parameters& p = slots(m, d).parameters;
    const double q = d->qpos[qpos_], v = d->qvel[dof_];
    const double y = q - p.rest_position_;
    const double sine = std::sin(y);
    double force = p.force_offset_ - (p.k1_ + (p.k2_ * sine * sine + p.k3_) * y * y) * y -
                   (p.d1_ + p.quadratic_damping_ * std::abs(v)) * v;
    force += ripple(p, q);
    if (q < p.stop_lower_) force += p.stop_stiffness_ * (p.stop_lower_ - q) - p.stop_damping_ * v;
    if (q > p.stop_upper_) force += p.stop_stiffness_ * (p.stop_upper_ - q) - p.stop_damping_ * v;
    d->qfrc_passive[dof_] += force;
  }

  void visualize(const mjModel* m, mjData* d, mjvScene* scene) const {
    mjtNum base[3], end[3];
    if (strut_ >= 0 && tendon_ends(m, d, strut_, base, end)) draw_strut(scene, base, end);
  }

 private:
  // First two harmonics of a force that is periodic in the position.
  static double ripple(const Parameters& p, double q) {
    double force = 0.0;
    const double angle = 2.0 * std::numbers::pi * q / p.ripple_period_;
    if (p.ripple_sine_ != 0.0 || p.ripple_cosine_ != 0.0) {
      force += p.ripple_sine_ * std::sin(angle) + p.ripple_cosine_ * std::cos(angle);
    }
    if (p.ripple_sine_2_ != 0.0 || p.ripple_cosine_2_ != 0.0) {
      force += p.ripple_sine_2_ * std::sin(2.0 * angle) + p.ripple_cosine_2_ * std::cos(2.0 * angle);
    }
    return force;
  }

  int qpos_, dof_;
  int strut_ = -1;  // tendon along which the spring is drawn
};

}  // namespace

mjPLUGIN_LIB_INIT(leglab_spring_damper) { register_plugin<SpringDamper>(mjPLUGIN_PASSIVE); }

}  // namespace leglab::plugin
