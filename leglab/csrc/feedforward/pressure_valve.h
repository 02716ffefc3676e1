// Data-sheet model of one joint's valve and cylinder: speed of a command at measured pressures.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "hydraulics/fluid.h"
#include "hydraulics/valve.h"

namespace leglab::feedforward {

// Nominal data; A is the cap side, B the rod side. Pressures are gauge.
struct CylinderSheet {
  double area_a = 0.0, area_b = 0.0;  // [m^2]
  double dead_volume_a = 0.0, dead_volume_b = 0.0, stroke = 0.0;  // [m^3], [m^3], [m]
  double orifice_gain = 0.0;                  // K of one metering edge [m^3/s/sqrt(Pa)]
  double laminar_transition_pressure = 0.0;   // [Pa]
  double lap = 0.0, edge_rounding = 0.0;      // shares of full spool travel
  double supply_pressure = 0.0, tank_pressure = 0.0;  // [Pa]
  double bulk_modulus = 0.0, entrained_air = 0.0, polytropic_index = 1.0;
  double full_speed = 1.0;                    // of the joint [rad/s]
  double position_start = 0.0, position_step = 1.0;  // positions of the tables' rows [rad]
  std::vector<double> lever, piston;          // tables of lever arm [m/rad] and piston position [m]
};

// Chamber pressures of one joint [Pa].
struct ChamberPressures {
  double a, b;
};

// At piston speed v and load force F the valve's flows Q satisfy w_A Q_A - w_B Q_B = dF/dt + k v plus
// leakage, with w_i = A_i beta_i/V_i, k = w_A A_A + w_B A_B (docs/concepts/adaptive_backstepping.md).
// The left side for a command, divided by k, is a speed, which `share` returns over full speed.
class PressureValve {
 public:
  explicit PressureValve(CylinderSheet sheet)
      : sheet_(std::move(sheet)),
        oil_{sheet_.entrained_air, 1.0 / sheet_.polytropic_index, 1.0 / sheet_.bulk_modulus},
        transition_(sheet_.laminar_transition_pressure * sheet_.laminar_transition_pressure) {}

  // Unit of load forces: force of the piston at nominal supply pressure on the cap side [N].
  double full_force() const { return sheet_.area_a * sheet_.supply_pressure; }

  // Coefficients at a position and supply pressure [Pa], valid near the given chamber pressures.
  struct Place {
    double sign, speed;       // sign of the lever; share of full speed per piston speed [s/m]
    double weight_a, weight_b, stiffness;
    double supply;
  };

  Place at(double position, const ChamberPressures& p, double supply) const {
    const double last = double(sheet_.lever.size()) - 1.0;
    double place = (position - sheet_.position_start) / sheet_.position_step;
    place = place > 0.0 ? std::min(place, last) : 0.0;  // also for NaN
    const std::size_t row = std::min(std::size_t(place), sheet_.lever.size() - 2);
    const double part = place - double(row);
    const auto between = [&](const std::vector<double>& table) {
      return table[row] + part * (table[row + 1] - table[row]);
    };
    const double lever = between(sheet_.lever), piston = between(sheet_.piston);
    Place out{};
    out.sign = lever < 0.0 ? -1.0 : 1.0;
    out.speed = 1.0 / (lever * sheet_.full_speed);
    const double volume_a = sheet_.area_a * piston + sheet_.dead_volume_a;
    const double volume_b = sheet_.area_b * (sheet_.stroke - piston) + sheet_.dead_volume_b;
    out.weight_a = sheet_.area_a * modulus(p.a) / volume_a;
    out.weight_b = sheet_.area_b * modulus(p.b) / volume_b;
    out.stiffness = sheet_.area_a * out.weight_a + sheet_.area_b * out.weight_b;
    out.supply = supply;
    return out;
  }

  // Load force, as a share of the full force, towards positive motion of the joint.
  double load(const Place& at, const ChamberPressures& p) const {
    return at.sign * (sheet_.area_a * p.a - sheet_.area_b * p.b) / full_force();
  }

