// Plugin `leglab.backlash`: play between the motor side and a joint with native actuators.
//
// The motor side is a separate inertia, driven by the joint's actuators; a flank in contact is a damped
// spring, solved implicitly together with both inertias, so that any stiffness is stable:
//   J w' = tau - T,  phi = theta - q,  T = k (phi -+ width/2) + c phi' beyond the play, never pulling.
// With play, the part of J that MuJoCo includes as the joint's armature is removed from the joint.
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "plugin/command_path.h"

namespace leglab::plugin {
namespace {

bool on_joint(const mjModel* m, int actuator, int joint) {
  const int kind = m->actuator_trntype[actuator];
  return (kind == mjTRN_JOINT || kind == mjTRN_JOINTINPARENT) &&
         m->actuator_trnid[2 * actuator] == joint;
}

bool passive_forces_disabled(const mjModel* m) {
  constexpr int both = mjDSBL_SPRING | mjDSBL_DAMPER;
  return (m->opt.disableflags & both) == both;
}

class Backlash : public Instance<BacklashTable> {
 public:
  Backlash(const mjModel* m, int instance)
      : Instance(m, instance), joint_(joint_attribute(m, instance)), dof_(m->jnt_dofadr[joint_]) {
    const std::string name = mj_id2name(m, mjOBJ_JOINT, joint_);
    for (int i = 0; i < m->nactuator; ++i) {
      if (!on_joint(m, i, joint_)) continue;
      require_native(m, instance, i);
      if (m->actuator_gaintype[i] != mjGAIN_FIXED) {
        refuse(m, instance, "an actuator of joint '" + name + "' has a gain that is not fixed; allowed: "
                            "motor, position, velocity");
      }
      actuators_.push_back(i);
    }
    if (actuators_.empty()) {
      refuse(m, instance, "attribute 'joint' = '" + name + "' has no native actuator; allowed: a joint "
                          "with a motor, position or velocity actuator");
    }
    if (initial_.motor_inertia_ == 0 && m->dof_armature[dof_] == 0) {
      refuse(m, instance, "attribute 'motor_inertia' = 0 and joint '" + name +
                              "' has no armature; allowed: one of them above 0");
    }
    // MuJoCo computes instances in order, but this instance needs the forces of all command paths.
    for (int i = instance + 1; i < m->nplugin; ++i) {
      if (!is_instance<CommandPath>(m, i)) continue;
      const int actuator = element_named(m, i, mjOBJ_ACTUATOR, m->nactuator, text_attribute(m, i, "actuator"));
      if (actuator >= 0 && on_joint(m, actuator, joint_)) later_paths_.push_back(i);
    }
    for (auto* scratch : {&actuation_, &column_, &unit_, &force_}) scratch->assign(m->nv, 0.0);
    unit_[dof_] = 1.0;
  }

  void compute(const mjModel* m, mjData* d, int capability) {
    if (capability == mjPLUGIN_PASSIVE) {  // MuJoCo has just cleared the passive forces
      added_ = 0;
      return;
    }
    const auto [p, s] = slots(m, d);
    d->qfrc_passive[dof_] -= added_;
    added_ = 0;
    if (p.width_ == 0.0 || passive_forces_disabled(m)) return;

    const double h = m->opt.timestep, v = d->qvel[dof_], half = 0.5 * p.width_;
    const double inertia = p.motor_inertia_ > 0 ? p.motor_inertia_ : m->dof_armature[dof_];
    if (!(inertia > 0)) refuse(m, instance_, "motor_inertia = 0 on a joint without armature; allowed: above 0");
    const double armature = std::min(inertia, m->dof_armature[dof_]);
    const bool seated = s.seated_width_ == p.width_;
    offset_ = seated ? s.offset_ : 0.0;
    velocity_ = seated ? s.motor_velocity_ : v;
    for (int i : later_paths_) instance_of<CommandPath>(d, i)->apply_ahead(m, d);
    const double servo = close_servo_loops(m, d, offset_, velocity_ - v);
    collect_actuation(m, d);
    drive_ = actuation_[dof_];

    // Joint acceleration without the motor side: `column_`, a row of M^-1, times the forces.
    mj_solveM(m, d, column_.data(), unit_.data(), 1);
    for (int i = 0; i < m->nv; ++i) {
      force_[i] = d->qfrc_passive[i] - d->qfrc_bias[i] + d->qfrc_applied[i];
      if (i != dof_) force_[i] += actuation_[i];
    }
    for (int body = 1; body < m->nbody; ++body) {
      const mjtNum* wrench = d->xfrc_applied + 6 * body;
      if (std::any_of(wrench, wrench + 6, [](mjtNum f) { return f != 0; })) {
        mj_applyFT(m, d, wrench, wrench + 3, d->xipos + 3 * body, body, force_.data());
      }
    }
    for (int j = 0; j < m->njnt; ++j) {  // gravity compensation, which MuJoCo adds later
      if (m->jnt_actgravcomp[j] && m->jnt_type[j] >= mjJNT_SLIDE) force_[m->jnt_dofadr[j]] += d->qfrc_gravcomp[m->jnt_dofadr[j]];
    }
    force_[dof_] += s.constraint_;  // force of the previous step, because the solver runs later
    double free = 0;
    for (int i = 0; i < m->nv; ++i) free += column_[i] * force_[i];
    double compliance = column_[dof_];  // acceleration per joint force, 1/(effective inertia)

    if (!seated) {  // initially at rest on the flank that a rigid gear would load
      const double load = drive_ - inertia * (free + compliance * drive_);
      offset_ = load > 0 ? half : load < 0 ? -half : 0.0;
    }
    // MuJoCo's integrator adds damping and the servo's slope to the joint's inertia. The slope
    // belongs to the motor side, so that `moved` subtracts it from the joint.
    const int integrator = m->opt.integrator;
    const bool implicit = integrator == mjINT_IMPLICIT || integrator == mjINT_IMPLICITFAST;
    const bool damped = implicit || !(m->opt.disableflags & mjDSBL_EULERDAMP);
    const double moved = armature + (implicit ? h * servo : 0.0);
    const double scale = 1.0 / (1.0 + compliance * ((damped ? h * m->dof_damping[dof_] : 0.0) - armature));
    free *= scale;
    compliance *= scale;

    inertia_ = inertia + h * servo;
    const double mass = 1.0 / (1.0 / inertia_ + compliance);
    const double c = 2.0 * p.damping_ratio_ * std::sqrt(p.stiffness_ * mass);
    const double closing = velocity_ + h * drive_ / inertia_ - (v + h * free);
    const double reach = offset_ + h * closing;
    const double side = reach > half ? 1.0 : reach < -half ? -1.0 : 0.0;
    transmitted_ = 0.0;
    if (side != 0.0) {
      const double force = (p.stiffness_ * (reach - side * half) + c * closing) /
                           (1.0 + (h * c + h * h * p.stiffness_) / mass);
      if (force * side > 0) transmitted_ = force;
    }
    added_ = transmitted_ - drive_ + moved * (free + compliance * transmitted_);
    d->qfrc_passive[dof_] += added_;
  }

