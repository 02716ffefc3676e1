// Plugin `leglab.supply`: the power unit that all cylinders of a leg share.
#pragma once

#include <vector>

#include "plugin/lifecycle.h"

namespace leglab::plugin {

class Supply : public Instance<hydraulics::SupplyTable> {
 public:
  Supply(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel*, mjData*) {}  // acts through the cylinders alone
  void advance(const mjModel* m, mjData* d);

  // Gauge pressure [Pa] of an instance of this plugin.
  static double pressure(const mjModel* m, const mjData* d, int instance);

 private:
  std::vector<int> consumers_;  // instances of leglab.cylinder
};

}  // namespace leglab::plugin
