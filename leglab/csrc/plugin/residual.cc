#include "plugin/residual.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "plugin/cylinder.h"
#include "plugin/native_actuator.h"

namespace leglab::plugin {
namespace {

constexpr int kDegree = 3;

std::vector<double> numbers_attribute(const mjModel* m, int instance, const std::string& key) {
  const std::string text = text_attribute(m, instance, key.c_str());
  std::vector<double> out;
  const char* end = text.data() + text.size();
  for (const char* at = text.data(); at != end;) {
    if (*at == ' ' || *at == '\t' || *at == '\n' || *at == '\r') {
      ++at;
      continue;
    }
    double value;
    const auto result = std::from_chars(at, end, value);
    if (result.ec != std::errc() || !std::isfinite(value)) {
      refuse(m, instance, "attribute '" + key + "' = '" + text + "'; allowed: finite numbers with spaces between");
    }
    out.push_back(value);
    at = result.ptr;
  }
  return out;
}

// Evaluates a spline by de Boor's recursion (1978) on clamped knots; x lies within them.
double de_boor(const std::vector<double>& knots, const mjtNum* coefficients, double x) {
  const auto inner = std::upper_bound(knots.begin() + kDegree, knots.end() - kDegree - 1, x);
  const std::ptrdiff_t span =
      std::min<std::ptrdiff_t>(inner - knots.begin(), std::ssize(knots) - kDegree - 1) - 1;
  double d[kDegree + 1];
  for (int j = 0; j <= kDegree; ++j) d[j] = coefficients[span - kDegree + j];
  for (int r = 1; r <= kDegree; ++r) {
    for (int j = kDegree; j >= r; --j) {
      const double left = knots[span - kDegree + j], right = knots[span + 1 + j - r];
      const double share = (x - left) / (right - left);
      d[j] = (1.0 - share) * d[j - 1] + share * d[j];
    }
  }
  return d[kDegree];
}

}  // namespace

Residual::Spline Residual::spline_attribute(const mjModel* m, int instance, const char* variable) {
  const std::string name = variable;
  Spline spline;
  const std::vector<double> inner = numbers_attribute(m, instance, name + "_knots");
  spline.coefficients = numbers_attribute(m, instance, name + "_coefficients");
  if (inner.empty() && spline.coefficients.empty()) return spline;
  if (inner.size() < 2) refuse(m, instance, "attribute '" + name + "_knots' has fewer than 2 numbers");
  for (std::size_t i = 1; i < inner.size(); ++i) {
    if (!(inner[i] > inner[i - 1])) {
      refuse(m, instance, "attribute '" + name + "_knots' must increase: " + number(inner[i - 1]) +
                              " comes before " + number(inner[i]));
    }
  }
  if (spline.coefficients.size() != inner.size() + kDegree - 1) {
    refuse(m, instance, "attribute '" + name + "_coefficients' has " +
                            std::to_string(spline.coefficients.size()) + " numbers; allowed: " +
                            std::to_string(inner.size() + kDegree - 1) + ", two more than knots");
  }
  spline.knots.assign(kDegree, inner.front());
  spline.knots.insert(spline.knots.end(), inner.begin(), inner.end());
  spline.knots.insert(spline.knots.end(), kDegree, inner.back());
  return spline;
}

int Residual::state_count(const mjModel* m, int instance) {
  int count = kStateCount;
  for (const char* name : kNames) {
    count += static_cast<int>(spline_attribute(m, instance, name).coefficients.size());
  }
  return count;
}

int Residual::of_cylinder(const mjModel* m, int actuator) {
  int found = -1;
  for (int i = 0; i < m->nplugin; ++i) {
    if (!is_instance<Residual>(m, i)) continue;
    const std::string named = text_attribute(m, i, "cylinder");
    if (element_named(m, i, mjOBJ_ACTUATOR, m->nu, named) != actuator) continue;
    if (found >= 0) refuse(m, i, "attribute 'cylinder' = '" + named + "' has another already");
    found = i;
  }
  return found;
}

Residual::Residual(const mjModel* m, int instance) : Instance(m, instance) {
  for (std::size_t i = 0; i < kInputs; ++i) splines_[i] = spline_attribute(m, instance, kNames[i]);
  const std::string cylinder = text_attribute(m, instance, "cylinder");
  const std::string actuator = text_attribute(m, instance, "actuator");
  if (!cylinder.empty()) {
    const int id = element_named(m, instance, mjOBJ_ACTUATOR, m->nu, cylinder);
    const int plugin = id < 0 ? -1 : m->actuator_plugin[id];
    if (plugin < 0 || !is_instance<Cylinder>(m, plugin)) {
      refuse(m, instance, "attribute 'cylinder' = '" + cylinder + "'; allowed: an actuator that is a " +
                              Cylinder::Table::plugin);
    }
    if (!text_attribute(m, instance, "joint").empty() || !actuator.empty()) {
      refuse(m, instance, "attribute 'cylinder' goes without 'joint' and 'actuator'");
    }
    return;
  }
  const int joint = joint_attribute(m, instance);
  qpos_ = m->jnt_qposadr[joint];
  dof_ = m->jnt_dofadr[joint];
  if (!actuator.empty()) {
    actuator_ = element_attribute(m, instance, "actuator", mjOBJ_ACTUATOR, m->nu);
  } else if (!splines_[3].knots.empty()) {
    refuse(m, instance, "attribute 'actuator' is missing: whose command is meant by 'command_knots'?");
  }
}

void Residual::reset(mjtNum* plugin_state) const {
  Instance::reset(plugin_state);
  mjtNum* at = plugin_state + kStateCount;
  for (const Spline& spline : splines_) at = std::copy(spline.coefficients.begin(), spline.coefficients.end(), at);
}

double Residual::at(const mjModel* m, const mjData* d, const Inputs& inputs) const {
  const mjtNum* coefficients = state_of(m, d, instance_) + kStateCount;
  double sum = 0;
  for (std::size_t i = 0; i < kInputs; ++i) {
    const std::vector<double>& knots = splines_[i].knots;
    if (knots.empty()) continue;
    const double x = std::clamp(inputs[i], knots.front(), knots.back());
    if (x == x) sum += de_boor(knots, coefficients, x);  // a NaN input gives no force
    coefficients += splines_[i].coefficients.size();
  }
  const Parameters& p = slots(m, d).parameters;
  return std::clamp(p.scale_ * sum, -p.bound_, p.bound_);
}

void Residual::compute(const mjModel* m, mjData* d) {
  if (dof_ < 0) return;  // the cylinder calls `at`
  double command = 0;
  if (actuator_ >= 0) {
    const int ctrl = m->actuator_ctrladr[actuator_];
    command = d->ctrl[ctrl];
    if (m->actuator_ctrllimited[ctrl] && !(m->opt.disableflags & mjDSBL_CLAMPCTRL)) {
      command = std::clamp(command, m->actuator_ctrlrange[2 * ctrl], m->actuator_ctrlrange[2 * ctrl + 1]);
    }
  }
  // MuJoCo computes passive forces before actuator forces, so the load is of the previous step.
  d->qfrc_passive[dof_] += at(m, d, {d->qpos[qpos_], d->qvel[dof_], slots(m, d).state.load_, command});
}

void Residual::advance(const mjModel* m, mjData* d) {
  if (dof_ >= 0) slots(m, d).state.load_ = d->qfrc_actuator[dof_];
}

mjPLUGIN_LIB_INIT(leglab_residual) { register_plugin<Residual>(mjPLUGIN_PASSIVE); }

}  // namespace leglab::plugin
