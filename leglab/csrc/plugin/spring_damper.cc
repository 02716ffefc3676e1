#include "plugin/spring_damper.h"

#include <cmath>
#include <cstring>

#include "plugin/config.h"
#include "plugin/drawing.h"
#include "plugin/lifecycle.h"

namespace leglab::plugin {

SpringDamper::SpringDamper(const mjModel* m, int instance) : instance_(instance) {
  const int joint = joint_attribute(m, instance);
  qpos_ = m->jnt_qposadr[joint];
  dof_ = m->jnt_dofadr[joint];
  read_parameters(m, instance, kSpringParameters, reinterpret_cast<double*>(&initial_));
  if (initial_.stop_lower_ >= initial_.stop_upper_) {
    refuse(m, instance, "attribute 'stop_lower' = " + number(initial_.stop_lower_) +
                            " rad; allowed: less than stop_upper = " + number(initial_.stop_upper_));
  }
  const std::string strut = text_attribute(m, instance, "strut");
  if (!strut.empty()) {
    strut_ = mj_name2id(m, mjOBJ_TENDON, strut.c_str());
    if (strut_ < 0) refuse(m, instance, "attribute 'strut' = '" + strut + "' names no tendon");
  }
}

void SpringDamper::reset(mjtNum* plugin_state) const {
  std::memcpy(plugin_state, &initial_, sizeof initial_);
}

// tau = -(k1 y + k2 y^3 sin^2 y + k3 y^3) - d1 y' - d2 |y'| y' + offset - stops.
void SpringDamper::compute(const mjModel* m, mjData* d) {
  const auto& p = *reinterpret_cast<const SpringParameters*>(state_of(m, d, instance_));
  const double q = d->qpos[qpos_], v = d->qvel[dof_];
  const double y = q - p.rest_position_;
  const double sine = std::sin(y);
  double force = p.force_offset_ - (p.k1_ + (p.k2_ * sine * sine + p.k3_) * y * y) * y -
                 (p.d1_ + p.quadratic_damping_ * std::abs(v)) * v;
  if (q < p.stop_lower_) force += p.stop_stiffness_ * (p.stop_lower_ - q) - p.stop_damping_ * v;
  if (q > p.stop_upper_) force += p.stop_stiffness_ * (p.stop_upper_ - q) - p.stop_damping_ * v;
  d->qfrc_passive[dof_] += force;
}

void SpringDamper::visualize(const mjModel* m, mjData* d, mjvScene* scene) const {
  mjtNum base[3], end[3];
  if (strut_ >= 0 && tendon_ends(m, d, strut_, base, end)) draw_strut(scene, base, end);
}

void register_spring_damper() {
  static const std::vector<const char*> names = attribute_names(kSpringParameters, {"joint", "strut"});
  register_plugin<SpringDamper>("leglab.spring_damper", mjPLUGIN_PASSIVE, names);
}

}  // namespace leglab::plugin
