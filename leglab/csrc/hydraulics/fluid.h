// Hydraulic oil: viscosity, density, and compressibility with entrained air.
#pragma once

#include <algorithm>
#include <cmath>

namespace leglab::hydraulics {

inline constexpr double kAtmosphere = 101325.0;            // Pa
inline constexpr double kPressureFloor = 0.02 * kAtmosphere;  // Pa absolute; below it the oil boils
inline constexpr double kZeroCelsius = 273.15;             // K

// ASTM D341 (Walther): log10 log10(nu + 0.7) = A - B log10(T), nu in cSt, T in K.
struct Viscosity {
  double a;
  double b;

  static Viscosity from_two_points(double nu_40, double nu_100) {
    const double w40 = std::log10(std::log10(nu_40 * 1e6 + 0.7));
    const double w100 = std::log10(std::log10(nu_100 * 1e6 + 0.7));
    const double t40 = std::log10(40.0 + kZeroCelsius);
    const double t100 = std::log10(100.0 + kZeroCelsius);
    const double b = (w40 - w100) / (t100 - t40);
    return {w40 + b * t40, b};
  }

  // Kinematic viscosity [m^2/s] at a temperature in degC.
  double kinematic(double celsius) const {
    constexpr double ln10 = 2.302585092994046;
    const double w = a * ln10 - b * std::log(celsius + kZeroCelsius);  // ln log10(nu + 0.7)
    return (std::exp(ln10 * std::exp(w)) - 0.7) * 1e-6;
  }
};

// Density relative to 15 degC; thermal expansion 7e-4 1/K of mineral oil.
inline double relative_density(double celsius) { return 1.0 - 7e-4 * (celsius - 15.0); }

// Relative volume of a fixed amount of oil and its entrained air under absolute pressure p:
//   w(p) = g + l,  g = x0 (p0/p)^(1/n),  l = (1 - x0) exp(-(p - p0)/beta_l),
// so that beta = -w/w' = (g + l)/(g/(n p) + l/beta_l). An amount N [m^3 at p0] fills V = N w(p).
struct Oil {
  double air;               // x0
  double inverse_index;     // 1/n
  double inverse_modulus;   // 1/beta_l

  struct Expansion {
    double p, w, slope, curvature;  // Pa absolute, w, dw/dp, d2w/dp2

    double bulk_modulus() const { return -w / slope; }

    // Pressure at relative volume `target` by one Halley step, at least the vapour pressure.
    double pressure_at(double target) const {
      const double inverse = 1.0 / slope;
      const double newton = (target - w) * inverse;
      const double denominator = 1.0 + 0.5 * newton * (curvature * inverse);
      const double step = denominator > 0.25 ? newton / denominator : 4.0 * newton;
      return std::max({p + step, 0.25 * p, kPressureFloor});
    }

    // The expansion at a nearby pressure, to second order; `target` is the new w, unless the oil boils
    // (pressure at the floor) and vapour fills the rest of `target`.
    Expansion moved_to(double pressure, double target) const {
      const double step = pressure - p;
      const double there = pressure > kPressureFloor ? target : std::min(target, w + slope * step);
      return {pressure, there, slope + curvature * step, curvature};
    }
  };

  Expansion expand(double p) const {
    const double liquid = (1.0 - air) * std::exp((kAtmosphere - p) * inverse_modulus);
    const double liquid_slope = -liquid * inverse_modulus;
    if (air == 0.0) return {p, liquid, liquid_slope, -liquid_slope * inverse_modulus};
    const double gas = air * std::exp(-inverse_index * std::log(p * (1.0 / kAtmosphere)));
    const double gas_slope = -gas * inverse_index / p;
    return {p, gas + liquid, gas_slope + liquid_slope,
            -gas_slope * (inverse_index + 1.0) / p - liquid_slope * inverse_modulus};
  }

  // Expansion at the pressure where w = target, from a guess. The error of Halley's method shrinks
  // with the cube of the step: after a last step of at most `reach` p it is about reach^3 p. So the
  // default reach, 1e-5, is exact in double precision.
  Expansion solve(double target, double guess, double reach = 1e-5) const {
    Expansion e = expand(std::max(guess, kPressureFloor));
    double p = e.pressure_at(target);
    for (int i = 0; i < 60 && std::abs(p - e.p) > reach * e.p; ++i) {
      e = expand(p);
      p = e.pressure_at(target);
    }
    return e.moved_to(p, target);
  }

  // Solves w = target like `solve`, but from a known expansion.
  Expansion follow(const Expansion& from, double target, double reach) const {
    const double p = from.pressure_at(target);
    return std::abs(p - from.p) <= reach * from.p ? from.moved_to(p, target)
                                                  : solve(target, p, reach);
  }
};

}  // namespace leglab::hydraulics
