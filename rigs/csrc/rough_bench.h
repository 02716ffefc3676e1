// A knee bench for blind tests: one hinge, one cylinder, one valve, as ordinary differential
// equations of its own. Shares nothing with hydraulics/: an error there must not hide here.
//
// The laws of friction, orifice, edges, oil, valve and spring are chosen by number; 0 is the law that
// docs/concepts/physics.md states. SI units, pressures gauge.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace leglab::studies {

// X(name, value of the nominal bench).
#define LEGLAB_ROUGH_PARAMETERS(X)                                                             \
  /* Mechanics: inertia about the knee, weight and its centre, anchors of the cylinder. */     \
  X(inertia, 0.40) X(mass, 4.5) X(centre, 0.22) X(tilt, 0.0)                                   \
  X(thigh_x, -0.045) X(thigh_z, 0.30) X(shank_x, -0.045) X(shank_z, -0.02)                     \
  X(mid_length, 0.27718582981545115)                                                           \
  X(stop_stiffness, 2000.0) X(stop_damping, 20.0)                                              \
  X(spring_law, 0.0) X(k1, 25.0) X(k2, 60.0) X(rest_position, 0.9) X(d1, 0.6)                  \
  X(quadratic_damping, 0.0)                                                                    \
  /* Torques of position: two with amplitude, period, phase, the second one with a share of its   \
     second harmonic; a hose; a constant. */                                                    \
  X(cogging, 0.0) X(cogging_period, 1.0) X(cogging_phase, 0.0)                                 \
  X(wave, 0.0) X(wave_second, 0.0) X(wave_period, 1.0) X(wave_phase, 0.0)                      \
  X(hose_stiffness, 0.0) X(hose_rest, 0.9) X(force_offset, 0.0)                                \
  /* Friction of the joint: per load, Coulomb in one direction; loss where load drives or brakes. */ \
  X(load_friction, 0.0) X(load_loss_driving, 0.0) X(load_loss_braking, 0.0)                    \
  X(joint_forward, 0.0) X(joint_backward, 0.0) X(joint_speed, 0.01)                            \
  /* Piston. */                                                                                \
  X(area_a, 2.0106192982974676e-4) X(area_b, 1.2252211349000193e-4) X(stroke, 0.080)           \
  X(dead_volume_a, 2.903e-6) X(dead_volume_b, 1.676e-6)                                        \
  X(play, 0.0) X(rod_mass, 1.5) X(contact_stiffness, 3e7) X(contact_damping, 6e3)              \
  /* Seal friction. Laws: 0 LuGre, 1 tanh, 2 Dahl, 3 elasto-plastic. */                        \
  X(friction_law, 0.0) X(sigma_0, 2e6) X(sigma_1, 2e3) X(viscous, 700.0) X(coulomb, 100.0)     \
  X(static_friction, 150.0) X(stribeck_velocity, 0.014) X(stribeck_exponent, 2.0)              \
  X(viscous_exponent, 1.0) X(pressure_coefficient, 0.0) X(friction_asymmetry, 0.0)             \
  X(viscous_asymmetry, 0.0) X(tanh_speed, 0.002)                                               \
  /* Added to Coulomb and static, and to viscous friction while the piston extends or retracts. */ \
  X(coulomb_extending, 0.0) X(coulomb_retracting, 0.0)                                         \
  X(viscous_extending, 0.0) X(viscous_retracting, 0.0)                                         \
  /* Leakage; its part that grows with the pressure difference [1/Pa]. */                      \
  X(internal_leakage, 1.7e-13) X(leakage_growth, 0.0)                                          \
  X(external_leakage_a, 0.0) X(external_leakage_b, 0.0)                                        \
  /* Valve. Dynamics: 0 second order, 1 first order; both with a limit of speed. */            \
  X(valve_law, 0.0) X(bandwidth_hz, 250.0) X(damping_ratio, 0.7) X(slew, 1e6)                  \
  X(null_bias, 0.0) X(hysteresis, 0.0) X(command_delay, 0.0)                                   \
  /* Edges: 0 hyperbola, 1 sharp over a clearance, 2 logarithmic. */                           \
  X(edge_law, 0.0) X(lap_pa, 0.02) X(lap_at, 0.02) X(lap_pb, 0.02) X(lap_bt, 0.02)             \
  X(edge_rounding, 0.0216) X(edge_clearance, 0.0) X(port_curvature, 0.0)                            \
  X(rated_flow, 1.25e-4) X(rated_pressure_drop, 7e6) X(gain_positive, 1.0) X(gain_negative, 1.0) \
  /* Orifice: 0 smooth root, 1 cubic below the transition, 2 root of a shifted drop. */        \
  X(orifice_law, 0.0) X(transition_pressure, 1e5) X(flow_exponent, 0.5)                        \
  /* Oil: 0 gas and liquid side by side, 1 rising linearly, 2 dissolving air, 3 saturating. */ \
  X(oil_law, 0.0) X(bulk_modulus, 1.4e9) X(entrained_air, 0.005) X(polytropic_index, 1.4)      \
  X(oil_start, 0.6) X(oil_reach, 5e6) X(added_air, 0.0)                                        \
  /* Supply: pressure falls by droop times flow, slowed by a gas volume. */                    \
  X(supply_pressure, 16e6) X(tank_pressure, 0.0) X(droop, 0.0) X(gas_volume, 3e-5)             \
  X(ripple, 0.0) X(ripple_hz, 40.0)                                                            \
  /* Sensors and the loop. */                                                                  \
  X(encoder_scale, 1.0) X(encoder_offset, 0.0) X(encoder_delay, 0.0)                           \
  X(encoder_counts, 131072.0)                                                                  \
  X(pressure_scale_a, 1.0) X(pressure_scale_b, 1.0) X(pressure_offset_a, 0.0)                  \
  X(pressure_offset_b, 0.0) X(loop_gain, 0.5) X(feedforward, 0.031)

