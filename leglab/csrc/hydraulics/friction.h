// LuGre friction (Canudas de Wit et al. 1995), z' = v - sigma_0 |v| z / g(v), and joint friction.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include "parameters.h"

namespace leglab::hydraulics {

// Steady bristle force g(v) = F_c + (F_s - F_c) exp(-|v/v_s|^n), always positive; n = 2 is a Gaussian,
// n = 1 an exponential decay (Armstrong-Helouvry et al. 1994, sect. 2.1.3).
inline double stribeck(double v, double coulomb, double static_friction, double stribeck_velocity,
                       double exponent) {
  const double r = v / stribeck_velocity;
  const double power = exponent == 2.0 ? r * r : std::pow(std::abs(r), exponent);
  const double g = coulomb + (static_friction - coulomb) * std::exp(-power);
  return g > 1e-9 ? g : 1e-9;
}

// Bristle deflection after dt at constant velocity. The exact solution tends to sgn(v) g / sigma_0;
// without friction it is 0.
inline double advance_bristle(double z, double v, double g, double sigma_0, double dt) {
  if (g <= 0.0 || sigma_0 == 0.0) return 0.0;
  if (v == 0.0) return z;
  const double steady = std::copysign(g / sigma_0, v);
  return steady + (z - steady) * std::exp(-sigma_0 * std::abs(v) / g * dt);
}

// X(name, unit, nominal, minimum, maximum, minimum_allowed, description); units at a hinge
#define LEGLAB_FRICTION_PARAMETERS(X)                                                              \
  X(sigma_0, "N m/rad", 1e3, 0.0, 1e9, true, "bristle stiffness")                                  \
  X(sigma_1, "N m s/rad", 1.0, 0.0, 1e6, true, "bristle damping")                                  \
  X(viscous, "N m s/rad", 0.0, -1e6, 1e6, true, "viscous friction; negative weakens native damping") \
  X(coulomb, "N m", 0.0, 0.0, 1e6, true, "Coulomb friction")                                       \
  X(static, "N m", 0.0, 0.0, 1e6, true, "breakaway friction, at least coulomb")                    \
  X(stribeck_velocity, "rad/s", 0.1, 0.0, 1e3, false, "Stribeck velocity")                         \
  X(stribeck_exponent, "1", 2.0, 0.1, 20.0, true, "n of exp(-|v/v_s|^n): how steeply friction falls") \
  X(direction_asymmetry, "1", 0.0, -1.0, 1.0, true, "friction x (1 + a) for v > 0, (1 - a) for v < 0") \
  X(viscous_difference, "N m s/rad", 0.0, -1e6, 1e6, true, "viscous friction for v > 0 less that for v < 0") \
  X(coulomb_difference, "N m", 0.0, -1e6, 1e6, true, "Coulomb and breakaway friction for v > 0 less v < 0") \
  X(actuator_load_coefficient, "1", 0.0, -10.0, 10.0, true, "friction per actuator force, see load") \
  X(bias_load_coefficient, "1", 0.0, -10.0, 10.0, true, "friction per gravity and Coriolis force") \
  X(wear_rate, "1/rad", 0.0, 0.0, 1e3, true, "relative growth per path travelled (Archard 1953)")  \
  X(drift_amplitude, "1", 0.0, 0.0, 1.0, true, "relative slow sinusoidal change")                  \
  X(drift_period, "s", 60.0, 0.0, 1e6, false, "period of the slow change")                         \
  X(wear, "1", 1.0, 0.0, 1e3, true, "relative friction level; the machine itself changes it")

#define LEGLAB_FRICTION_STATES(X)  \
  X(bristle, "rad", "LuGre bristle deflection z")                                                  \
  X(sliding_distance, "rad", "path since the reset")                                               \
  X(load, "N m", "|actuator_load_coefficient qfrc_actuator + bias_load_coefficient qfrc_bias| of the last step")
LEGLAB_TABLE(Friction, "leglab.joint_friction", LEGLAB_FRICTION_PARAMETERS, LEGLAB_FRICTION_STATES, "joint")

// Friction at a velocity: steady bristle force g and viscous coefficient.
struct FrictionLevel {
  double sliding;  // N m or N, not negative
  double viscous;  // N m s/rad or N s/m

  // Wear and slow drift scale all friction; the direction of sliding shifts and scales friction; the
  // joint's load adds equally to Coulomb and breakaway friction (Duclusaud et al. 2025).
  static FrictionLevel at(const FrictionParameters& p, double v, double load, double time) {
    const double drift =
        1.0 + p.drift_amplitude_ * std::sin(2.0 * std::numbers::pi * time / p.drift_period_);
    const double side = v > 0 ? 1.0 : v < 0 ? -1.0 : 0.0;
    const double scale = p.wear_ * drift * (1.0 + side * p.direction_asymmetry_);
    const double shift = 0.5 * side * p.coulomb_difference_ + load;
    const double coulomb = std::max(p.coulomb_ + shift, 0.0), top = std::max(p.static_ + shift, 0.0);
    return {coulomb > 0 || top > 0
                ? stribeck(v, scale * coulomb, scale * top, p.stribeck_velocity_, p.stribeck_exponent_)
                : 0.0,
            scale * (p.viscous_ + 0.5 * side * p.viscous_difference_)};
  }
};

}  // namespace leglab::hydraulics
