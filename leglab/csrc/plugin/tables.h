// Tables of parameters and states of all plugins, for the plugins and for tools that read them by
// name.
#pragma once

#include <span>
#include <string>
#include <utility>

#include "hydraulics/friction.h"
#include "hydraulics/parameters.h"
#include "hydraulics/supply.h"

namespace leglab::plugin {

// Converts a unit at a hinge to the unit at a slide joint: N m/rad to N/m, rad/s to m/s.
inline std::string unit_at_slide(std::string unit) {
  for (const auto& [angular, linear] : {std::pair{"kg m^2", "kg"}, {"N m", "N"}, {"rad", "m"}}) {
    const std::size_t at = unit.find(angular);
    if (at != std::string::npos) unit.replace(at, std::string(angular).size(), linear);
  }
  return unit;
}

// X(name, unit, nominal, minimum, maximum, minimum_allowed, description) of parameters and
// X(name, unit, description) of states. Units at a joint are those at a hinge: see unit_at_slide.

#define LEGLAB_SPRING_PARAMETERS(X)                                                                \
  X(k1, "N m/rad", 0.0, -1e6, 1e6, true, "linear stiffness (Eq. 23); negative weakens a native spring") \
  X(k2, "N m/rad^3", 0.0, -1e6, 1e6, true, "hardening y^3 sin^2 y (Eq. 23)")                       \
  X(k3, "N m/rad^3", 0.0, -1e9, 1e9, true, "hardening y^3 (Duffing 1918)")                         \
  X(d1, "N m s/rad", 0.0, -1e5, 1e5, true, "linear damping (Eq. 23); negative weakens native damping") \
  X(quadratic_damping, "N m s^2/rad^2", 0.0, 0.0, 1e5, true, "damping with the speed squared")     \
  X(rest_position, "rad", 0.0, -100.0, 100.0, true, "joint position without spring force")         \
  X(force_offset, "N m", 0.0, -1e6, 1e6, true, "constant force")                                   \
  X(ripple_sine, "N m", 0.0, -1e6, 1e6, true, "times sin(2 pi q/ripple_period)")                   \
  X(ripple_cosine, "N m", 0.0, -1e6, 1e6, true, "times cos(2 pi q/ripple_period)")                 \
  X(ripple_sine_2, "N m", 0.0, -1e6, 1e6, true, "times sin(4 pi q/ripple_period)")                 \
  X(ripple_cosine_2, "N m", 0.0, -1e6, 1e6, true, "times cos(4 pi q/ripple_period)")               \
  X(ripple_period, "rad", 1.0, 0.0, 1e3, false, "of the force that repeats with the joint position") \
  X(stop_lower, "rad", -1e3, -1e3, 1e3, true, "below it the soft stop acts")                       \
  X(stop_upper, "rad", 1e3, -1e3, 1e3, true, "above it the soft stop acts")                        \
  X(stop_stiffness, "N m/rad", 0.0, 0.0, 1e9, true, "of the soft stops")                           \
  X(stop_damping, "N m s/rad", 0.0, 0.0, 1e6, true, "of the soft stops")
LEGLAB_TABLE(Spring, "leglab.spring_damper", LEGLAB_SPRING_PARAMETERS, LEGLAB_NONE, "joint", "strut")

#define LEGLAB_BACKLASH_PARAMETERS(X)                                                              \
  X(width, "rad", 0.0, 0.0, 10.0, true, "total play; 0 = rigid, no effect")                        \
  X(motor_inertia, "kg m^2", 0.0, 0.0, 1e6, true, "motor side, reflected; 0 = the joint's armature") \
  X(stiffness, "N m/rad", 1e5, 0.0, 1e12, false, "of a flank in contact")                          \
  X(damping_ratio, "1", 0.5, 0.0, 100.0, true, "of a flank in contact, with the reduced mass")

#define LEGLAB_BACKLASH_STATES(X)                                        \
  X(offset, "rad", "motor side less joint")                                                        \
  X(motor_velocity, "rad/s", "of the motor side")                                                  \
  X(transmitted, "N m", "from motor to joint over the last step")                                  \
  X(constraint, "N m", "of friction loss, limits and contacts on the joint over the last step")    \
  X(seated_width, "rad", "play of the last step; a new one seats anew on the loaded flank")
LEGLAB_TABLE(Backlash, "leglab.backlash", LEGLAB_BACKLASH_PARAMETERS, LEGLAB_BACKLASH_STATES, "joint")

// In the order in which a path's elements act on a command. The unit "ctrl" is the actuator's.
#define LEGLAB_COMMAND_PARAMETERS(X)                                                               \
  X(delay, "s", 0.0, 0.0, 1.0, true, "dead time, at most the attribute max_delay")                 \
  X(gain, "1", 1.0, -100.0, 100.0, true, "factor on the command")                                  \
  X(bias, "ctrl", 0.0, -1e6, 1e6, true, "added to the command")                                    \
  X(hysteresis, "ctrl", 0.0, 0.0, 1e6, true, "full width of a play")                               \
  X(dead_band, "ctrl", 0.0, 0.0, 1e6, true, "half width: below it nothing, above it u - dead_band") \
  X(dead_band_positive, "ctrl", 0.0, 0.0, 1e6, true, "added to the half width for u > 0")           \
  X(dead_band_negative, "ctrl", 0.0, 0.0, 1e6, true, "added to the half width for u < 0")           \
  X(gain_positive, "1", 1.0, 0.0, 100.0, true, "factor on what passes the dead band for u > 0")     \
  X(gain_negative, "1", 1.0, 0.0, 100.0, true, "factor on what passes the dead band for u < 0")     \
  X(time_constant, "s", 0.0, 0.0, 10.0, true, "first-order lag: bandwidth 1/(2 pi time_constant)") \
  X(servo_dead_band, "ctrl", 0.0, 0.0, 1e6, true,                                                  \
    "half width: position errors of a servo within it give no force, those beyond it less of it")   \
  X(actuator_gain, "1", 1.0, -100.0, 100.0, true, "factor on the force of the actuator")

// In the plugin state the commands of the last steps follow these states, newest first.
#define LEGLAB_COMMAND_STATES(X)                \
  X(started, "1", "1 after the first step")                                                        \
  X(play_output, "ctrl", "behind the hysteresis")                                                  \
  X(lag_output, "ctrl", "behind the lag")
LEGLAB_TABLE(Command, "leglab.command_path", LEGLAB_COMMAND_PARAMETERS, LEGLAB_COMMAND_STATES, "actuator",
             "max_delay")

// Plugin state: these, then the spline coefficients of position, velocity, load and command.
#define LEGLAB_RESIDUAL_PARAMETERS(X)                                                              \
  X(scale, "1", 1.0, -1e3, 1e3, true, "factor on the learned sum")                                 \
  X(bound, "N m", 1e9, 0.0, 1e9, true, "largest magnitude of the sum; of a cylinder in commands")

#define LEGLAB_RESIDUAL_STATES(X) X(load, "N m", "actuator force on the joint over the last step")
LEGLAB_TABLE(Residual, "leglab.residual", LEGLAB_RESIDUAL_PARAMETERS, LEGLAB_RESIDUAL_STATES, "joint",
             "cylinder", "actuator", "position_knots", "position_coefficients", "velocity_knots",
             "velocity_coefficients", "load_knots", "load_coefficients", "command_knots",
             "command_coefficients")

LEGLAB_TABLE(Sensor, "leglab.sensor", LEGLAB_NONE, LEGLAB_NONE, "actuator", "quantity")

struct PluginTable {
  const char* plugin;
  std::span<const hydraulics::ParameterSpec> parameters;
  std::span<const hydraulics::StateSpec> states;
  std::span<const char* const> texts;

  template <class Table>
  static constexpr PluginTable of() {
    return {Table::plugin, Table::parameters, Table::states, Table::texts};
  }
};

inline constexpr PluginTable kTables[] = {
    PluginTable::of<hydraulics::CylinderTable>(), PluginTable::of<hydraulics::SupplyTable>(),
    PluginTable::of<SpringTable>(),               PluginTable::of<hydraulics::FrictionTable>(),
    PluginTable::of<BacklashTable>(),             PluginTable::of<CommandTable>(),
    PluginTable::of<ResidualTable>(),             PluginTable::of<SensorTable>(),
};

}  // namespace leglab::plugin
