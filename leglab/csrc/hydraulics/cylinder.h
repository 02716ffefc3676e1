// One valve-controlled cylinder: coefficients from its parameters, volumes, chambers and forces.
#pragma once

#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>

#include "fluid.h"
#include "friction.h"
#include "parameters.h"
#include "valve.h"

namespace leglab::hydraulics {

// Message on the first parameter that contradicts another parameter, with allowed values, or "".
inline std::string contradiction(const CylinderParameters& p) {
  const auto text = [](const char* name, double value, const char* unit, const char* rule,
                       double limit) {
    char line[200];
    std::snprintf(line, sizeof line, "attribute '%s' = %g%s is out of range; allowed: %s %g%s", name,
                  value, unit, rule, limit, unit);
    return std::string(line);
  };
  if (p.rod_ >= p.bore_) return text("rod", p.rod_, " m", "less than bore =", p.bore_);
  if (p.static_ < p.coulomb_) return text("static", p.static_, " N", "at least coulomb =", p.coulomb_);
  if (std::abs(p.viscous_difference_) > 2.0 * p.viscous_) {
    return text("viscous_difference", p.viscous_difference_, " N s/m", "of a size of at most 2 viscous =",
                2.0 * p.viscous_);
  }
  if (p.viscosity_100_ >= p.viscosity_40_) {
    return text("viscosity_100", p.viscosity_100_, " m^2/s", "less than viscosity_40 =",
                p.viscosity_40_);
  }
  if (p.substeps_ != std::floor(p.substeps_)) {
    return text("substeps", p.substeps_, "", "a whole number such as", std::ceil(p.substeps_));
  }
  return "";
}

// Coefficients that change only when a parameter is set.
struct CylinderCoefficients {
  double area_a, area_b;             // m^2
  double half_stroke;                // m
  double gain_positive, gain_negative;  // K of the edges open at x_s > 0 and x_s < 0
  double transition_squared;         // Pa^2
  double mu_40;                      // Pa s
  double inverse_w_floor;            // 1/w (see `Oil`) at the pressure floor
  Oil oil;
  Viscosity viscosity;

  static CylinderCoefficients from(const CylinderParameters& p) {
    constexpr double quarter_pi = std::numbers::pi / 4.0;
    const double gain = p.rated_flow_ / std::sqrt(p.rated_pressure_drop_ / 2.0);
    const Viscosity viscosity = Viscosity::from_two_points(p.viscosity_40_, p.viscosity_100_);
    const Oil oil{p.entrained_air_, 1.0 / p.polytropic_index_, 1.0 / p.bulk_modulus_};
    return {
        .area_a = quarter_pi * p.bore_ * p.bore_,
        .area_b = quarter_pi * (p.bore_ * p.bore_ - p.rod_ * p.rod_),
        .half_stroke = 0.5 * p.stroke_,
        .gain_positive = gain * (1.0 + p.flow_asymmetry_),
        .gain_negative = gain * (1.0 - p.flow_asymmetry_),
        .transition_squared = p.laminar_transition_pressure_ * p.laminar_transition_pressure_,
        .mu_40 = viscosity.kinematic(40.0) * p.density_ * relative_density(40.0),
        .inverse_w_floor = 1.0 / oil.expand(kPressureFloor).w,
        .oil = oil,
        .viscosity = viscosity,
    };
  }
};

// Coefficients that depend on the oil temperature and the seal clearance.
struct OilCondition {
  double internal_leakage, external_leakage_a, external_leakage_b;  // m^3/s/Pa
  double viscous, viscous_difference;                               // N s/m

  // Viscous friction at a velocity.
  double viscous_at(double v) const {
    const double side = v > 0 ? 0.5 : v < 0 ? -0.5 : 0.0;
    return viscous + side * viscous_difference;
  }

  static OilCondition from(const CylinderParameters& p, const CylinderCoefficients& c) {
    const double t = p.oil_temperature_;
    const double mu = c.viscosity.kinematic(t) * p.density_ * relative_density(t);
    const double clearance = p.seal_clearance_;
    const double gap = clearance * clearance * clearance * c.mu_40 / mu;
    return {p.internal_leakage_ * gap, p.external_leakage_a_ * gap, p.external_leakage_b_ * gap,
            p.viscous_ * mu / c.mu_40, p.viscous_difference_ * mu / c.mu_40};
  }
};

struct Volumes {
  double a, b;  // m^3

  // Beyond the stops the chambers keep a tenth of their dead volume, so that they stay positive.
  static Volumes at(const CylinderParameters& p, const CylinderCoefficients& c, double x) {
    return {std::max(p.dead_volume_a_ + c.area_a * x, 0.1 * p.dead_volume_a_),
            std::max(p.dead_volume_b_ + c.area_b * (p.stroke_ - x), 0.1 * p.dead_volume_b_)};
  }
};

// Both chambers at a piston position: amounts of oil, and relative volumes near its pressures.
struct Chambers {
  Oil::Expansion a, b;
  double amount_a, amount_b;  // m^3

