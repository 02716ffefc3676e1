// Parameters of the passive plugin `leglab.joint_friction`.
#pragma once

#include "hydraulics/parameters.h"

namespace leglab::plugin {

// X(name, unit, nominal, minimum, maximum, minimum_allowed, description); N is N m at a hinge.
#define LEGLAB_FRICTION_PARAMETERS(X)                                                              \
  X(sigma_0, "N/rad", 1e3, 0.0, 1e9, true, "bristle stiffness")                                    \
  X(sigma_1, "N s/rad", 1.0, 0.0, 1e6, true, "bristle damping")                                    \
  X(viscous, "N s/rad", 0.0, -1e6, 1e6, true, "viscous friction; negative weakens native damping")     \
  X(coulomb, "N", 0.0, 0.0, 1e6, true, "Coulomb friction")                                         \
  X(static, "N", 0.0, 0.0, 1e6, true, "breakaway friction, at least coulomb")                      \
  X(stribeck_velocity, "rad/s", 0.1, 0.0, 1e3, false, "Stribeck velocity")                         \
  X(direction_asymmetry, "1", 0.0, -1.0, 1.0, true, "friction x (1 + a) for v > 0, (1 - a) for v < 0") \
  X(viscous_difference, "N s/rad", 0.0, -1e6, 1e6, true, "viscous friction for v > 0 less that for v < 0")\
  X(coulomb_difference, "N", 0.0, -1e6, 1e6, true, "Coulomb and breakaway friction for v > 0 less v < 0")\
  X(actuator_load_coefficient, "1", 0.0, -10.0, 10.0, true, "friction per actuator force, see load")  \
  X(bias_load_coefficient, "1", 0.0, -10.0, 10.0, true, "friction per gravity and Coriolis force")  \
  X(wear_rate, "1/rad", 0.0, 0.0, 1e3, true, "relative growth per path travelled (Archard 1953)")  \
  X(drift_amplitude, "1", 0.0, 0.0, 1.0, true, "relative slow sinusoidal change")                  \
  X(drift_period, "s", 60.0, 0.0, 1e6, false, "period of the slow change")                         \
  X(wear, "1", 1.0, 0.0, 1e3, true, "relative friction level; the machine itself changes it")

#define LEGLAB_FRICTION_STATES(X)  \
  X(bristle, "rad", "LuGre bristle deflection z") \
  X(sliding_distance, "rad", "path since the reset") \
  X(load, "N", "|actuator_load_coefficient qfrc_actuator + bias_load_coefficient qfrc_bias| of the last step")

#define LEGLAB_FIELD(name, ...) double name##_;
struct FrictionParameters {
  LEGLAB_FRICTION_PARAMETERS(LEGLAB_FIELD)
};
struct FrictionState {
  LEGLAB_FRICTION_STATES(LEGLAB_FIELD)
};
#undef LEGLAB_FIELD
#define LEGLAB_SPEC(name, unit, nominal, lo, hi, closed, text) \
  {#name, unit, nominal, lo, hi, closed, text},
inline constexpr hydraulics::ParameterSpec kFrictionParameters[] = {
    LEGLAB_FRICTION_PARAMETERS(LEGLAB_SPEC)};
#undef LEGLAB_SPEC
#define LEGLAB_STATE_SPEC(name, unit, text) {#name, unit, text},
inline constexpr hydraulics::StateSpec kFrictionStates[] = {
    LEGLAB_FRICTION_STATES(LEGLAB_STATE_SPEC)};
#undef LEGLAB_STATE_SPEC

}  // namespace leglab::plugin
