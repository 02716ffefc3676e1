// LuGre friction (Canudas de Wit et al. 1995): z' = v - sigma_0 |v| z / g(v).
#pragma once

#include <cmath>

namespace leglab::hydraulics {

// Steady bristle force g(v) = F_c + (F_s - F_c) exp(-(v/v_s)^2), always positive.
inline double stribeck(double v, double coulomb, double static_friction, double stribeck_velocity) {
  const double r = v / stribeck_velocity;
  const double g = coulomb + (static_friction - coulomb) * std::exp(-r * r);
  return g > 1e-9 ? g : 1e-9;
}

// Bristle after dt at constant velocity: exact solution, tends to sgn(v) g / sigma_0.
inline double advance_bristle(double z, double v, double g, double sigma_0, double dt) {
  if (v == 0.0 || sigma_0 == 0.0) return sigma_0 == 0.0 ? 0.0 : z;
  const double steady = std::copysign(g / sigma_0, v);
  return steady + (z - steady) * std::exp(-sigma_0 * std::abs(v) / g * dt);
}

}  // namespace leglab::hydraulics
