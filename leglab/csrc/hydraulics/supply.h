// Hydraulic power unit: constant pressure, or pump, relief valve and accumulator.
#pragma once

#include <algorithm>
#include <cmath>

#include "fluid.h"
#include "parameters.h"

namespace leglab::hydraulics {

#define LEGLAB_SUPPLY_PARAMETERS(X)                                                               \
  X(supply_pressure, "Pa", 16e6, 0.0, 1e8, true, "gauge; what the pump compensator holds")        \
  X(accumulator_volume, "m^3", 0.0, 0.0, 1e-1, true, "gas volume at precharge; 0 = constant pressure") \
  X(accumulator_precharge, "Pa", 1e7, 1e5, 1e8, true, "gauge")                                    \
  X(polytropic_index, "1", 1.4, 1.0, 2.0, true, "of the accumulator gas")                         \
  X(pump_flow, "m^3/s", 2e-4, 0.0, 1e-1, true, "largest flow of the pump")                        \
  X(compensator_gain, "m^3/s/Pa", 1e-10, 0.0, 1e-6, true, "pump flow per pressure deficit [C]")

#define LEGLAB_SUPPLY_STATES(X)                                              \
  X(pressure, "Pa", "gauge; 0 before the first step = supply_pressure")      \
  X(delivered, "m^3", "drawn by the cylinders since the reset")              \
  X(started, "1", "1 after the first step")

LEGLAB_TABLE(Supply, "leglab.supply", LEGLAB_SUPPLY_PARAMETERS, LEGLAB_SUPPLY_STATES)

inline double supply_pressure_now(const SupplyParameters& p, const SupplyState& s) {
  return s.started_ != 0.0 && p.accumulator_volume_ > 0.0 ? s.pressure_ : p.supply_pressure_;
}

// Accumulator gas p V^n = constant, charged by the pump and emptied by the cylinders.
inline void advance_supply(const SupplyParameters& p, double demand, double timestep,
                           SupplyState& s) {
  const double pressure = supply_pressure_now(p, s);
  s.delivered_ += demand * timestep;
  s.started_ = 1.0;
  s.pressure_ = p.supply_pressure_;
  if (p.accumulator_volume_ == 0.0) return;
  const double precharge = p.accumulator_precharge_ + kAtmosphere;
  const double absolute = pressure + kAtmosphere;
  const double gas = p.accumulator_volume_ * std::pow(precharge / absolute, 1.0 / p.polytropic_index_);
  // The compensator is stiff and therefore solved implicitly in the pressure: dp/dV = -n p / V_gas.
  const double stiffness = p.polytropic_index_ * absolute / gas;
  const double wanted = (p.compensator_gain_ * (p.supply_pressure_ - pressure) +
                         p.compensator_gain_ * stiffness * timestep * demand) /
                        (1.0 + p.compensator_gain_ * stiffness * timestep);
  const double pump = std::clamp(wanted, 0.0, p.pump_flow_);
  // Below the precharge the gas law is used too: when the accumulator is empty, pressure collapses.
  const double next = std::clamp(gas + (demand - pump) * timestep, 0.1 * gas, 2.0 * gas);
  const double after = absolute * std::pow(gas / next, p.polytropic_index_) - kAtmosphere;
  s.pressure_ = std::clamp(after, 0.0, 1.1 * p.supply_pressure_);  // relief valve
}

}  // namespace leglab::hydraulics
