// Plugin `leglab.supply`: hydraulic power unit shared by the cylinders of a leg.
#pragma once

#include <vector>

#include "plugin/lifecycle.h"

namespace leglab::plugin {

class Supply : public Instance<hydraulics::SupplyTable> {
 public:
  Supply(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel*, mjData*) {}  // acts only through the cylinders
  void advance(const mjModel* m, mjData* d);

  // Gauge pressure [Pa] of an instance of this plugin.
  static double pressure(const mjModel* m, const mjData* d, int instance);

 private:
  std::vector<int> consumers_;  // instances of leglab.cylinder
};

}  // namespace leglab::plugin
