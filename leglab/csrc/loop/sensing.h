// Measured positions and velocities for a controller, once per control period.
#pragma once

#include <cmath>
#include <cstddef>
#include <numbers>

namespace leglab::loop {

struct SensingSettings {
  std::size_t joints = 0;
  int counts = 0;     // encoder counts per turn; 0 for infinite resolution
  double gain = 0.0;  // factor on the difference of two readings in the velocity filter [1/s]
  double keep = 0.0;  // factor on the previous velocity in the velocity filter
};

// Disturbances of one reading; arrays with one value per joint.
struct Disturbance {
  const double* noise;  // [rad]
  const double* shift;  // shift due to faults [rad]
  const bool* lost;     // true repeats the last reading; null for no losses
};

// Reading: true position + noise + shift, rounded to counts. Velocity: difference of two readings,
// passed through a first-order filter.
class Sensing {
 public:
  Sensing(SensingSettings settings, double* position, double* velocity)
      : settings_(settings), position_(position), velocity_(velocity) {
    if (settings.counts > 0) {
      per_radian_ = settings.counts / (2.0 * std::numbers::pi);
      resolution_ = 2.0 * std::numbers::pi / settings.counts;
    }
  }

  // Takes the initial reading, with velocity 0.
  void start(const double* sample, const Disturbance& by) {
    for (std::size_t j = 0; j < settings_.joints; ++j) {
      position_[j] = reading(sample[j], by, j);
      velocity_[j] = 0.0;
    }
  }

  void read(const double* sample, const Disturbance& by) {
    for (std::size_t j = 0; j < settings_.joints; ++j) {
      const double last = position_[j];
      if (!(by.lost && by.lost[j])) position_[j] = reading(sample[j], by, j);
      velocity_[j] = settings_.keep * velocity_[j] + settings_.gain * (position_[j] - last);
    }
  }

 private:
  double reading(double sample, const Disturbance& by, std::size_t j) const {
    const double noisy = sample + by.noise[j] + by.shift[j];
    return settings_.counts > 0 ? std::rint(noisy * per_radian_) * resolution_ : noisy;
  }

  SensingSettings settings_;
  double per_radian_ = 0.0, resolution_ = 0.0;
  double *position_, *velocity_;
};

}  // namespace leglab::loop