struct RoughParameters {
#define X(name, value) double name = value;
  LEGLAB_ROUGH_PARAMETERS(X)
#undef X
};

// Knee angle and speed, spool and its speed, pressures, bristle, supply pressure, piston and its
// speed (both used only where there is play).
enum RoughState { kAngle, kSpeed, kSpool, kSpoolSpeed, kA, kB, kBristle, kSupply, kPiston,
                  kPistonSpeed, kStates };
using RoughVector = std::array<double, kStates>;

class RoughEquations {
 public:
  explicit RoughEquations(const RoughParameters& p)
      : p_(p), edge_(p.rated_flow / std::sqrt(0.5 * p.rated_pressure_drop)) {}

  const RoughParameters& parameters() const { return p_; }

  struct Lever { double x, arm; };  // piston position from the cap end, and its derivative

  Lever lever(double q) const {
    const double c = std::cos(q), s = std::sin(q);
    const double dx = p_.shank_x * c + p_.shank_z * s - p_.thigh_x;
    const double dz = -p_.shank_x * s + p_.shank_z * c - p_.thigh_z;
    const double length = std::hypot(dx, dz);
    const double ddx = -p_.shank_x * s + p_.shank_z * c;
    const double ddz = -p_.shank_x * c - p_.shank_z * s;
    return {0.5 * p_.stroke + length - p_.mid_length, (dx * ddx + dz * ddz) / length};
  }

