#include "plugin/cylinder.h"

#include <cstdio>
#include <cstring>

#include "hydraulics/checks.h"
#include "plugin/config.h"
#include "plugin/lifecycle.h"
#include "plugin/supply.h"

namespace leglab::plugin {

using namespace hydraulics;

const char kCylinderName[] = "leglab.cylinder";

Cylinder::Cylinder(const mjModel* m, int instance) : instance_(instance) {
  require_single_stage_integrator(m, instance);
  for (int i = 0; i < m->nu; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    if (actuator_ >= 0) refuse(m, instance, "drives two actuators; allowed: one actuator an instance");
    actuator_ = i;
  }
  if (actuator_ < 0) refuse(m, instance, "drives no actuator; allowed: one actuator an instance");

  read_parameters(m, instance, kCylinderParameters, reinterpret_cast<double*>(&initial_));
  const std::string wrong = contradiction(initial_);
  if (!wrong.empty()) refuse(m, instance, wrong);
  supply_name_ = text_attribute(m, instance, "supply");
  if (!supply_name_.empty()) {
    supply_ = mj_name2id(m, mjOBJ_PLUGIN, supply_name_.c_str());
    if (supply_ < 0 || std::strcmp(mjp_getPluginAtSlot(m->plugin[supply_])->name, kSupplyName) != 0) {
      refuse(m, instance, "attribute 'supply' = '" + supply_name_ + "'; allowed: the name of a " +
                              kSupplyName + " instance");
    }
  }
  refresh(m, initial_);
}

// Symplectic coupling of the oil spring and the mechanism is accurate while w_h h <= 0.7 and
// unstable beyond 2; more than 1 is refused. At qpos0, with the effective mass of the model.
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
  std::memcpy(plugin_state, &initial_, sizeof initial_);
  CylinderState s{};
  s.pressure_a_ = initial_.initial_pressure_a_;
  s.pressure_b_ = initial_.initial_pressure_b_;
  std::memcpy(plugin_state + kCylinderParameterCount, &s, sizeof s);
}

Cylinder::Slots Cylinder::slots(const mjModel* m, mjData* d) const {
  mjtNum* head = state_of(m, d, instance_);
  return {*reinterpret_cast<CylinderParameters*>(head),
          *reinterpret_cast<CylinderState*>(head + kCylinderParameterCount)};
}

void Cylinder::refresh(const mjModel* m, const CylinderParameters& p) {
  const double timestep = m->opt.timestep;
  if (std::memcmp(&p, &seen_, sizeof p) == 0 && timestep == seen_timestep_) return;
  CylinderParameters same = p;  // but for the two that the machine itself changes
  same.oil_temperature_ = seen_.oil_temperature_;
  same.seal_clearance_ = seen_.seal_clearance_;
  if (std::memcmp(&same, &seen_, sizeof p) != 0 || timestep != seen_timestep_) {
    coefficients_ = CylinderCoefficients::from(p);
    step_ = StepCoefficients::from(p, timestep);
  }
  if (timestep != seen_timestep_) check_timestep(m);
  oil_ = OilCondition::from(p, coefficients_);
  seen_ = p;
  seen_timestep_ = timestep;
}

double Cylinder::supply_pressure(const mjModel* m, mjData* d, const CylinderParameters& p) const {
  return supply_ < 0 ? p.supply_pressure_ : Supply::pressure(m, d, supply_);
}

// 1/(J M^-1 J'), with J the row of the actuator moment.
double Cylinder::effective_mass(const mjModel* m, mjData* d) const {
  mj_markStack(d);
  mjtNum* row = mj_stackAllocNum(d, m->nv);
  mjtNum* solved = mj_stackAllocNum(d, m->nv);
  mju_zero(row, m->nv);
  const int address = d->moment_rowadr[actuator_], count = d->moment_rownnz[actuator_];
  for (int i = address; i < address + count; ++i) row[d->moment_colind[i]] = d->actuator_moment[i];
  mj_solveM(m, d, solved, row, 1);
  const double inverse = mju_dot(row, solved, m->nv);
  mj_freeStack(d);
  return inverse > 0 ? 1.0 / inverse : 0.0;
}

