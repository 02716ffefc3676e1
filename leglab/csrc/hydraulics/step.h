// One time step of a cylinder, after the mechanism has moved.
#pragma once

#include "cylinder.h"

namespace leglab::hydraulics {

// Coefficients that depend on the time step and the spool's dynamics.
struct StepCoefficients {
  double dt;  // s, of a sub-step
  int substeps;
  SpoolTransition spool;  // over dt

  static StepCoefficients from(const CylinderParameters& p, double timestep) {
    const int n = static_cast<int>(p.substeps_);
    const double dt = timestep / n;
    const double w = 2.0 * std::numbers::pi * p.bandwidth_hz_;
    return {dt, n, SpoolTransition::over(dt, w, p.damping_ratio_)};
  }
};

// Flows at given pressures (gauge) and spool position.
struct CylinderFlows {
  double a, b;               // valve to chamber, m^3/s
  double supply;             // P -> A plus P -> B, m^3/s
  double leak, leak_a, leak_b;  // A -> B, A -> outside, B -> outside, m^3/s
  double edge_power;         // W
  double da_dpa, db_dpb;     // slopes of the valve flows, m^3/s/Pa, never positive
};

struct Edges {
  double opening[4];  // K w of P -> A, A -> T, P -> B, B -> T

  static Edges at(const CylinderParameters& p, const CylinderCoefficients& c, double spool) {
    const auto opening = [&](double gain, double to, double lap) {
      return gain * EdgeShape{lap, p.edge_rounding_, p.edge_exponent_}.opening(to);
    };
    const double tank = 0.5 * p.lap_difference_tank_, a = 0.5 * p.lap_difference_chambers_;
    const double from_supply_a = opening(c.gain_positive, spool, p.lap_ - tank + a);
    const double to_tank_a = opening(c.gain_negative, -spool, p.lap_ + tank + a);
    if (tank == 0.0 && a == 0.0)  // equal laps, as usual: takes half the computing time
      return {{from_supply_a, to_tank_a, to_tank_a, from_supply_a}};
    return {{from_supply_a, to_tank_a, opening(c.gain_negative, -spool, p.lap_ - tank - a),
             opening(c.gain_positive, spool, p.lap_ + tank - a)}};
  }

