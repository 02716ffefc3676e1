// The callbacks that every plugin class of this library shares.
#pragma once

#include <span>
#include <vector>

#include <mujoco/mujoco.h>

#include "plugin/config.h"

namespace leglab::plugin {

template <class T>
T* instance_of(const mjData* d, int instance) {
  return reinterpret_cast<T*>(d->plugin_data[instance]);
}

// Registers class T: constructor (m, instance), kStateCount, reset, compute, and, where they
// exist, advance and visualize. `names` must outlive the program.
template <class T>
void register_plugin(const char* name, int capability, const std::vector<const char*>& names,
                     void (*customise)(mjpPlugin&) = nullptr) {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = name;
  plugin.nattribute = static_cast<int>(names.size());
  plugin.attributes = names.data();
  plugin.capabilityflags = capability;
  plugin.nstate = +[](const mjModel*, int) { return T::kStateCount; };
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
  if (customise) customise(plugin);
  mjp_registerPlugin(&plugin);
}

}  // namespace leglab::plugin
