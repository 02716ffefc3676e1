#include "plugin/supply.h"

#include <cstring>

#include "plugin/config.h"
#include "plugin/cylinder.h"
#include "plugin/lifecycle.h"

namespace leglab::plugin {

using namespace hydraulics;

const char kSupplyName[] = "leglab.supply";

Supply::Supply(const mjModel* m, int instance) : instance_(instance) {
  require_single_stage_integrator(m, instance);
  read_parameters(m, instance, kSupplyParameters, reinterpret_cast<double*>(&initial_));
  const char* own = mj_id2name(m, mjOBJ_PLUGIN, instance);
  for (int i = 0; i < m->nplugin; ++i) {
    if (std::strcmp(mjp_getPluginAtSlot(m->plugin[i])->name, kCylinderName) == 0 && own &&
        text_attribute(m, i, "supply") == own) {
      consumers_.push_back(i);
    }
  }
}

void Supply::reset(mjtNum* plugin_state) const {
  std::memcpy(plugin_state, &initial_, sizeof initial_);
  SupplyState s{};
  s.pressure_ = initial_.supply_pressure_;
  std::memcpy(plugin_state + kParameterCount, &s, sizeof s);
}

double Supply::pressure(const mjModel* m, const mjData* d, int instance) {
  const mjtNum* head = d->plugin_state + m->plugin_stateadr[instance];
  return supply_pressure_now(*reinterpret_cast<const SupplyParameters*>(head),
                             *reinterpret_cast<const SupplyState*>(head + kParameterCount));
}

// Draws what each cylinder took over its latest step; every volume is counted once.
void Supply::advance(const mjModel* m, mjData* d) {
  constexpr std::size_t flow = kCylinderParameterCount + offsetof(CylinderState, supply_flow_) / sizeof(double);
  double demand = 0;
  for (int i : consumers_) demand += d->plugin_state[m->plugin_stateadr[i] + flow];
  mjtNum* head = state_of(m, d, instance_);
  advance_supply(*reinterpret_cast<SupplyParameters*>(head), demand, m->opt.timestep,
                 *reinterpret_cast<SupplyState*>(head + kParameterCount));
}

void register_supply() {
  static const std::vector<const char*> names = attribute_names(kSupplyParameters, {});
  register_plugin<Supply>(kSupplyName, mjPLUGIN_PASSIVE, names);
}

}  // namespace leglab::plugin