  static Edges between(const Edges& one, const Edges& other) {
    Edges half;
    for (int i = 0; i < 4; ++i) half.opening[i] = 0.5 * (one.opening[i] + other.opening[i]);
    return half;
  }
};

inline CylinderFlows flows_at(const CylinderCoefficients& c, const OilCondition& oil,
                              const Edges& edges, double supply_pressure, double tank_pressure,
                              double pa, double pb) {
  const double dp[4] = {supply_pressure - pa, pa - tank_pressure, supply_pressure - pb,
                        pb - tank_pressure};
  const OrificeFlows f = orifice_flows(edges.opening, dp, c.transition_squared);
  return {
      .a = f.q[0] - f.q[1],
      .b = f.q[2] - f.q[3],
      .supply = f.q[0] + f.q[2],
      .leak = oil.internal_leakage * (pa - pb),
      .leak_a = oil.external_leakage_a * pa,
      .leak_b = oil.external_leakage_b * pb,
      .edge_power = f.q[0] * dp[0] + f.q[1] * dp[1] + f.q[2] * dp[2] + f.q[3] * dp[3],
      .da_dpa = -(f.slope[0] + f.slope[1]),
      .db_dpb = -(f.slope[2] + f.slope[3]),
  };
}

// Totals over a time step, for sensors and the energy balance.
struct StepTotals {
  double flow_a = 0, flow_b = 0, supply = 0;  // m^3
  double edges = 0, leakage = 0, stored = 0;      // J
};

// Relative change up to which a step extrapolates a pressure, with a relative error of its cube.
// Errors do not accumulate, because the next step solves for pressures from the oil amounts.
inline constexpr double kPressureReach = 1e-2;

// A sub-step whose embedded error estimate exceeds kPressureError is halved, at most kHalvings
// times. This is rare (an orifice near zero pressure drop, a slammed valve), but without it the
// square root of an orifice can keep the scheme at a wrong pressure, by 5 % at full opening.
inline constexpr double kPressureError = 2e5;  // Pa
inline constexpr int kHalvings = 4;

// One sub-step of the L-stable two-stage Rosenbrock method ROS2 (Verwer et al. 1999,
// gamma = 1 - 1/sqrt 2; order two for any Jacobian) on the amounts of oil:
//   N_A' = (Q_A - leakage)/w(p_A),  p_A from w(p_A) = V_A(t)/N_A,  and the same for B.
// Spool and volumes move from `edges`, `volume` to `edges_end`, `volume_end`; the method includes the
// time derivative due to the volumes, so that pressures stay smooth while the piston moves.
inline void advance_chambers(const CylinderCoefficients& c, const OilCondition& oil,
                             const Edges& edges, const Edges& edges_end, const Volumes& volume,
                             const Volumes& volume_end, double supply_pressure,
                             double tank_pressure, double dt, Chambers& k, StepTotals& totals,
                             int halvings = kHalvings) {
  constexpr double gamma = 1.0 - 1.0 / std::numbers::sqrt2;
  const double gdt = gamma * dt;
  const double pa = k.gauge_a(), pb = k.gauge_b();
  const CylinderFlows f1 = flows_at(c, oil, edges, supply_pressure, tank_pressure, pa, pb);

  const double slope_aa = f1.da_dpa - oil.internal_leakage - oil.external_leakage_a;
  const double slope_bb = f1.db_dpb - oil.internal_leakage - oil.external_leakage_b;
  // dp/dV = 1/(w' N) at constant amount, dp/dN = -w dp/dV at constant volume.
  const double stiff_a = 1.0 / (k.a.slope * k.amount_a), stiff_b = 1.0 / (k.b.slope * k.amount_b);
  // With vapour the pressure stays at the floor while the piston moves, so its rise is zero. The
  // stiffness stays, so that a chamber that fills up within the sub-step does not overshoot.
  const double rise_a = k.a.p > kPressureFloor ? stiff_a * (volume_end.a - volume.a) : 0.0;
  const double rise_b = k.b.p > kPressureFloor ? stiff_b * (volume_end.b - volume.b) : 0.0;
  // If vapour fills part of a chamber, oil enters with its relative volume at the pressure floor.
  const double inverse_wa = std::max(k.amount_a / volume.a, c.inverse_w_floor);
  const double inverse_wb = std::max(k.amount_b / volume.b, c.inverse_w_floor);

  // Matrix I - gamma dt J of (N_A', N_B').
  const double m_aa = 1.0 + gdt * slope_aa * stiff_a;
  const double m_ab = gdt * oil.internal_leakage * stiff_b;
  const double m_ba = gdt * oil.internal_leakage * stiff_a;
  const double m_bb = 1.0 + gdt * slope_bb * stiff_b;
  const double inverse_det = 1.0 / (m_aa * m_bb - m_ab * m_ba);
  const double drift_a = gamma * (slope_aa * rise_a + oil.internal_leakage * rise_b) * inverse_wa;
  const double drift_b = gamma * (slope_bb * rise_b + oil.internal_leakage * rise_a) * inverse_wb;

  const double r1a = (f1.a - f1.leak - f1.leak_a) * inverse_wa + drift_a;
  const double r1b = (f1.b + f1.leak - f1.leak_b) * inverse_wb + drift_b;
  const double k1a = (m_bb * r1a - m_ab * r1b) * inverse_det;
  const double k1b = (m_aa * r1b - m_ba * r1a) * inverse_det;

  const double na = std::max(k.amount_a + dt * k1a, 0.5 * k.amount_a);
  const double nb = std::max(k.amount_b + dt * k1b, 0.5 * k.amount_b);
  const double pa2 = k.a.pressure_at(volume_end.a / na) - kAtmosphere;
  const double pb2 = k.b.pressure_at(volume_end.b / nb) - kAtmosphere;
  const CylinderFlows f2 = flows_at(c, oil, edges_end, supply_pressure, tank_pressure, pa2, pb2);
  const double inverse_wa2 = std::max(na / volume_end.a, c.inverse_w_floor);
  const double inverse_wb2 = std::max(nb / volume_end.b, c.inverse_w_floor);
  const double r2a = (f2.a - f2.leak - f2.leak_a) * inverse_wa2 - 2.0 * k1a - drift_a;
  const double r2b = (f2.b + f2.leak - f2.leak_b) * inverse_wb2 - 2.0 * k1b - drift_b;
  const double k2a = (m_bb * r2a - m_ab * r2b) * inverse_det;
  const double k2b = (m_aa * r2b - m_ba * r2a) * inverse_det;

  // Error estimate: ROS2 minus the first-order solution N + dt k1, converted to pressure.
  const double error_a = 0.5 * dt * (k1a + k2a) * stiff_a / inverse_wa;
  const double error_b = 0.5 * dt * (k1b + k2b) * stiff_b / inverse_wb;
  if (halvings > 0 && std::max(std::abs(error_a), std::abs(error_b)) > kPressureError) {
    const Edges edges_half = Edges::between(edges, edges_end);
    const Volumes volume_half{0.5 * (volume.a + volume_end.a), 0.5 * (volume.b + volume_end.b)};
    advance_chambers(c, oil, edges, edges_half, volume, volume_half, supply_pressure,
                     tank_pressure, 0.5 * dt, k, totals, halvings - 1);
    advance_chambers(c, oil, edges_half, edges_end, volume_half, volume_end, supply_pressure,
                     tank_pressure, 0.5 * dt, k, totals, halvings - 1);
    return;
  }

  const double na_end = std::max(k.amount_a + dt * (1.5 * k1a + 0.5 * k2a), 0.5 * k.amount_a);
  const double nb_end = std::max(k.amount_b + dt * (1.5 * k1b + 0.5 * k2b), 0.5 * k.amount_b);
  k.amount_a = na_end;
  k.amount_b = nb_end;
  k.a = c.oil.follow(k.a, volume_end.a / na_end, kPressureReach);
  k.b = c.oil.follow(k.b, volume_end.b / nb_end, kPressureReach);

  const double half = 0.5 * dt;
  totals.flow_a += half * (f1.a + f2.a);
  totals.flow_b += half * (f1.b + f2.b);
  totals.supply += half * (f1.supply + f2.supply);
  totals.edges += half * (f1.edge_power + f2.edge_power);
  totals.leakage += half * (f1.leak * (pa - pb) + f1.leak_a * pa + f1.leak_b * pb +
                            f2.leak * (pa2 - pb2) + f2.leak_a * pa2 + f2.leak_b * pb2);
}

// Motion of the piston and the forces on it over the mechanism's latest step.
struct PistonStep {
  double x;              // m, at the start
  double v_start;        // m/s, at the start
  double v;              // m/s, over the step: x -> x + v timestep
  double force;          // N, applied to the mechanism
  double friction;       // N, seal friction and end stops within `force`
  double mass;           // kg, effective; 0 = unknown
};

// Advances spool, oil amounts, bristle, temperature, wear and the energy balance by one time step.
inline void advance_cylinder(CylinderParameters& p, const CylinderCoefficients& c,
                             const StepCoefficients& step, const OilCondition& oil,
                             const Chambers& start, const PistonStep& piston, double command,
                             double supply_pressure, CylinderState& s) {
  const double timestep = step.dt * step.substeps;
  Chambers k = start;
  StepTotals totals;

  // Hysteresis as a play of full width `hysteresis` between command and spool.
  const double u = std::clamp(command, -1.0, 1.0);
  const double play = 0.5 * p.hysteresis_;
  s.play_output_ = std::clamp(s.play_output_, u - play, u + play);
  const double target = std::clamp(s.play_output_ + p.null_bias_, -1.0, 1.0);

  Edges edges = Edges::at(p, c, s.spool_position_);
  const Volumes first = Volumes::at(p, c, piston.x);
  Volumes volume = first;
  for (int i = 1; i <= step.substeps; ++i) {
    step.spool.advance(target, s.spool_position_, s.spool_velocity_);
    const Edges edges_end = Edges::at(p, c, s.spool_position_);
    const Volumes volume_end = Volumes::at(p, c, piston.x + piston.v * (i * step.dt));
    advance_chambers(c, oil, edges, edges_end, volume, volume_end, supply_pressure,
                     p.tank_pressure_, step.dt, k, totals);
    edges = edges_end;
    volume = volume_end;
  }

  const double g = bristle_level(p, piston.v, k.gauge_a() + k.gauge_b());
  s.bristle_ = advance_bristle(s.bristle_, piston.v, g, p.sigma_0_, timestep);
  if (piston.mass > 0.0) {
    const double load = piston.mass * (piston.v - piston.v_start) / timestep - piston.force;
    s.previous_load_ = s.amount_a_ > 0.0 ? s.load_ : load;
    s.load_ = load;
  }

  // Compression work p V/beta dp as p (dV_in - dV), trapezoid in p.
  const double mean_a = 0.5 * (start.gauge_a() + k.gauge_a());
  const double mean_b = 0.5 * (start.gauge_b() + k.gauge_b());
  const auto shrinkage = [](double v0, double v1, double n0, double n1) {
    return 0.5 * (n0 + n1) * (v0 / n0 - v1 / n1);
  };
  totals.stored = mean_a * shrinkage(first.a, volume.a, start.amount_a, k.amount_a) +
                  mean_b * shrinkage(first.b, volume.b, start.amount_b, k.amount_b);
  const double distance = piston.v * timestep;
  const double returned = totals.supply - totals.flow_a - totals.flow_b;  // to the tank
  const double friction_loss = piston.friction * distance;
  s.energy_supply_ += supply_pressure * totals.supply - p.tank_pressure_ * returned;
  s.energy_valve_ += totals.edges;
  s.energy_leakage_ += totals.leakage;
  s.energy_friction_ += friction_loss;
  s.energy_stored_ += totals.stored;
  s.energy_load_ += piston.force * distance;

  s.pressure_a_ = k.gauge_a();
  s.pressure_b_ = k.gauge_b();
  s.amount_a_ = k.amount_a;
  s.amount_b_ = k.amount_b;
  s.flow_a_ = totals.flow_a / timestep;
  s.flow_b_ = totals.flow_b / timestep;
  s.supply_flow_ = totals.supply / timestep;
  s.sliding_distance_ += std::abs(distance);

  p.seal_clearance_ += p.seal_wear_rate_ * std::abs(distance);
  if (p.thermal_capacity_ > 0.0) {
    const double heat = totals.edges + totals.leakage + friction_loss -
                        p.heat_transfer_ * (p.oil_temperature_ - p.ambient_temperature_) * timestep;
    p.oil_temperature_ += heat / p.thermal_capacity_;
  }
}

}  // namespace leglab::hydraulics
