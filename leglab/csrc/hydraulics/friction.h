// LuGre friction (Canudas de Wit et al. 1995): z' = v - sigma_0 |v| z / g(v).
#pragma once

#include <cmath>

namespace leglab::hydraulics {

// Steady bristle force g(v) = F_c + (F_s - F_c) exp(-|v/v_s|^n), always positive; the exponent n is 2
// for a Gaussian, 1 for an exponential fall (Armstrong-Helouvry et al. 1994, sect. 2.1.3).
inline double stribeck(double v, double coulomb, double static_friction, double stribeck_velocity,
                       double exponent) {
  const double r = v / stribeck_velocity;
  const double power = exponent == 2.0 ? r * r : std::pow(std::abs(r), exponent);
  const double g = coulomb + (static_friction - coulomb) * std::exp(-power);
  return g > 1e-9 ? g : 1e-9;
}

// Bristle after dt at constant velocity: exact solution, tends to sgn(v) g / sigma_0.
inline double advance_bristle(double z, double v, double g, double sigma_0, double dt) {
  if (v == 0.0 || sigma_0 == 0.0) return sigma_0 == 0.0 ? 0.0 : z;
  const double steady = std::copysign(g / sigma_0, v);
  return steady + (z - steady) * std::exp(-sigma_0 * std::abs(v) / g * dt);
}

}  // namespace leglab::hydraulics