  // `command` is what reaches the spool: late and behind the hysteresis.
  RoughVector derivative(double t, const RoughVector& y, double command) const {
    const Lever lever = this->lever(y[kAngle]);
    const bool loose = p_.play > 0.0;
    const double x = loose ? y[kPiston] : lever.x;
    const double v = loose ? y[kPistonSpeed] : lever.arm * y[kSpeed];
    const double a = y[kA], b = y[kB];
    const double supply = y[kSupply] + p_.ripple * std::sin(2.0 * M_PI * p_.ripple_hz * t);
    RoughVector d{};
    d[kAngle] = y[kSpeed];

    const double goal = std::clamp(command + p_.null_bias, -1.0, 1.0);
    const double rate = 2.0 * M_PI * p_.bandwidth_hz;
    if (p_.valve_law == 1.0) {
      d[kSpool] = std::clamp(rate * (goal - y[kSpool]), -p_.slew, p_.slew);
    } else {
      const double speed = y[kSpoolSpeed];
      d[kSpool] = std::clamp(speed, -p_.slew, p_.slew);
      d[kSpoolSpeed] = rate * rate * (goal - y[kSpool]) - 2.0 * p_.damping_ratio * rate * speed;
      if (std::abs(speed) > p_.slew && speed * d[kSpoolSpeed] > 0.0) d[kSpoolSpeed] = 0.0;
    }

    const double s = y[kSpool];
    // Of the two edges that open for a positive spool, and of the two others; each leaks by its own.
    const double forward = edge_ * p_.gain_positive, backward = edge_ * p_.gain_negative;
    const double from_supply_a = forward * opening(s - p_.lap_pa) * orifice(supply - a);
    const double to_tank_a = backward * opening(-s - p_.lap_at) * orifice(a - p_.tank_pressure);
    const double from_supply_b = backward * opening(-s - p_.lap_pb) * orifice(supply - b);
    const double to_tank_b = forward * opening(s - p_.lap_bt) * orifice(b - p_.tank_pressure);
    const double across =
        p_.internal_leakage * (a - b) * (1.0 + p_.leakage_growth * std::abs(a - b));
    const double flow_a = from_supply_a - to_tank_a - across - p_.external_leakage_a * a;
    const double flow_b = from_supply_b - to_tank_b + across - p_.external_leakage_b * b;
    const double volume_a = p_.dead_volume_a + p_.area_a * std::max(x, 0.0);
    const double volume_b = p_.dead_volume_b + p_.area_b * std::max(p_.stroke - x, 0.0);
    d[kA] = bulk_modulus(a) / volume_a * (flow_a - p_.area_a * v);
    d[kB] = bulk_modulus(b) / volume_b * (flow_b + p_.area_b * v);
    if (a < kVapour && d[kA] < 0.0) d[kA] = 0.0;
    if (b < kVapour && d[kB] < 0.0) d[kB] = 0.0;

    if (p_.droop > 0.0) {
      const double n = 1.4, absolute = std::max(y[kSupply], 1e5) + kAir;
      const double gas = p_.gas_volume * std::pow((1e7 + kAir) / absolute, 1.0 / n);
      const double pump = std::max((p_.supply_pressure - y[kSupply]) / p_.droop, 0.0);
      d[kSupply] = n * absolute / gas * (pump - from_supply_a - from_supply_b);
    }

    const double force = p_.area_a * a - p_.area_b * b - friction(v, a + b, y[kBristle], d[kBristle]);
    double load = force;
    if (loose) {
      const double gap = y[kPiston] - lever.x, closing = v - lever.arm * y[kSpeed];
      load = contact(gap, closing);
      d[kPiston] = v;
      d[kPistonSpeed] = (force - load) / p_.rod_mass;
    }
    d[kSpeed] = (lever.arm * load + joint_torque(y[kAngle], y[kSpeed], lever.arm * load)) / p_.inertia;
    return d;
  }

