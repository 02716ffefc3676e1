// The state and the callbacks that every plugin class of this library shares.
#pragma once

#include <algorithm>
#include <cstring>
#include <vector>

#include <mujoco/mujoco.h>

#include "plugin/config.h"
#include "plugin/tables.h"

namespace leglab::plugin {

// A plugin instance by its table. Its plugin state begins with the parameters, the dynamic states
// behind them.
template <class Table_>
class Instance {
 public:
  using Table = Table_;
  using Parameters = typename Table::Parameters;
  using State = typename Table::State;
  static constexpr int kParameterCount = Table::parameter_count;
  static constexpr int kStateCount = Table::parameter_count + Table::state_count;

  // Length of the plugin state; a plugin with more behind the named states has its own.
  static int state_count(const mjModel*, int) { return kStateCount; }

  // Writes the parameters of MJCF; states are zero.
  void reset(mjtNum* plugin_state) const {
    std::copy_n(reinterpret_cast<const double*>(&initial_), kParameterCount, plugin_state);
    std::fill_n(plugin_state + kParameterCount, Table::state_count, 0.0);
  }

 protected:
  // Reads and checks the parameters of MJCF; refuses what is wrong.
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

// Whether a plugin instance of the model is one of T.
template <class T>
bool is_instance(const mjModel* m, int instance) {
  return std::strcmp(mjp_getPluginAtSlot(m->plugin[instance])->name, T::Table::plugin) == 0;
}

// Registers an `Instance` T when the library is loaded: constructor (m, instance), compute, and,
// where they exist, advance, visualize and, of a sensor, its number of values.
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
  // A copy of the data also holds the outputs of the latest `compute`, so that it may go on from
  // between the stages of a step.
  plugin.copy = +[](mjData* to, const mjModel*, const mjData* from, int instance) {
    *instance_of<T>(to, instance) = *instance_of<T>(from, instance);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability) {
    T* plugin = instance_of<T>(d, instance);
    if constexpr (requires { plugin->compute(m, d, capability); }) {
      plugin->compute(m, d, capability);  // of the several that it has
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
    // Lengths are known by then; a later stage would make MuJoCo compute accelerations of bodies.
    plugin.needstage = mjSTAGE_VEL;
    plugin.nsensordata = T::value_count;
  }
  mjp_registerPlugin(&plugin);
}

}  // namespace leglab::plugin
