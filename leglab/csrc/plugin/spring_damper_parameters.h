// Parameters of the passive plugin `leglab.spring_damper`.
#pragma once

#include "hydraulics/parameters.h"

namespace leglab::plugin {

// X(name, unit, nominal, minimum, maximum, minimum_allowed, description); N is N m at a hinge.
#define LEGLAB_SPRING_PARAMETERS(X)                                                                \
  X(k1, "N/rad", 0.0, -1e6, 1e6, true, "linear stiffness (Eq. 23); negative weakens a native spring") \
  X(k2, "N/rad^3", 0.0, -1e6, 1e6, true, "hardening y^3 sin^2 y (Eq. 23)")                         \
  X(k3, "N/rad^3", 0.0, -1e9, 1e9, true, "hardening y^3 (Duffing 1918)")                           \
  X(d1, "N s/rad", 0.0, -1e5, 1e5, true, "linear damping (Eq. 23); negative weakens native damping") \
  X(quadratic_damping, "N s^2/rad^2", 0.0, 0.0, 1e5, true, "damping with the speed squared")       \
  X(rest_position, "rad", 0.0, -100.0, 100.0, true, "joint position without spring force")         \
  X(force_offset, "N", 0.0, -1e6, 1e6, true, "constant force")                                     \
  X(stop_lower, "rad", -1e3, -1e3, 1e3, true, "below it the soft stop acts")                       \
  X(stop_upper, "rad", 1e3, -1e3, 1e3, true, "above it the soft stop acts")                        \
  X(stop_stiffness, "N/rad", 0.0, 0.0, 1e9, true, "of the soft stops")                             \
  X(stop_damping, "N s/rad", 0.0, 0.0, 1e6, true, "of the soft stops")

#define LEGLAB_FIELD(name, ...) double name##_;
struct SpringParameters {
  LEGLAB_SPRING_PARAMETERS(LEGLAB_FIELD)
};
#undef LEGLAB_FIELD
#define LEGLAB_SPEC(name, unit, nominal, lo, hi, closed, text) \
  {#name, unit, nominal, lo, hi, closed, text},
inline constexpr hydraulics::ParameterSpec kSpringParameters[] = {
    LEGLAB_SPRING_PARAMETERS(LEGLAB_SPEC)};
#undef LEGLAB_SPEC

}  // namespace leglab::plugin
