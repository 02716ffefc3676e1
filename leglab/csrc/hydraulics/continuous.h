// The cylinder of `step.h` as ordinary differential equations, for stiff reference solvers.
#pragma once

#include "step.h"

namespace leglab::hydraulics {

// Order of the continuous state; the last entries are energies [J] since the start.
enum ContinuousState {
  kX, kV, kSpool, kSpoolVelocity, kPressureA, kPressureB, kBristle,
  kEnergySupply, kEnergyValve, kEnergyLeakage, kEnergyFriction, kEnergyStored, kEnergyLoad,
  kContinuousCount
};

// Inputs of the time derivative: the piston moves `mass` kg against `load` N (positive opposes
// extension). The command passes the spool dynamics; `blocked` locks the piston.
struct ContinuousInput {
  double command, supply_pressure, mass, load;
  bool blocked;
};

inline void continuous_derivative(const CylinderParameters& p, const CylinderCoefficients& c,
                                  const OilCondition& oil, const ContinuousInput& in,
                                  const double* y, double* dy) {
  const double x = y[kX], v = in.blocked ? 0.0 : y[kV];
  const double pa = y[kPressureA], pb = y[kPressureB];
  const double command = std::clamp(in.command + p.null_bias_, -1.0, 1.0);
  const double spool = std::clamp(y[kSpool], -1.0, 1.0);
  const double w = 2.0 * std::numbers::pi * p.bandwidth_hz_;

  const CylinderFlows f = flows_at(c, oil, Edges::at(p, c, spool), in.supply_pressure,
                                   p.tank_pressure_, pa, pb);
  const Volumes volume = Volumes::at(p, c, x);
  const auto chamber = [&](double pressure, double size, double flow, double& slope) {
    const Oil::Expansion e = c.oil.expand(std::max(pressure + kAtmosphere, kPressureFloor));
    slope = e.bulk_modulus() / size * flow;
    return pressure * flow;  // p V/beta p'
  };
  const double net_a = f.a - f.leak - f.leak_a - c.area_a * v;
  const double net_b = f.b + f.leak - f.leak_b + c.area_b * v;
  const double stored_a = chamber(pa, volume.a, net_a, dy[kPressureA]);
  const double stored_b = chamber(pb, volume.b, net_b, dy[kPressureB]);

  const double g = bristle_level(p, v, pa + pb);
  const double bristle_rate = p.sigma_0_ > 0 ? v - p.sigma_0_ * std::abs(v) * y[kBristle] / g : 0.0;
  const double friction = p.sigma_0_ * y[kBristle] + p.sigma_1_ * bristle_rate + oil.viscous_at(v) * v;
  const double stop = stop_force(p, x, v);
  const double force = pa * c.area_a - pb * c.area_b - friction + stop;

  dy[kX] = v;
  dy[kV] = in.blocked ? 0.0 : (force - in.load) / in.mass;
  dy[kSpool] = y[kSpoolVelocity];
  dy[kSpoolVelocity] =
      w * w * (command - y[kSpool]) - 2.0 * p.damping_ratio_ * w * y[kSpoolVelocity];
  dy[kBristle] = bristle_rate;
  dy[kEnergySupply] = in.supply_pressure * f.supply - p.tank_pressure_ * (f.supply - f.a - f.b);
  dy[kEnergyValve] = f.edge_power;
  dy[kEnergyLeakage] = f.leak * (pa - pb) + f.leak_a * pa + f.leak_b * pb;
  dy[kEnergyFriction] = (friction - stop) * v;
  dy[kEnergyStored] = stored_a + stored_b;
  dy[kEnergyLoad] = force * v;
}

}  // namespace leglab::hydraulics
