// Parameters and states of every plugin with a state, for tools that read them by name.
#pragma once

#include <span>

#include "hydraulics/parameters.h"
#include "hydraulics/supply.h"
#include "plugin/backlash_parameters.h"
#include "plugin/command_path_parameters.h"
#include "plugin/joint_friction_parameters.h"
#include "plugin/spring_damper_parameters.h"

namespace leglab::plugin {

struct PluginTable {
  const char* plugin;
  std::span<const hydraulics::ParameterSpec> parameters;
  std::span<const hydraulics::StateSpec> states;
};

inline constexpr PluginTable kTables[] = {
    {"leglab.cylinder", hydraulics::kCylinderParameters, hydraulics::kCylinderStates},
    {"leglab.supply", hydraulics::kSupplyParameters, hydraulics::kSupplyStates},
    {"leglab.spring_damper", kSpringParameters, {}},
    {"leglab.joint_friction", kFrictionParameters, kFrictionStates},
    {"leglab.backlash", kBacklashParameters, kBacklashStates},
    {"leglab.command_path", kCommandParameters, kCommandStates},
};

}  // namespace leglab::plugin