  double gauge_a() const { return a.p - kAtmosphere; }
  double gauge_b() const { return b.p - kAtmosphere; }

  // Spring of the enclosed oil against the piston [N/m].
  double stiffness(const CylinderCoefficients& c) const {
    return -(c.area_a * c.area_a / (a.slope * amount_a) + c.area_b * c.area_b / (b.slope * amount_b));
  }
};

inline Chambers chambers_at(const CylinderParameters& p, const CylinderCoefficients& c,
                            const CylinderState& s, double x) {
  const Volumes volume = Volumes::at(p, c, x);
  Chambers k;
  const auto fill = [&](double size, double pressure, double held, Oil::Expansion& oil, double& amount) {
    const double guess = pressure + kAtmosphere;
    // An amount of zero means a prescribed pressure, which is kept at any piston position.
    oil = held > 0.0 ? c.oil.solve(size / held, guess) : c.oil.expand(std::max(guess, kPressureFloor));
    amount = held > 0.0 ? held : size / oil.w;
  };
  fill(volume.a, s.pressure_a_, s.amount_a_, k.a, k.amount_a);
  fill(volume.b, s.pressure_b_, s.amount_b_, k.b, k.amount_b);
  return k;
}

// Forces on the piston, extension positive [N].
struct PistonForces {
  double pressure, friction, stop;

  double total() const { return pressure - friction + stop; }
};

inline double stop_force(const CylinderParameters& p, double x, double v) {
  if (x < 0.0) return std::max(-p.stop_stiffness_ * x - p.stop_damping_ * v, 0.0);
  if (x > p.stroke_) {
    return std::min(p.stop_stiffness_ * (p.stroke_ - x) - p.stop_damping_ * v, 0.0);
  }
  return 0.0;
}

// Stribeck curve g at a velocity and the sum of the gauge pressures of both chambers. The friction of
// seals with one lip depends on the direction of sliding.
inline double bristle_level(const CylinderParameters& p, double v, double pressures) {
  double seal = p.pressure_coefficient_ * pressures;
  if (p.coulomb_difference_ == 0.0 || v == 0.0) {
    return stribeck(v, p.coulomb_ + seal, p.static_ + seal, p.stribeck_velocity_, p.stribeck_exponent_);
  }
  seal += std::copysign(0.5, v) * p.coulomb_difference_;
  return stribeck(v, std::max(p.coulomb_ + seal, 0.0), std::max(p.static_ + seal, 0.0),
                  p.stribeck_velocity_, p.stribeck_exponent_);
}

// The smaller of two loads of equal sign, otherwise zero, so that an impact of one step is ignored.
inline double sustained(double load, double before) {
  if (load * before <= 0.0) return 0.0;
  return std::abs(load) < std::abs(before) ? load : before;
}

// Forces over the next step. Friction is F = sigma_0 z + D v*, with D the slope of the LuGre law in
// v. v* lies between the velocity before the step and the velocity after it, which is predicted
// from the effective mass and the load of the last steps. v* in the middle gives second order. With
// k = h D/m > 2 (cold oil has 13 times the viscous friction) v* is at 1 - 1/k of the way, which
// damps in a step without overshoot. At steady speed D v* equals D v; infinite mass gives v* = v.
inline PistonForces piston_forces(const CylinderParameters& p, const CylinderCoefficients& c,
                                  const OilCondition& oil, const CylinderState& s,
                                  const Chambers& k, double x, double v, double step_over_mass) {
  PistonForces f;
  f.pressure = k.gauge_a() * c.area_a - k.gauge_b() * c.area_b;
  f.stop = stop_force(p, x, v);
  const double g = bristle_level(p, v, k.gauge_a() + k.gauge_b());
  const double bristle_force = p.sigma_0_ * s.bristle_;
  const double alignment = std::copysign(1.0, v) * bristle_force / g;
  const double slope = oil.viscous_at(v) + p.sigma_1_ * std::max(1.0 - alignment, 0.0);
  double v_between = v;
  if (step_over_mass > 0.0 && s.amount_a_ > 0.0) {
    const double others = f.pressure + f.stop - bristle_force + sustained(s.load_, s.previous_load_);
    const double k = step_over_mass * slope;
    const double way = k > 2.0 ? 1.0 - 1.0 / k : 0.5;
    v_between += way * step_over_mass * (others - slope * v) / (1.0 + way * k);
  }
  f.friction = bristle_force + slope * v_between;
  return f;
}

}  // namespace leglab::hydraulics
