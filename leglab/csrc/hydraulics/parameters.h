// Physical parameters as plain tables: one row gives name, unit, default, bounds and source.
#pragma once

#include <array>
#include <cstddef>
#include <initializer_list>

namespace leglab::hydraulics {

struct ParameterSpec {
  const char* name;
  const char* unit;
  double nominal;  // default; NaN if the attribute is required
  double minimum;
  double maximum;
  bool minimum_allowed;  // false: the bound itself is excluded
  const char* description;
};

struct StateSpec {
  const char* name;
  const char* unit;
  const char* description;
};

inline constexpr double kRequired = __builtin_nan("");

#define LEGLAB_FIELD(name, ...) double name##_;
#define LEGLAB_ONE(...) +1
#define LEGLAB_PARAMETER_ROW(name, unit, nominal, lo, hi, closed, text) \
  {#name, unit, nominal, lo, hi, closed, text},
#define LEGLAB_STATE_ROW(name, unit, text) {#name, unit, text},
#define LEGLAB_NONE(X)

// Defines, from the lists PARAMETERS(X) and STATES(X) of a plugin, the structs NameParameters and
// NameState, which follow each other at the head of its plugin state, and NameTable, which describes
// them. The arguments after the lists are the plugin's text attributes.
#define LEGLAB_TABLE(Name, plugin_name, PARAMETERS, STATES, ...)                               \
  struct Name##Parameters {                                                                    \
    PARAMETERS(LEGLAB_FIELD)                                                                   \
  };                                                                                           \
  struct Name##State {                                                                         \
    STATES(LEGLAB_FIELD)                                                                       \
  };                                                                                           \
  struct Name##Table {                                                                         \
    using Parameters = Name##Parameters;                                                       \
    using State = Name##State;                                                                 \
    static constexpr const char* plugin = plugin_name;                                         \
    static constexpr std::size_t parameter_count = 0 PARAMETERS(LEGLAB_ONE);                   \
    static constexpr std::size_t state_count = 0 STATES(LEGLAB_ONE);                           \
    static constexpr std::array<hydraulics::ParameterSpec, parameter_count> parameters{        \
        {PARAMETERS(LEGLAB_PARAMETER_ROW)}};                                                   \
    static constexpr std::array<hydraulics::StateSpec, state_count> states{                    \
        {STATES(LEGLAB_STATE_ROW)}};                                                           \
    static constexpr std::initializer_list<const char*> texts = {__VA_ARGS__};                 \
  };