  // Pressures for another load with the same common mode w_B p_A + w_A p_B, which piston motion
  // does not change.
  ChamberPressures with_load(const Place& at, const ChamberPressures& p, double load) const {
    const double force = at.sign * load * full_force();
    const double common = at.weight_b * p.a + at.weight_a * p.b;
    const double a = (sheet_.area_b * common + at.weight_a * force) / at.stiffness;
    const double b = (sheet_.area_a * common - at.weight_b * force) / at.stiffness;
    return {std::clamp(a, 0.0, at.supply), std::clamp(b, 0.0, at.supply)};
  }

  // Speed that the flow of a command causes, as a share of full speed.
  double share(const Place& at, const ChamberPressures& p, double command) const {
    const Slopes slope = slopes(at, p);
    const hydraulics::EdgeShape edge{sheet_.lap, sheet_.edge_rounding, 2.0};  // as `command` solves
    const double up = edge.opening(command), down = edge.opening(-command);
    return (slope.up * up - slope.down * down) / at.stiffness * at.speed;
  }

  // Command for a share of full speed, by Newton's method from the solution with one edge open.
  double command(const Place& at, const ChamberPressures& p, double share) const {
    const double rate = share * at.stiffness / at.speed;
    const Slopes slope = slopes(at, p);
    const double eps = sheet_.edge_rounding, quarter = 0.25 * eps * eps;
    const double one = (rate > 0.0 ? rate / slope.up : -rate / slope.down) + 0.3 * eps;
    double spool = std::copysign(std::max(sheet_.lap + one - quarter / one, 0.0), rate);
    for (int k = 0; k < 5; ++k) {
      const double d_up = spool - sheet_.lap, d_down = -spool - sheet_.lap;
      const double root_up = std::sqrt(d_up * d_up + eps * eps);
      const double root_down = std::sqrt(d_down * d_down + eps * eps);
      const double excess =
          0.5 * (slope.up * (d_up + root_up) - slope.down * (d_down + root_down)) - rate;
      const double rise =
          0.5 * (slope.up * (1.0 + d_up / root_up) + slope.down * (1.0 + d_down / root_down));
      spool = std::clamp(spool - excess / rise, -1.5, 1.5);
    }
    return spool;
  }

  // Speed losses by the leak paths A to B, A to outside and B to outside, as shares of full speed, for
  // paths with a unit leakage: the flow of full speed at nominal supply pressure.
  void leak(const Place& at, const ChamberPressures& p, double* out) const {
    const double scale = at.sign * sheet_.area_a / (at.stiffness * sheet_.supply_pressure);
    out[0] = scale * (at.weight_a + at.weight_b) * (p.a - p.b);
    out[1] = scale * at.weight_a * p.a;
    out[2] = -scale * at.weight_b * p.b;
  }

 private:
  // Rates of the load force per opening of the edges that extend (up) and retract (down) the piston.
  struct Slopes {
    double up, down;
  };

  Slopes slopes(const Place& at, const ChamberPressures& p) const {
    const double tank = sheet_.tank_pressure;
    return {at.weight_a * edge(at.supply - p.a) + at.weight_b * edge(p.b - tank),
            at.weight_a * edge(p.a - tank) + at.weight_b * edge(at.supply - p.b)};
  }

  // Flow per opening of an edge. A lower bound of the drop keeps the inverse from being singular.
  double edge(double drop) const {
    drop = std::max(drop, 0.02 * sheet_.supply_pressure);
    return sheet_.orifice_gain * drop / std::sqrt(std::sqrt(drop * drop + transition_));
  }

  double modulus(double gauge) const {
    const double absolute = std::max(gauge + hydraulics::kAtmosphere, hydraulics::kPressureFloor);
    return oil_.expand(absolute).bulk_modulus();
  }

  CylinderSheet sheet_;
  hydraulics::Oil oil_;
  double transition_;
};

}  // namespace leglab::feedforward
