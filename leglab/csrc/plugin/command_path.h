// Actuator plugin `leglab.command_path`: what a command meets on its way to a native actuator.
#pragma once

#include <mujoco/mujoco.h>

#include "plugin/command_path_parameters.h"
#include "plugin/native_actuator.h"

namespace leglab::plugin {

class CommandPath {
 public:
  CommandPath(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel* m, mjData* d);
  void advance(const mjModel* m, mjData* d);
  // Does the work of the next `compute` now, for a plugin that needs its force.
  void apply_ahead(const mjModel* m, mjData* d);

  // Length of the plugin state: parameters, states and the commands of `max_delay`.
  static int state_count(const mjModel* m, int instance);

  static constexpr int kParameterCount = sizeof(CommandParameters) / sizeof(double);
  static constexpr int kNamedCount = kParameterCount + sizeof(CommandState) / sizeof(double);
  static constexpr int kStateCount = kNamedCount;

 private:
  struct Signal {
    double play, lag_input, output;
  };
  // The command on its way through the elements; reads the state only.
  Signal pass(const mjModel* m, const mjtNum* head, double command) const;
  void apply(const mjModel* m, mjData* d) const;

  int instance_;
  int history_;  // number of past commands kept
  bool applied_ = false;
  NativeActuator actuator_;
  CommandParameters initial_;
};

void register_command_path();
extern const char kCommandPathName[];

}  // namespace leglab::plugin