  RoughVector step(double t, const RoughVector& y, double command, double h) const {
    const auto along = [&](const RoughVector& slope, double dt) {
      RoughVector out;
      for (std::size_t i = 0; i < kStates; ++i) out[i] = y[i] + dt * slope[i];
      return out;
    };
    const RoughVector k1 = derivative(t, y, command);
    const RoughVector k2 = derivative(t + 0.5 * h, along(k1, 0.5 * h), command);
    const RoughVector k3 = derivative(t + 0.5 * h, along(k2, 0.5 * h), command);
    const RoughVector k4 = derivative(t + h, along(k3, h), command);
    RoughVector out;
    for (std::size_t i = 0; i < kStates; ++i) {
      out[i] = y[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
    if (std::abs(out[kSpool]) > 1.0) {  // end stops of the spool
      out[kSpool] = std::copysign(1.0, out[kSpool]);
      if (out[kSpool] * out[kSpoolSpeed] > 0.0) out[kSpoolSpeed] = 0.0;
    }
    out[kA] = std::max(out[kA], kVapour);
    out[kB] = std::max(out[kB], kVapour);
    return out;
  }

  // Near equilibrium in the middle of the stroke's pressures; `settle` of the caller does the rest.
  RoughVector rest(double q) const {
    RoughVector y{};
    y[kAngle] = q;
    y[kSupply] = p_.supply_pressure;
    y[kB] = 0.5 * p_.supply_pressure;
    y[kA] = y[kB] * p_.area_b / p_.area_a;
    y[kPiston] = lever(q).x;
    return y;
  }

 private:
  static constexpr double kAir = 101325.0, kVapour = -0.98 * 101325.0;

  double opening(double d) const {
    const double e = p_.edge_rounding;
    double w;
    if (p_.edge_law == 1.0) {
      w = std::hypot(std::max(d, 0.0), p_.edge_clearance);
    } else if (p_.edge_law == 2.0) {
      const double scale = 0.75 * e, r = d / scale;  // as open at d = 0 as the hyperbola
      w = r > 30.0 ? d : scale * std::log1p(std::exp(r));
    } else {
      w = 0.5 * (d + std::sqrt(d * d + e * e));
    }
    return w * (1.0 + p_.port_curvature * std::max(d, 0.0));
  }

  double orifice(double drop) const {
    const double c = p_.transition_pressure, size = std::abs(drop);
    double root;
    if (p_.orifice_law == 1.0) {
      const double r = size / c;
      root = r > 1.0 ? std::sqrt(size) : std::sqrt(c) * r * (1.25 - 0.25 * r * r);
    } else if (p_.orifice_law == 2.0) {
      const double shift = 0.125 * c, half = 0.5 * p_.rated_pressure_drop;
      root = std::sqrt(size + shift) - std::sqrt(shift);
      root *= std::sqrt(half) / (std::sqrt(half + shift) - std::sqrt(shift));
    } else {
      root = size / std::sqrt(std::sqrt(size * size + c * c));
    }
    if (p_.flow_exponent != 0.5) {
      const double half = 0.5 * p_.rated_pressure_drop;
      root *= std::pow((size + c) / half, p_.flow_exponent - 0.5);
    }
    return std::copysign(root, drop);
  }

  double bulk_modulus(double pressure) const {
    const double p = std::max(pressure + kAir, 0.02 * kAir), n = p_.polytropic_index;
    const double liquid = p_.bulk_modulus;
    double air = p_.entrained_air, stiff = liquid;
    if (p_.oil_law == 1.0) {
      const double share = p_.oil_start + (1.0 - p_.oil_start) * pressure / p_.oil_reach;
      stiff = liquid * std::clamp(share, 0.1, 1.0);
      air = 0.05 * air;
    } else if (p_.oil_law == 2.0) {
      air *= std::clamp(1.0 - pressure / p_.oil_reach, 0.0, 1.0);
    } else if (p_.oil_law == 3.0) {
      stiff = liquid * (1.0 - (1.0 - p_.oil_start) * std::exp(-std::max(pressure, 0.0) / p_.oil_reach));
      air = 0.05 * air;
    }
    air += p_.added_air;
    const double gas = air * std::pow(kAir / p, 1.0 / n);
    const double oil = (1.0 - air) * std::exp(-(p - kAir) / stiff);
    return (gas + oil) / (gas / (n * p) + oil / stiff);
  }

  // Force against the motion; writes the derivative of the bristle's deflection.
  double friction(double v, double pressures, double z, double& rate) const {
    const double speed = std::abs(v), sense = v < 0.0 ? -1.0 : 1.0;
    const bool dahl = p_.friction_law == 2.0;
    const double bump =
        std::exp(-std::pow(speed / p_.stribeck_velocity, p_.stribeck_exponent));
    double g = p_.coulomb + p_.pressure_coefficient * std::max(pressures, 0.0) +
               (p_.static_friction - p_.coulomb) * bump;
    g = g * (1.0 + sense * p_.friction_asymmetry) +
        (v < 0.0 ? p_.coulomb_retracting : p_.coulomb_extending);
    g = std::max(g, 1.0);
    double viscous = p_.viscous * (1.0 + sense * p_.viscous_asymmetry) * v;
    viscous += (v < 0.0 ? p_.viscous_retracting : p_.viscous_extending) * v;
    if (p_.viscous_exponent != 1.0) {
      viscous *= std::pow((v * v + 1e-4) / 0.0101, 0.5 * (p_.viscous_exponent - 1.0));
    }
    rate = 0.0;
    if (p_.friction_law == 1.0) return g * std::tanh(v / p_.tanh_speed) + viscous;
    double share = 1.0;
    if (p_.friction_law == 3.0) {
      const double end = g / p_.sigma_0, begin = 0.7 * end;
      share = 0.0;
      if (v * z > 0.0 && std::abs(z) > begin) {
        share = 0.5 - 0.5 * std::cos(M_PI * std::min((std::abs(z) - begin) / (end - begin), 1.0));
      }
    }
    rate = v - share * p_.sigma_0 * speed * z / g;
    return p_.sigma_0 * z + (dahl ? 0.0 : p_.sigma_1 * rate) + viscous;
  }

  double contact(double gap, double closing) const {
    const double half = 0.5 * p_.play;
    if (gap > half) {
      return std::max(p_.contact_stiffness * (gap - half) + p_.contact_damping * closing, 0.0);
    }
    if (gap < -half) {
      return std::min(p_.contact_stiffness * (gap + half) + p_.contact_damping * closing, 0.0);
    }
    return 0.0;
  }

  double joint_torque(double q, double w, double load) const {
    const double turn = 2.0 * M_PI, y = q - p_.rest_position, sine = std::sin(y);
    double torque = -9.81 * p_.mass * p_.centre * std::sin(q + p_.tilt);
    const double hard = p_.spring_law == 1.0 ? 0.92 * y * y : sine * sine;
    torque -= p_.k1 * y + p_.k2 * y * y * y * hard + p_.d1 * w + p_.quadratic_damping * w * std::abs(w);
    torque += p_.cogging * std::sin(turn * q / p_.cogging_period + p_.cogging_phase);
    const double angle = turn * q / p_.wave_period + p_.wave_phase;
    torque += p_.wave * (std::sin(angle) + p_.wave_second * std::sin(2.0 * angle));
    torque += p_.force_offset - p_.hose_stiffness * (q - p_.hose_rest);
    const double sense = std::tanh(w / p_.joint_speed);
    torque -= sense * (p_.load_friction * std::abs(load) + (w > 0.0 ? p_.joint_forward : p_.joint_backward));
    torque -= sense * std::abs(load) * (load * w > 0.0 ? p_.load_loss_driving : p_.load_loss_braking);
    if (q < 0.0) torque -= p_.stop_stiffness * q + p_.stop_damping * w;
    if (q > 1.8) torque -= p_.stop_stiffness * (q - 1.8) + p_.stop_damping * w;
    return torque;
  }

  RoughParameters p_;
  double edge_;
};

// Samples at the period of the references.
struct RoughTrace {
  std::vector<double> position, command, pressure_a, pressure_b;
};

// The bench between samples: commands that reach the valve late, its hysteresis, and its encoder.
class RoughPlant {
 public:
  RoughPlant(const RoughParameters& p, double step) : equations_(p), step_(step) {}

  const RoughParameters& parameters() const { return equations_.parameters(); }
  const RoughVector& state() const { return y_; }

  // Rests where the encoder shows this angle.
  void start(double angle) {
    y_ = equations_.rest((angle - parameters().encoder_offset) / parameters().encoder_scale);
    angles_.assign(1, y_[kAngle]);
    commands_.clear();
    behind_ = 0.0;
  }

  // Is another bench from now on.
  void change(const RoughParameters& p) { equations_ = RoughEquations(p); }

  void advance(double command, int steps) {
    const RoughParameters& p = parameters();
    const std::size_t late = std::size_t(std::lround(p.command_delay / step_));
    for (int i = 0; i < steps; ++i) {
      const std::size_t now = commands_.size();
      commands_.push_back(command);
      const double u = commands_[now < late ? 0 : now - late];
      behind_ = std::clamp(behind_, u - 0.5 * p.hysteresis, u + 0.5 * p.hysteresis);
      y_ = equations_.step(double(now) * step_, y_, behind_, step_);
      angles_.push_back(y_[kAngle]);
    }
  }

  // What the encoder shows now.
  double seen(double noise) const {
    const RoughParameters& p = parameters();
    const std::size_t late = static_cast<std::size_t>(std::lround(p.encoder_delay / step_));
    const double angle = angles_[angles_.size() - 1 - std::min(late, angles_.size() - 1)];
    const double value = p.encoder_scale * angle + p.encoder_offset + noise;
    const double count = 2.0 * M_PI / p.encoder_counts;
    return p.encoder_counts > 0.0 ? std::rint(value / count) * count : value;
  }

 private:
  RoughEquations equations_;
  double step_, behind_ = 0.0;
  RoughVector y_{};
  std::vector<double> angles_, commands_;  // at every step
};

// Follows a reference, or plays a command where there is one, from rest at the first reference, and
// records. Noise: one value a sample.
inline RoughTrace run(const RoughParameters& p, double period, int steps, const double* reference,
                      const double* played, const double* position_noise, const double* noise_a,
                      const double* noise_b, std::size_t count) {
  RoughPlant plant(p, period / steps);
  plant.start(reference[0]);
  const int settling = static_cast<int>(std::lround(1.0 / period));
  for (int k = 0; k < settling; ++k) {
    plant.advance(-p.loop_gain * (reference[0] - plant.seen(0.0)), steps);
  }
  RoughTrace trace;
  for (std::size_t k = 0; k < count; ++k) {
    const double measured = plant.seen(position_noise[k]);
    const std::size_t after = std::min(k + 1, count - 1), before = k > 0 ? k - 1 : 0;
    const double rate = (reference[after] - reference[before]) / (double(after - before) * period);
    const double wanted = -p.loop_gain * (reference[k] - measured) - p.feedforward * rate;
    const double command = played ? played[k] : std::clamp(wanted, -1.0, 1.0);
    const RoughVector& y = plant.state();
    trace.position.push_back(measured);
    trace.command.push_back(command);
    trace.pressure_a.push_back(p.pressure_scale_a * y[kA] + p.pressure_offset_a + noise_a[k]);
    trace.pressure_b.push_back(p.pressure_scale_b * y[kB] + p.pressure_offset_b + noise_b[k]);
    plant.advance(command, steps);
  }
  return trace;
}

}  // namespace leglab::studies
