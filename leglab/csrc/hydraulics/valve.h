// Four-way servovalve: spool dynamics, metering edges, orifices.
#pragma once

#include <algorithm>
#include <cmath>

namespace leglab::hydraulics {

// Exact transition over a fixed time of x'' = w^2 (u - x) - 2 zeta w x' with u held.
struct SpoolTransition {
  double xx, xv, vx, vv;  // acts on (x - u, x')

  static SpoolTransition over(double dt, double natural_frequency, double damping_ratio) {
    const double w = natural_frequency, z = damping_ratio;
    const double decay = std::exp(-z * w * dt);
    double c, s;  // cos(wd t) and sin(wd t)/wd, continued to the overdamped case
    if (z < 1.0) {
      const double wd = w * std::sqrt(1.0 - z * z);
      c = std::cos(wd * dt);
      s = std::sin(wd * dt) / wd;
    } else if (z > 1.0) {
      const double wd = w * std::sqrt(z * z - 1.0);
      c = std::cosh(wd * dt);
      s = std::sinh(wd * dt) / wd;
    } else {
      c = 1.0;
      s = dt;
    }
    return {decay * (c + z * w * s), decay * s, -decay * w * w * s, decay * (c - z * w * s)};
  }

  void advance(double command, double& x, double& v) const {
    const double e = x - command;
    // A settled spool is set exactly: otherwise its decay ends in denormal numbers, which are slow.
    if (std::abs(e) < 1e-14 && std::abs(v) < 1e-11) {
      x = command;
      v = 0.0;
      return;
    }
    x = command + xx * e + xv * v;
    v = vx * e + vv * v;
    if (std::abs(x) > 1.0) {  // mechanical stop of the spool
      x = std::copysign(1.0, x);
      if (x * v > 0.0) v = 0.0;
    }
  }
};

// Metering edge: relative opening at a spool position, smooth through the lap.
struct EdgeShape {
  double lap, rounding, exponent;

  // (d + (|d|^n + eps^n)^(1/n))/2 with d = spool - lap. At the lap the edge is open by eps/2 for any n.
  // For n = 2 the curve is a hyperbola; for n = 1 the edge stays open by eps/2 below the lap, like an
  // edge with radial clearance; with a larger n it closes sooner.
  double opening(double spool) const {
    const double d = spool - lap;
    return 0.5 * (d + reach(std::abs(d)));
  }

 private:
  double reach(double distance) const {
    if (exponent == 2.0) return std::sqrt(distance * distance + rounding * rounding);
    const double larger = std::max(distance, rounding), smaller = std::min(distance, rounding);
    if (larger == 0.0) return 0.0;
    return larger * std::pow(1.0 + std::pow(smaller / larger, exponent), 1.0 / exponent);
  }
};

// Flows of four independent orifices: Q = w dp / (dp^2 + dp_cr^2)^(1/4), and slopes dQ/d(dp).
struct OrificeFlows {
  double q[4];
  double slope[4];
};

inline OrificeFlows orifice_flows(const double (&opening)[4], const double (&dp)[4],
                                  double transition_squared) {
  OrificeFlows f;
  for (int i = 0; i < 4; ++i) {  // vectorised by the compiler
    const double square = dp[i] * dp[i];
    const double sum = square + transition_squared;
    const double scale = opening[i] / std::sqrt(std::sqrt(sum));
    f.q[i] = scale * dp[i];
    f.slope[i] = scale * (1.0 - 0.5 * square / sum);
  }
  return f;
}

}  // namespace leglab::hydraulics
