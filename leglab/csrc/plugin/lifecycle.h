// State layout and callbacks shared by all plugin classes of this library.
#pragma once

#include <algorithm>
#include <cstring>
#include <vector>

#include <mujoco/mujoco.h>

#include "plugin/config.h"
#include "plugin/tables.h"

namespace leglab::plugin {

// Base of a plugin instance with a table. The plugin state holds the parameters, then the dynamic
// states.
template <class Table_>
class Instance {
 public:
  using Table = Table_;
  using Parameters = typename Table::Parameters;
  using State = typename Table::State;
  static constexpr int kParameterCount = Table::parameter_count;
  static constexpr int kStateCount = Table::parameter_count + Table::state_count;

  // Length of the plugin state; a plugin with data after the named states overrides it.
  static int state_count(const mjModel*, int) { return kStateCount; }

  // Resets the parameters to their values in MJCF and the states to zero.
  void reset(mjtNum* plugin_state) const {
    std::copy_n(reinterpret_cast<const double*>(&initial_), kParameterCount, plugin_state);
    std::fill_n(plugin_state + kParameterCount, Table::state_count, 0.0);
  }

 protected:
  // Reads and checks the parameters of MJCF; rejects invalid ones.
  Instance(const mjModel* m, int instance) : instance_(instance) {
    if (Table::state_count > 0) require_single_stage_integrator(m, instance);
    read_parameters(m, instance, Table::parameters, reinterpret_cast<double*>(&initial_));
  }

  struct Slots {
    Parameters& parameters;
    State& state;
  };
  static Slots slots(const mjModel* m, const mjData* d, int instance) {
    mjtNum* head = state_of(m, d, instance);
    return {*reinterpret_cast<Parameters*>(head), *reinterpret_cast<State*>(head + kParameterCount)};
  }
  Slots slots(const mjModel* m, const mjData* d) const { return slots(m, d, instance_); }

  int instance_;
  Parameters initial_;
};

template <class T>
T* instance_of(const mjData* d, int instance) {
  return reinterpret_cast<T*>(d->plugin_data[instance]);
}

// Tests whether a plugin instance of the model is of class T.
template <class T>
bool is_instance(const mjModel* m, int instance) {
  return std::strcmp(mjp_getPluginAtSlot(m->plugin[instance])->name, T::Table::plugin) == 0;
}

// Registers an `Instance` T when the library is loaded: constructor (m, instance), compute, and, if T
// has them, advance, visualize and a sensor's number of values.
template <class T>
void register_plugin(int capability) {
  static std::vector<const char*> names(T::Table::texts);
  for (const ParameterSpec& spec : T::Table::parameters) names.push_back(spec.name);
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = T::Table::plugin;
  plugin.nattribute = static_cast<int>(names.size());
  plugin.attributes = names.data();
  plugin.capabilityflags = capability;
  plugin.nstate = T::state_count;
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(new T(m, instance));
    return 0;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete instance_of<T>(d, instance);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum* state, void* data, int) {
    static_cast<T*>(data)->reset(state);
  };
  // A copy of the data includes the outputs of the latest `compute`, so that stepping can continue
  // from it even between the stages of a step.
  plugin.copy = +[](mjData* to, const mjModel*, const mjData* from, int instance) {
    *instance_of<T>(to, instance) = *instance_of<T>(from, instance);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability) {
    T* plugin = instance_of<T>(d, instance);
    if constexpr (requires { plugin->compute(m, d, capability); }) {
      plugin->compute(m, d, capability);  // for a plugin with several capabilities
    } else {
      plugin->compute(m, d);
    }
  };
  if constexpr (requires(T t, const mjModel* m, mjData* d) { t.advance(m, d); }) {
    plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
      instance_of<T>(d, instance)->advance(m, d);
    };
  }
  if constexpr (requires(T t, const mjModel* m, mjData* d, mjvScene* s) { t.visualize(m, d, s); }) {
    plugin.visualize = +[](const mjModel* m, mjData* d, const mjvOption*, mjvScene* scene,
                           int instance) { instance_of<T>(d, instance)->visualize(m, d, scene); };
  }
  if constexpr (requires { &T::value_count; }) {
    // Lengths are known at this stage; a later stage would make MuJoCo compute body accelerations.
    plugin.needstage = mjSTAGE_VEL;
    plugin.nsensordata = T::value_count;
  }
  mjp_registerPlugin(&plugin);
}

}  // namespace leglab::plugin