// X(name, unit, nominal, minimum, maximum, minimum_allowed, description)
// Sources: [HyQ] Ledezma et al. 2016, HyQ leg parameter scripts; [V] vendor data of an E024-class
// servovalve; [ISO] ISO 3448 grades; [C] choice of this project. Notes on several of them are in
// docs/concepts/physics.md.
#define LEGLAB_CYLINDER_PARAMETERS(X)                                                              \
  X(bore, "m", kRequired, 1e-3, 0.5, true, "piston diameter, cap side")                            \
  X(rod, "m", kRequired, 0.0, 0.5, true, "rod diameter; smaller than the bore")                    \
  X(stroke, "m", kRequired, 1e-3, 5.0, true, "piston travel between the end stops")                \
  X(mid_length, "m", kRequired, -10.0, 10.0, true, "actuator length with the piston at mid stroke")\
  X(dead_volume_a, "m^3", 2.903e-6, 0.0, 1e-2, false, "cap-side volume at x = 0 [HyQ]")            \
  X(dead_volume_b, "m^3", 1.676e-6, 0.0, 1e-2, false, "rod-side volume at x = stroke [HyQ]")       \
  X(stop_stiffness, "N/m", 2e6, 0.0, 1e9, true, "end-stop stiffness beyond [0, stroke] [C]")       \
  X(stop_damping, "N s/m", 2e3, 0.0, 1e7, true, "end-stop damping, never pulling [C]")             \
  X(internal_leakage, "m^3/s/Pa", 1.7e-13, 0.0, 1e-9, true, "at 40 C, unworn seal [HyQ]")          \
  X(external_leakage_a, "m^3/s/Pa", 0.0, 0.0, 1e-9, true, "chamber A to outside, at 40 C")         \
  X(external_leakage_b, "m^3/s/Pa", 0.0, 0.0, 1e-9, true, "chamber B to outside, at 40 C")         \
  X(seal_wear_rate, "1/m", 0.0, 0.0, 1.0, true, "growth of seal_clearance per metre slid [C]")     \
  X(sigma_0, "N/m", 2e6, 0.0, 1e9, true, "LuGre bristle stiffness [C]")                            \
  X(sigma_1, "N s/m", 2e3, 0.0, 1e6, true, "LuGre bristle damping [C]")                            \
  X(viscous, "N s/m", 700.0, 0.0, 1e6, true, "viscous friction at 40 C [HyQ]")                     \
  X(coulomb, "N", 100.0, 0.0, 1e5, true, "Coulomb friction [HyQ]")                                 \
  X(static, "N", 150.0, 0.0, 1e5, true, "breakaway friction, at least coulomb [C]")                \
  X(stribeck_velocity, "m/s", 0.014, 0.0, 10.0, false, "Stribeck velocity [HyQ]")                  \
  X(stribeck_exponent, "1", 2.0, 0.1, 20.0, true, "n of exp(-|v/v_s|^n): how steeply friction falls")\
  X(viscous_difference, "N s/m", 0.0, -1e6, 1e6, true, "viscous friction extending less retracting")\
  X(coulomb_difference, "N", 0.0, -1e5, 1e5, true, "Coulomb and breakaway friction extending less retracting")\
  X(pressure_coefficient, "N/Pa", 0.0, 0.0, 1e-2, true, "friction per unit of pA + pB")            \
  X(play, "m", 0.0, 0.0, 0.1, true, "between rod end and pin, along the rod; 0 = none")            \
  X(play_stiffness, "N/m", 5e7, 0.0, 1e12, false, "of rod end and pin in contact [C]")             \
  X(piston_mass, "kg", 0.5, 0.0, 1e4, false, "of piston and rod; matters in the play only [C]")    \
  X(rated_flow, "m^3/s", 1.25e-4, 0.0, 1e-1, false, "at rated_pressure_drop over both edges [V]")  \
  X(rated_pressure_drop, "Pa", 7e6, 0.0, 1e8, false, "both edges together [V]")                    \
  X(flow_asymmetry, "1", 0.0, -0.9, 0.9, true, "relative gain: 1 + a for x_s > 0, 1 - a below")    \
  X(bandwidth_hz, "Hz", 250.0, 0.0, 1e4, false, "natural frequency of the spool [V]")              \
  X(damping_ratio, "1", 0.7, 0.0, 10.0, false, "damping ratio of the spool [V]")                   \
  X(lap, "1", 0.02, -0.5, 0.9, true, "overlap of each metering edge, of full spool travel")        \
  X(lap_difference_tank, "1", 0.0, -0.5, 0.5, true, "overlap of the edges to the tank less those to the supply") \
  X(lap_difference_chambers, "1", 0.0, -0.5, 0.5, true, "overlap of A's edges less B's")           \
  X(edge_rounding, "1", 0.0216, 0.0, 0.5, true, "eps: null leak 0.28 l/min at 210 bar [V]")        \
  X(edge_exponent, "1", 2.0, 1.0, 20.0, true, "n of the rounding: how soon an edge shuts behind its lap") \
  X(null_bias, "1", 0.0, -1.0, 1.0, true, "null shift, added to the command")                      \
  X(hysteresis, "1", 0.0, 0.0, 1.0, true, "full width of the play between command and spool")      \
  X(laminar_transition_pressure, "Pa", 1e5, 0.0, 1e8, false, "dp_cr of the orifice")               \
  X(supply_pressure, "Pa", 16e6, 0.0, 1e8, true, "gauge; ignored where `supply` names an instance")\
  X(tank_pressure, "Pa", 0.0, 0.0, 1e7, true, "gauge")                                             \
  X(bulk_modulus, "Pa", 1.4e9, 1e6, 1e11, true, "of the air-free oil")                             \
  X(entrained_air, "1", 0.005, 0.0, 0.5, true, "volume fraction at atmospheric pressure; 0 = none")\
  X(polytropic_index, "1", 1.4, 1.0, 2.0, true, "of the entrained air")                            \
  X(viscosity_40, "m^2/s", 46e-6, 1e-6, 1e-2, true, "kinematic viscosity at 40 C [ISO] VG 46")     \
  X(viscosity_100, "m^2/s", 6.8e-6, 5e-7, 1e-2, true, "kinematic viscosity at 100 C")              \
  X(density, "kg/m^3", 875.0, 500.0, 2000.0, true, "of the oil at 15 C")                           \
  X(thermal_capacity, "J/K", 0.0, 0.0, 1e7, true, "of the oil and the metal around; 0 = isothermal")\
  X(heat_transfer, "W/K", 1.0, 0.0, 1e5, true, "to the surroundings")                              \
  X(ambient_temperature, "degC", 20.0, -60.0, 150.0, true, "of the surroundings")                  \
  X(initial_pressure_a, "Pa", 6e6, 0.0, 1e8, true, "gauge, after a reset")                         \
  X(initial_pressure_b, "Pa", 9.846e6, 0.0, 1e8, true, "gauge, after a reset")                     \
  X(substeps, "1", 2.0, 1.0, 64.0, true, "hydraulic sub-steps in a time step")                     \
  /* the plugin itself changes the next two parameters */                                          \
  X(seal_clearance, "1", 1.0, 0.0, 100.0, true, "relative to the new seal; leakage grows with its cube") \
  X(oil_temperature, "degC", 40.0, -40.0, 150.0, true, "of the oil in the cylinder")