  void advance(const mjModel* m, mjData* d) {
    const auto [p, s] = slots(m, d);
    if (p.width_ == 0.0 || passive_forces_disabled(m)) {
      s = {};
      return;
    }
    const double h = m->opt.timestep;
    s.motor_velocity_ = velocity_ + h * (drive_ - transmitted_) / inertia_;
    s.offset_ = offset_ + h * (s.motor_velocity_ - d->qvel[dof_]);
    s.transmitted_ = transmitted_;
    s.constraint_ = d->qfrc_constraint[dof_];
    s.seated_width_ = p.width_;
  }

 private:
  // Closes the servo loops on motor-side position and velocity; returns -dtau/dw of the actuators.
  double close_servo_loops(const mjModel* m, mjData* d, double offset,
                                     double velocity) const {
    double slope = 0;
    for (int id : actuators_) {
      const NativeActuator a = NativeActuator::at(m, id);
      if (a.disabled(m)) continue;
      mjtNum& force = d->actuator_force[a.output];
      const mjtNum* bias = m->actuator_biasprm + mjNBIAS * id;
      const double gear = m->actuator_gear[6 * a.output];
      if (m->actuator_biastype[id] == mjBIAS_AFFINE) {
        force += gear * (bias[1] * offset + bias[2] * velocity);
        const bool saturated = m->actuator_forcelimited[id] &&
                               (force <= m->actuator_forcerange[2 * id] ||
                                force >= m->actuator_forcerange[2 * id + 1]);
        if (!saturated) slope -= gear * gear * (bias[2] + m->opt.timestep * bias[1]);
      }
    }
    return std::max(slope, 0.0);
  }

  // Writes the generalised actuator forces within their limits, (nv,), to `actuation_`.
  void collect_actuation(const mjModel* m, const mjData* d) {
    std::fill(actuation_.begin(), actuation_.end(), 0.0);
    for (int id = 0; id < m->nactuator; ++id) {
      for (int out = m->actuator_outadr[id]; out < m->actuator_outadr[id] + m->actuator_outnum[id]; ++out) {
        double force = d->actuator_force[out];
        if (m->actuator_forcelimited[id]) {
          force = std::clamp(force, m->actuator_forcerange[2 * id], m->actuator_forcerange[2 * id + 1]);
        }
        const int address = d->moment_rowadr[out], count = d->moment_rownnz[out];
        for (int i = address; i < address + count; ++i) {
          actuation_[d->moment_colind[i]] += d->actuator_moment[i] * force;
        }
      }
    }
    for (int j = 0; j < m->njnt; ++j) {
      if (!m->jnt_actfrclimited[j]) continue;
      mjtNum& force = actuation_[m->jnt_dofadr[j]];
      force = std::clamp(force, m->jnt_actfrcrange[2 * j], m->jnt_actfrcrange[2 * j + 1]);
    }
  }

  int joint_, dof_;
  std::vector<int> actuators_;    // actuators on this joint
  std::vector<int> later_paths_;  // command paths of these actuators that MuJoCo computes later

  // Outputs of the latest `compute`.
  double added_ = 0;  // force added to qfrc_passive since MuJoCo last cleared qfrc_passive
  double offset_ = 0, velocity_ = 0, transmitted_ = 0, drive_ = 0, inertia_ = 1;
  std::vector<double> actuation_, column_, unit_, force_;  // scratch, (nv,)
};

}  // namespace

mjPLUGIN_LIB_INIT(leglab_backlash) { register_plugin<Backlash>(mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE); }

}  // namespace leglab::plugin
