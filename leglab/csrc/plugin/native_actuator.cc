#include "plugin/native_actuator.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "plugin/config.h"

namespace leglab::plugin {

double NativeActuator::command(const mjModel* m, const mjData* d) const {
  double u = d->ctrl[ctrl];
  if (!(std::abs(u) <= mjMAXVAL)) return 0.0;
  if (m->actuator_ctrllimited[ctrl] && !(m->opt.disableflags & mjDSBL_CLAMPCTRL)) {
    u = std::clamp(u, m->actuator_ctrlrange[2 * ctrl], m->actuator_ctrlrange[2 * ctrl + 1]);
  }
  return u;
}

double NativeActuator::gain(const mjModel* m, const mjData* d) const {
  const mjtNum* p = m->actuator_gainprm + mjNGAIN * id;
  if (m->actuator_gaintype[id] == mjGAIN_FIXED) return p[0];
  return p[0] + p[1] * d->actuator_length[output] + p[2] * d->actuator_velocity[output];
}

bool NativeActuator::position_servo(const mjModel* m) const {
  const double gain = m->actuator_gainprm[mjNGAIN * id];
  const mjtNum* bias = m->actuator_biasprm + mjNBIAS * id;
  return m->actuator_gaintype[id] == mjGAIN_FIXED && m->actuator_biastype[id] == mjBIAS_AFFINE &&
         gain != 0.0 && bias[0] == 0.0 && bias[1] == -gain;
}

void require_native(const mjModel* m, int instance, int actuator) {
  const int gain = m->actuator_gaintype[actuator], bias = m->actuator_biastype[actuator];
  const int dynamics = m->actuator_dyntype[actuator];
  const char* wrong = nullptr;
  if (m->actuator_plugin[actuator] >= 0) {
    wrong = "is a plugin itself";
  } else if ((gain != mjGAIN_FIXED && gain != mjGAIN_AFFINE) ||
             (bias != mjBIAS_NONE && bias != mjBIAS_AFFINE)) {
    wrong = "has a gain or bias that is neither fixed nor affine";
  } else if (dynamics != mjDYN_NONE && dynamics != mjDYN_INTEGRATOR && dynamics != mjDYN_FILTER &&
             dynamics != mjDYN_FILTEREXACT) {
    wrong = "has dynamics other than none, integrator, filter or filterexact";
  } else if (m->actuator_ctrlnum[actuator] != 1 || m->actuator_outnum[actuator] != 1) {
    wrong = "has several inputs or outputs";
  } else if (m->actuator_actearly[actuator]) {
    wrong = "has actearly";
  } else if (m->actuator_historyadr[actuator] >= 0) {
    wrong = "has a delay of its own";
  }
  if (wrong) {
    const char* name = mj_id2name(m, mjOBJ_ACTUATOR, actuator);
    refuse(m, instance, std::string("actuator '") + (name ? name : "") + "' " + wrong +
                            "; allowed: motor, position, velocity, intvelocity, damper or general "
                            "actuators with one input");
  }
}

NativeActuator actuator_attribute(const mjModel* m, int instance) {
  const int id = element_attribute(m, instance, "actuator", mjOBJ_ACTUATOR, m->nactuator);
  require_native(m, instance, id);
  return NativeActuator::at(m, id);
}

}  // namespace leglab::plugin
