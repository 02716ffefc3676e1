// Parameters of the plugin `leglab.backlash`.
#pragma once

#include "hydraulics/parameters.h"

namespace leglab::plugin {

// X(name, unit, nominal, minimum, maximum, minimum_allowed, description); N is N m at a hinge.
#define LEGLAB_BACKLASH_PARAMETERS(X)                                                              \
  X(width, "rad", 0.0, 0.0, 10.0, true, "total play; 0 = rigid, no effect")                        \
  X(motor_inertia, "kg m^2", 0.0, 0.0, 1e6, true, "motor side, reflected; 0 = the joint's armature")\
  X(stiffness, "N/rad", 1e5, 0.0, 1e12, false, "of a flank in contact")                            \
  X(damping_ratio, "1", 0.5, 0.0, 100.0, true, "of a flank in contact, with the reduced mass")

#define LEGLAB_BACKLASH_STATES(X)                                        \
  X(offset, "rad", "motor side less joint")                              \
  X(motor_velocity, "rad/s", "of the motor side")                        \
  X(transmitted, "N", "from motor to joint over the last step")          \
  X(constraint, "N", "of friction loss, limits and contacts on the joint over the last step") \
  X(seated_width, "rad", "play of the last step; a new one seats anew on the loaded flank")

#define LEGLAB_FIELD(name, ...) double name##_;
struct BacklashParameters {
  LEGLAB_BACKLASH_PARAMETERS(LEGLAB_FIELD)
};
struct BacklashState {
  LEGLAB_BACKLASH_STATES(LEGLAB_FIELD)
};
#undef LEGLAB_FIELD
#define LEGLAB_SPEC(name, unit, nominal, lo, hi, closed, text) \
  {#name, unit, nominal, lo, hi, closed, text},
inline constexpr hydraulics::ParameterSpec kBacklashParameters[] = {
    LEGLAB_BACKLASH_PARAMETERS(LEGLAB_SPEC)};
#undef LEGLAB_SPEC
#define LEGLAB_STATE_SPEC(name, unit, text) {#name, unit, text},
inline constexpr hydraulics::StateSpec kBacklashStates[] = {
    LEGLAB_BACKLASH_STATES(LEGLAB_STATE_SPEC)};
#undef LEGLAB_STATE_SPEC

}  // namespace leglab::plugin
