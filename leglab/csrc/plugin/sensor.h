// Sensor plugin `leglab.sensor`: what a hydraulic test stand measures at one actuator.
#pragma once

#include <vector>

#include <mujoco/mujoco.h>

namespace leglab::plugin {

class Sensor {
 public:
  Sensor(const mjModel* m, int instance);
  void reset(mjtNum*) const {}
  void compute(const mjModel* m, mjData* d);

  // Number of quantities that an instance lists; refuses unknown ones.
  static int dimension(const mjModel* m, int instance);

  static constexpr int kStateCount = 0;

 private:
  int sensor_ = -1;
  int cylinder_ = -1;  // instance of leglab.cylinder
  std::vector<int> quantities_;
};

void register_sensor();

}  // namespace leglab::plugin
