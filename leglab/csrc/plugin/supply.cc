#include "plugin/supply.h"

#include "plugin/cylinder.h"

namespace leglab::plugin {

using namespace hydraulics;

Supply::Supply(const mjModel* m, int instance) : Instance(m, instance) {
  for (int i = 0; i < m->nplugin; ++i) {
    if (!is_instance<Cylinder>(m, i)) continue;
    const std::string named = text_attribute(m, i, "supply");
    if (element_named(m, i, mjOBJ_PLUGIN, m->nplugin, named) == instance) consumers_.push_back(i);
  }
}

void Supply::reset(mjtNum* plugin_state) const {
  Instance::reset(plugin_state);
  reinterpret_cast<State*>(plugin_state + kParameterCount)->pressure_ = initial_.supply_pressure_;
}

double Supply::pressure(const mjModel* m, const mjData* d, int instance) {
  const auto [p, s] = slots(m, d, instance);
  return supply_pressure_now(p, s);
}

// Takes the volume that each cylinder drew over its latest step from the supply; counts each once.
void Supply::advance(const mjModel* m, mjData* d) {
  double demand = 0;
  for (int i : consumers_) demand += Cylinder::slots(m, d, i).state.supply_flow_;
  const auto [p, s] = slots(m, d);
  advance_supply(p, demand, m->opt.timestep, s);
}

mjPLUGIN_LIB_INIT(leglab_supply) { register_plugin<Supply>(mjPLUGIN_PASSIVE); }

}  // namespace leglab::plugin
