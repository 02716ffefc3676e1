// Sensor plugin `leglab.sensor`: measured quantities of a hydraulic test stand at one actuator.
#include <algorithm>
#include <cstddef>
#include <cstring>
#include <sstream>

#include "plugin/cylinder.h"

namespace leglab::plugin {
namespace {

using hydraulics::CylinderParameters;
using hydraulics::CylinderState;

struct Quantity {
  const char* name;
  int offset;  // in the plugin state of the cylinder; negative: an output of the latest `compute`
};

constexpr int state_offset(std::size_t bytes) {
  return static_cast<int>(Cylinder::kParameterCount + bytes / sizeof(double));
}

constexpr int kPressureA = -1, kPressureB = -2, kPistonPosition = -3;
constexpr Quantity kQuantities[] = {
    {"pressure_a", kPressureA},
    {"pressure_b", kPressureB},
    {"piston_position", kPistonPosition},
    {"flow_a", state_offset(offsetof(CylinderState, flow_a_))},
    {"flow_b", state_offset(offsetof(CylinderState, flow_b_))},
    {"supply_flow", state_offset(offsetof(CylinderState, supply_flow_))},
    {"spool_position", state_offset(offsetof(CylinderState, spool_position_))},
    {"oil_temperature", offsetof(CylinderParameters, oil_temperature_) / sizeof(double)},
};

std::vector<int> listed_quantities(const mjModel* m, int instance) {
  std::istringstream words(text_attribute(m, instance, "quantity"));
  std::vector<int> offsets;
  for (std::string word; words >> word;) {
    const auto* found = std::find_if(std::begin(kQuantities), std::end(kQuantities),
                                     [&](const Quantity& q) { return word == q.name; });
    if (found == std::end(kQuantities)) {
      offsets.clear();
      break;
    }
    offsets.push_back(found->offset);
  }
  if (offsets.empty()) {
    std::string known;
    for (const Quantity& q : kQuantities) known += std::string(known.empty() ? "" : ", ") + q.name;
    refuse(m, instance, "attribute 'quantity' = '" + text_attribute(m, instance, "quantity") +
                            "'; allowed: one or more of " + known);
  }
  return offsets;
}

class Sensor : public Instance<SensorTable> {
 public:
  Sensor(const mjModel* m, int instance)
      : Instance(m, instance), quantities_(listed_quantities(m, instance)) {
    for (int i = 0; i < m->nsensor; ++i) {
      if (m->sensor_type[i] == mjSENS_PLUGIN && m->sensor_plugin[i] == instance) sensor_ = i;
    }
    if (sensor_ < 0) refuse(m, instance, "serves no sensor; allowed: one sensor an instance");
    const std::string name = text_attribute(m, instance, "actuator");
    const int actuator = element_named(m, instance, mjOBJ_ACTUATOR, m->nu, name);
    if (actuator >= 0) cylinder_ = m->actuator_plugin[actuator];
    if (cylinder_ < 0 || !is_instance<Cylinder>(m, cylinder_)) {
      refuse(m, instance, "attribute 'actuator' = '" + name + "'; allowed: the name of a " +
                              Cylinder::Table::plugin + " actuator");
    }
  }

  static int value_count(const mjModel* m, int instance, int) {
    return static_cast<int>(listed_quantities(m, instance).size());
  }

  void compute(const mjModel* m, mjData* d) {
    mjtNum* out = d->sensordata + m->sensor_adr[sensor_];
    auto* cylinder = instance_of<Cylinder>(d, cylinder_);
    const hydraulics::Chambers& chambers = cylinder->observe(m, d);
    const mjtNum* state = state_of(m, d, cylinder_);
    for (int offset : quantities_) {
      switch (offset) {
        case kPressureA: *out++ = chambers.gauge_a(); break;
        case kPressureB: *out++ = chambers.gauge_b(); break;
        case kPistonPosition: *out++ = cylinder->piston_position(); break;
        default: *out++ = state[offset];
      }
    }
  }

 private:
  int sensor_ = -1;
  int cylinder_ = -1;  // instance of leglab.cylinder
  std::vector<int> quantities_;
};

}  // namespace

mjPLUGIN_LIB_INIT(leglab_sensor) { register_plugin<Sensor>(mjPLUGIN_SENSOR); }

}  // namespace leglab::plugin
