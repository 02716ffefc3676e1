#include "plugin/cylinder.h"

#include <cstdio>
#include <cstring>

#include "plugin/drawing.h"
#include "plugin/residual.h"
#include "plugin/supply.h"

namespace leglab::plugin {

using namespace hydraulics;

Cylinder::Cylinder(const mjModel* m, int instance)
    : Instance(m, instance), half_solved_(m->nv, 0.0) {
  for (int i = 0; i < m->nu; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    if (actuator_ >= 0) refuse(m, instance, "drives two actuators; allowed: one actuator an instance");
    actuator_ = i;
  }
  if (actuator_ < 0) refuse(m, instance, "drives no actuator; allowed: one actuator an instance");

  const std::string wrong = contradiction(initial_);
  if (!wrong.empty()) refuse(m, instance, wrong);
  const std::string supply = text_attribute(m, instance, "supply");
  if (!supply.empty()) {
    supply_ = element_named(m, instance, mjOBJ_PLUGIN, m->nplugin, supply);
    if (supply_ < 0 || !is_instance<Supply>(m, supply_)) {
      refuse(m, instance, "attribute 'supply' = '" + supply + "'; allowed: the name of a " +
                              Supply::Table::plugin + " instance");
    }
  }
  residual_ = Residual::of_cylinder(m, actuator_);
  refresh(m, initial_);
}

// The symplectic coupling of oil spring and mechanism is accurate for w_h h <= 0.7 (w_h: natural
// frequency, h: time step) and unstable beyond 2. A value above 1, computed at qpos0, is rejected.
void Cylinder::check_timestep(const mjModel* m) const {
  const int target = m->actuator_trnid[2 * actuator_];
  double inverse_mass = 0, length = 0;
  if (m->actuator_trntype[actuator_] == mjTRN_TENDON) {
    inverse_mass = m->tendon_invweight0[target];
    length = m->tendon_length0[target];
  } else if (m->actuator_trntype[actuator_] == mjTRN_JOINT) {
    inverse_mass = m->dof_invweight0[m->jnt_dofadr[target]];
    length = m->qpos0[m->jnt_qposadr[target]];
  }
  if (!(inverse_mass > 0)) return;  // while the model is being compiled
  const CylinderParameters& p = initial_;
  const CylinderCoefficients& c = coefficients_;
  const double x = std::clamp(c.half_stroke + length - p.mid_length_, 0.0, p.stroke_);
  const Volumes v = Volumes::at(p, c, x);
  const double stiffness = p.bulk_modulus_ * (c.area_a * c.area_a / v.a + c.area_b * c.area_b / v.b);
  const double frequency = std::sqrt(stiffness * inverse_mass);
  if (frequency * m->opt.timestep > 1.0) {
    char text[200];
    std::snprintf(text, sizeof text,
                  "option timestep = %g s is too long for a hydraulic natural frequency of %.0f rad/s "
                  "(w_h h = %.2f, allowed 1): use at most %.3g s",
                  m->opt.timestep, frequency, frequency * m->opt.timestep, 1.0 / frequency);
    refuse(m, instance_, text);
  }
}

void Cylinder::reset(mjtNum* plugin_state) const {
  Instance::reset(plugin_state);
  auto& s = *reinterpret_cast<CylinderState*>(plugin_state + kParameterCount);
  s.pressure_a_ = initial_.initial_pressure_a_;
  s.pressure_b_ = initial_.initial_pressure_b_;
}

void Cylinder::refresh(const mjModel* m, const CylinderParameters& p) {
  const double timestep = m->opt.timestep;
  if (std::memcmp(&p, &seen_, sizeof p) == 0 && timestep == seen_timestep_) return;
  CylinderParameters same = p;  // copy, except the two parameters that the plugin itself changes
  same.oil_temperature_ = seen_.oil_temperature_;
  same.seal_clearance_ = seen_.seal_clearance_;
  if (std::memcmp(&same, &seen_, sizeof p) != 0 || timestep != seen_timestep_) {
    coefficients_ = CylinderCoefficients::from(p);
    step_ = StepCoefficients::from(p, timestep);
    observed_ = kNothing;
  }
  if (timestep != seen_timestep_) check_timestep(m);
  oil_ = OilCondition::from(p, coefficients_);
  seen_ = p;
  seen_timestep_ = timestep;
}

double Cylinder::supply_pressure(const mjModel* m, mjData* d, const CylinderParameters& p) const {
  return supply_ < 0 ? p.supply_pressure_ : Supply::pressure(m, d, supply_);
}

// 1/(J M^-1 J') with J the row of the actuator moment. M = L' D L, so half a solve is enough. L has the
// sparsity of M: the row of a degree of freedom has entries for its ancestors, then for itself.
double Cylinder::effective_mass(const mjModel* m, mjData* d) {
  const int address = d->moment_rowadr[actuator_], count = d->moment_rownnz[actuator_];
  int top = -1;
  for (int i = address; i < address + count; ++i) {
    half_solved_[d->moment_colind[i]] = d->actuator_moment[i];
    top = std::max(top, d->moment_colind[i]);
  }
  double inverse = 0;
  for (int i = top; i >= 0; --i) {
    const double value = half_solved_[i];
    if (value == 0) continue;
    half_solved_[i] = 0;
    inverse += value * value * d->qLDiagInv[i];
    const int row = m->M_rowadr[i], ancestors = m->M_rownnz[i] - 1;
    for (int k = row; k < row + ancestors; ++k) {
      half_solved_[m->M_colind[k]] -= d->qLD[k] * value;
    }
  }
  return inverse > 0 ? 1.0 / inverse : 0.0;
}

const Chambers& Cylinder::observe(const mjModel* m, mjData* d) {
  const auto [p, s] = slots(m, d);
  refresh(m, p);
  const double x = coefficients_.half_stroke + d->actuator_length[actuator_] - p.mid_length_ +
                   play_offset(p, coefficients_, s);
  const Observed now{x, s.pressure_a_, s.pressure_b_, s.amount_a_, s.amount_b_};
  if (std::memcmp(&now, &observed_, sizeof now) != 0) {
    observed_ = now;
    x_ = x;
    chambers_ = chambers_at(p, coefficients_, s, x);
  }
  return chambers_;
}

void Cylinder::compute(const mjModel* m, mjData* d) {
  const auto [p, s] = slots(m, d);
  if (m->opt.integrator == mjINT_RK4) require_single_stage_integrator(m, instance_);
  observe(m, d);
  v_ = d->actuator_velocity[actuator_];
  mass_ = effective_mass(m, d);
  const double h = m->opt.timestep;
  if (p.play_ > 0 && mass_ > 0) {
    const bool seated = s.seated_play_ == p.play_;
    const double v_pin = v_;
    if (seated) v_ = s.piston_velocity_;
    const double offset = play_offset(p, coefficients_, s);
    // A piston in contact with its pin decelerates together with the mechanism's mass.
    moved_ = p.piston_mass_ + (std::abs(offset) > 0.5 * p.play_ ? mass_ : 0.0);
    forces_ = piston_forces(p, coefficients_, oil_, s, chambers_, x_, v_, h / moved_);
    oil_spring_ = chambers_.stiffness(coefficients_);
    play_ = play_step(p, offset, v_, v_pin, forces_.total(),
                      seated ? s.pin_load_ : -forces_.total(), mass_, oil_spring_, h);
    d->actuator_force[actuator_] = play_.transmitted;
  } else {
    forces_ = piston_forces(p, coefficients_, oil_, s, chambers_, x_, v_, mass_ > 0 ? h / mass_ : 0.0);
    d->actuator_force[actuator_] = forces_.total();
  }
  // The command, delayed if the actuator has a delay.
  command_ = d->ctrl[actuator_];
  if (m->actuator_historyadr[actuator_] >= 0) {
    mjtNum between = 0;
    const mjtNum* held = mj_readCtrl(m, d, actuator_, d->time, &between, m->actuator_history[2 * actuator_ + 1]);
    command_ = held ? *held : between;
  }
  if (m->actuator_ctrllimited[actuator_] && !(m->opt.disableflags & mjDSBL_CLAMPCTRL)) {
    command_ = std::clamp(command_, m->actuator_ctrlrange[2 * actuator_], m->actuator_ctrlrange[2 * actuator_ + 1]);
  }
  if (residual_ >= 0) {
    command_ += instance_of<Residual>(d, residual_)
                    ->at(m, d, {d->actuator_length[actuator_], v_, d->actuator_force[actuator_], command_});
  }
}

void Cylinder::advance(const mjModel* m, mjData* d) {
  const auto [p, s] = slots(m, d);
  // qvel is already updated, actuator_velocity is not, so apply the step's moments to the new qvel.
  double v = 0;
  const int address = d->moment_rowadr[actuator_], count = d->moment_rownnz[actuator_];
  for (int i = address; i < address + count; ++i) {
    v += d->actuator_moment[i] * d->qvel[d->moment_colind[i]];
  }
  PistonStep piston{x_, v_, v, d->actuator_force[actuator_], 0.0, mass_};
  if (p.play_ > 0 && mass_ > 0) {
    const double h = m->opt.timestep, offset = play_offset(p, coefficients_, s);
    const double pushed = forces_.total() - h * oil_spring_ * play_.closing - play_.transmitted;
    piston = {x_, v_, v_ + h * pushed / p.piston_mass_, forces_.total(), 0.0, moved_};
    s.pin_load_ = mass_ * (v - d->actuator_velocity[actuator_]) / h - play_.transmitted;
    s.play_offset_ = offset + h * (piston.v - v);
    s.piston_velocity_ = piston.v;
    s.seated_play_ = p.play_;
  } else {
    s.play_offset_ = s.seated_play_ = 0.0;
  }
  piston.friction = forces_.pressure - piston.force;
  advance_cylinder(p, coefficients_, step_, oil_, chambers_, piston, command_,
                   supply_pressure(m, d, p), s);
}

// Draws barrel and rod along the tendon.
void Cylinder::visualize(const mjModel* m, mjData* d, mjvScene* scene) {
  mjtNum base[3], end[3];
  if (m->actuator_trntype[actuator_] != mjTRN_TENDON ||
      !tendon_ends(m, d, m->actuator_trnid[2 * actuator_], base, end)) {
    return;
  }
  const CylinderParameters& p = slots(m, d).parameters;
  const double supply = std::max(supply_pressure(m, d, p), 1e5);
  const double level = std::clamp(observe(m, d).gauge_a() / supply, 0.0, 1.0);
  draw_cylinder(scene, base, end, p.bore_, p.rod_, p.stroke_ + 0.02, level);
}

mjPLUGIN_LIB_INIT(leglab_cylinder) { register_plugin<Cylinder>(mjPLUGIN_ACTUATOR); }

}  // namespace leglab::plugin
