// Parameters of the actuator plugin `leglab.command_path`.
#pragma once

#include "hydraulics/parameters.h"

namespace leglab::plugin {

// X(name, unit, nominal, minimum, maximum, minimum_allowed, description), in the order in which the
// command passes them. Commands count in the unit of the actuator's ctrl.
#define LEGLAB_COMMAND_PARAMETERS(X)                                                               \
  X(delay, "s", 0.0, 0.0, 1.0, true, "dead time, at most the attribute max_delay")                 \
  X(gain, "1", 1.0, -100.0, 100.0, true, "factor on the command")                               \
  X(bias, "ctrl", 0.0, -1e6, 1e6, true, "added to the command")                                    \
  X(hysteresis, "ctrl", 0.0, 0.0, 1e6, true, "full width of a play")                               \
  X(dead_band, "ctrl", 0.0, 0.0, 1e6, true, "half width: below it nothing, above it u - dead_band")\
  X(time_constant, "s", 0.0, 0.0, 10.0, true, "first-order lag: bandwidth 1/(2 pi time_constant)") \
  X(actuator_gain, "1", 1.0, -100.0, 100.0, true, "factor on the force of the actuator")

// The commands of the last steps follow these, newest first.
#define LEGLAB_COMMAND_STATES(X)                \
  X(started, "1", "1 after the first step")     \
  X(play_output, "ctrl", "behind the hysteresis") \
  X(lag_output, "ctrl", "behind the lag")

#define LEGLAB_FIELD(name, ...) double name##_;
struct CommandParameters {
  LEGLAB_COMMAND_PARAMETERS(LEGLAB_FIELD)
};
struct CommandState {
  LEGLAB_COMMAND_STATES(LEGLAB_FIELD)
};
#undef LEGLAB_FIELD
#define LEGLAB_SPEC(name, unit, nominal, lo, hi, closed, text) \
  {#name, unit, nominal, lo, hi, closed, text},
inline constexpr hydraulics::ParameterSpec kCommandParameters[] = {
    LEGLAB_COMMAND_PARAMETERS(LEGLAB_SPEC)};
#undef LEGLAB_SPEC
#define LEGLAB_STATE_SPEC(name, unit, text) {#name, unit, text},
inline constexpr hydraulics::StateSpec kCommandStates[] = {
    LEGLAB_COMMAND_STATES(LEGLAB_STATE_SPEC)};
#undef LEGLAB_STATE_SPEC

}  // namespace leglab::plugin
