// Plugin `leglab.supply`: the power unit that all cylinders of a leg share.
#pragma once

#include <vector>

#include <mujoco/mujoco.h>

#include "hydraulics/supply.h"

namespace leglab::plugin {

extern const char kSupplyName[];

class Supply {
 public:
  Supply(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel*, mjData*) {}  // acts through the cylinders alone
  void advance(const mjModel* m, mjData* d);

  // Gauge pressure [Pa] of an instance of this plugin.
  static double pressure(const mjModel* m, const mjData* d, int instance);

  static constexpr int kParameterCount = sizeof(hydraulics::SupplyParameters) / sizeof(double);
  static constexpr int kStateCount =
      kParameterCount + sizeof(hydraulics::SupplyState) / sizeof(double);

 private:
  int instance_;
  std::vector<int> consumers_;  // instances of leglab.cylinder
  hydraulics::SupplyParameters initial_;
};

void register_supply();

}  // namespace leglab::plugin