// Dynamic states of one valve-controlled cylinder, stored after its parameters.
// X(name, unit, description)
#define LEGLAB_CYLINDER_STATES(X)                                                    \
  X(pressure_a, "Pa", "gauge, cap side")                                             \
  X(pressure_b, "Pa", "gauge, rod side")                                             \
  X(amount_a, "m^3", "oil in A as its volume at atmospheric pressure; 0 = from pressure_a") \
  X(amount_b, "m^3", "oil in B as its volume at atmospheric pressure; 0 = from pressure_b") \
  X(spool_position, "1", "relative, in [-1, 1]")                                     \
  X(spool_velocity, "1/s", "")                                                       \
  X(play_output, "1", "command behind the hysteresis")                               \
  X(bristle, "m", "LuGre bristle deflection z")                                      \
  X(load, "N", "all other forces on the piston over the last step")                  \
  X(previous_load, "N", "the same over the step before")                             \
  X(play_offset, "m", "piston less pin, within half the play while nothing is pressed") \
  X(piston_velocity, "m/s", "of the piston, where there is play")                    \
  X(pin_load, "N", "all other forces on the mechanism over the last step, where there is play") \
  X(seated_play, "m", "play of the last step; another one seats the piston anew")    \
  X(sliding_distance, "m", "path of the piston since the reset")                     \
  X(flow_a, "m^3/s", "valve to chamber A, mean over the last step")                  \
  X(flow_b, "m^3/s", "valve to chamber B, mean over the last step")                  \
  X(supply_flow, "m^3/s", "drawn from the supply, mean over the last step")          \
  X(energy_supply, "J", "taken from the supply less given to the tank")              \
  X(energy_valve, "J", "lost at the metering edges")                                 \
  X(energy_leakage, "J", "lost in the leakage gaps")                                 \
  X(energy_friction, "J", "lost in seal friction and end stops")                     \
  X(energy_stored, "J", "integral of p V / beta dp")                                 \
  X(energy_load, "J", "work done on the mechanism")

LEGLAB_TABLE(Cylinder, "leglab.cylinder", LEGLAB_CYLINDER_PARAMETERS, LEGLAB_CYLINDER_STATES, "supply")

}  // namespace leglab::hydraulics