void Cylinder::compute(const mjModel* m, mjData* d) {
  const auto [p, s] = slots(m, d);
  if (m->opt.integrator == mjINT_RK4) require_single_stage_integrator(m, instance_);
  refresh(m, p);
  x_ = coefficients_.half_stroke + d->actuator_length[actuator_] - p.mid_length_;
  v_ = d->actuator_velocity[actuator_];
  mass_ = effective_mass(m, d);
  chambers_ = chambers_at(p, coefficients_, s, x_);
  forces_ = piston_forces(p, coefficients_, oil_, s, chambers_, x_, v_,
                          mass_ > 0 ? m->opt.timestep / mass_ : 0.0);
  d->actuator_force[actuator_] = forces_.total();
}

void Cylinder::advance(const mjModel* m, mjData* d) {
  const auto [p, s] = slots(m, d);
  // qvel has moved, actuator_velocity has not: project the new qvel on the moment of the step.
  double v = 0;
  const int address = d->moment_rowadr[actuator_], count = d->moment_rownnz[actuator_];
  for (int i = address; i < address + count; ++i) {
    v += d->actuator_moment[i] * d->qvel[d->moment_colind[i]];
  }
  const double applied = d->actuator_force[actuator_];
  const PistonStep piston{x_, v_, v, applied, forces_.pressure - applied, mass_};
  advance_cylinder(p, coefficients_, step_, oil_, chambers_, piston, d->ctrl[actuator_],
                   supply_pressure(m, d, p), s);
}

// Barrel and rod along the tendon; the barrel takes its colour from the cap-side pressure.
void Cylinder::visualize(const mjModel* m, mjData* d, mjvScene* scene) const {
  if (m->actuator_trntype[actuator_] != mjTRN_TENDON || scene->ngeom + 3 > scene->maxgeom) return;
  const int tendon = m->actuator_trnid[2 * actuator_];
  const int first = d->ten_wrapadr[tendon], last = first + d->ten_wrapnum[tendon] - 1;
  if (last <= first) return;
  const mjtNum* base = d->wrap_xpos + 3 * first;
  const mjtNum* end = d->wrap_xpos + 3 * last;
  mjtNum axis[3];
  mju_sub3(axis, end, base);
  mju_normalize3(axis);
  const auto point = [&](double at, mjtNum* out) { mju_addScl3(out, base, axis, at); };

  const auto& p = *reinterpret_cast<const CylinderParameters*>(state_of(m, d, instance_));
  const double retracted = p.mid_length_ - 0.5 * p.stroke_;
  const double barrel = std::max(retracted - 0.5 * p.bore_, 0.5 * retracted);
  const double level =
      std::clamp(chambers_.gauge_a() / std::max(supply_pressure(m, d, p), 1e5), 0.0, 1.0);
  const float steel[4] = {0.86f, 0.87f, 0.90f, 1.0f};
  const float paint[4] = {0.16f + 0.70f * static_cast<float>(level), 0.30f,
                          0.72f - 0.56f * static_cast<float>(level), 1.0f};
  const float dark[4] = {0.12f, 0.12f, 0.14f, 1.0f};
  const auto draw = [&](double from, double to, double radius, const float* rgba, float shine) {
    mjtNum a[3], b[3];
    point(from, a);
    point(to, b);
    mjvGeom* geom = scene->geoms + scene->ngeom++;
    mjv_initGeom(geom, mjGEOM_CYLINDER, nullptr, nullptr, nullptr, rgba);
    mjv_connector(geom, mjGEOM_CYLINDER, radius, a, b);
    geom->objtype = mjOBJ_UNKNOWN;
    geom->objid = -1;
    geom->category = mjCAT_DECOR;
    geom->specular = shine;
    geom->shininess = shine;
  };
  draw(0, barrel, 0.68 * p.bore_, paint, 0.6f);
  draw(barrel - 0.5 * p.bore_, barrel + 0.15 * p.bore_, 0.78 * p.bore_, dark, 0.3f);
  draw(barrel, d->ten_length[tendon], 0.5 * p.rod_, steel, 1.0f);
}

void register_cylinder() {
  static const std::vector<const char*> names = attribute_names(kCylinderParameters, {"supply"});
  register_plugin<Cylinder>(kCylinderName, mjPLUGIN_ACTUATOR, names);
}

}  // namespace leglab::plugin
