// Actuator plugin `leglab.command_path`: delay, dead band, lag etc. of a native actuator's command.
#pragma once

#include "plugin/lifecycle.h"
#include "plugin/native_actuator.h"

namespace leglab::plugin {

class CommandPath : public Instance<CommandTable> {
 public:
  CommandPath(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel* m, mjData* d, int capability);
  void advance(const mjModel* m, mjData* d);
  // Applies the force in advance, for a plugin that needs it before this instance's next `compute`.
  void apply_ahead(const mjModel* m, mjData* d);

  // Length of the plugin state: parameters, states and the commands of `max_delay`.
  static int state_count(const mjModel* m, int instance);

 private:
  struct Signal {
    double play, lag_input, output;
  };
  // Passes a command through the elements of the path; does not change the state.
  Signal pass(const mjModel* m, const mjData* d, double command) const;
  // Commands of the last steps, newest first, stored after the named states.
  mjtNum* past(const mjModel* m, const mjData* d) const {
    return state_of(m, d, instance_) + kStateCount;
  }
  void apply(const mjModel* m, mjData* d) const;

  int history_;  // number of past commands kept
  bool applied_ = false;
  NativeActuator actuator_;
};

}  // namespace leglab::plugin
