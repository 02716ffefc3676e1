// Choice, for each joint, between the learned map and the calibrated map as feed-forward.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

namespace leglab::feedforward {

struct SupervisorSettings {
  double trust_time = 0.0;        // time constant of the compared mean squared errors [s]
  double margin = 1.0;            // ratio learned/calibrated RMS error that switches to the calibration
  double noise = 0.0;             // RMS tracking error below which the map is not switched [rad]
  std::vector<double> bandwidth;  // crossover of the feedback loops [rad/s]
};

// The feedback loop responds to a flow error like a first-order lag at its crossover frequency. So
// the part of the tracking error due to the excess flow in use is known, and with the measured
// error also the errors that would occur with the learned map and with the calibration.
class Supervisor {
 public:
  // control_period: [s]; speed: full speeds [rad/s].
  Supervisor(const SupervisorSettings& settings, double control_period,
             const std::vector<double>& speed)
      : margin_(settings.margin), noise_(settings.noise * settings.noise),
        forget_(std::min(1.0, control_period / settings.trust_time)),
        joints_(settings.bandwidth.size()) {
    for (std::size_t j = 0; j < joints_.size(); ++j) {
      const double bandwidth = settings.bandwidth[j];
      joints_[j].decay = std::exp(-bandwidth * control_period);
      joints_[j].gain = (1.0 - joints_[j].decay) / bandwidth * speed[j];
    }
  }

  void clear() {
    for (Joint& joint : joints_) {
      joint.applied = joint.withheld = joint.learned = joint.calibrated = 0.0;
      joint.fallback = false;
    }
  }

  // Tests whether the calibration is used instead of the learned map.
  bool fallback(std::size_t j) const { return joints_[j].fallback; }

  // Takes a tracking error [rad] and the learned excess flow: flow of the learned map minus flow of the
  // calibration [share of full speed].
  void take(std::size_t j, double tracking, double excess) {
    if (!(std::abs(tracking) < 1e3)) return;  // no measurement
    Joint& joint = joints_[j];
    const double used = joint.fallback ? 0.0 : excess;
    const double with = tracking + joint.withheld, without = tracking - joint.applied;
    joint.applied = joint.decay * joint.applied + joint.gain * used;
    joint.withheld = joint.decay * joint.withheld + joint.gain * (excess - used);
    joint.learned += forget_ * (with * with - joint.learned);
    joint.calibrated += forget_ * (without * without - joint.calibrated);
    // Hysteresis: after a fallback the learned map must be clearly better to be used again.
    const double margin = joint.fallback ? 1.0 / margin_ : margin_;
    const double noise = joint.fallback ? 0.0 : noise_;
    joint.fallback = joint.learned > margin * margin * joint.calibrated + noise;
  }

 private:
  struct Joint {
    double decay = 0.0, gain = 0.0;
    double applied = 0.0, withheld = 0.0;    // tracking errors due to excess flow, by its use [rad]
    double learned = 0.0, calibrated = 0.0;  // mean squared tracking error with each map [rad^2]
    bool fallback = false;
  };

  double margin_, noise_, forget_;
  std::vector<Joint> joints_;
};

}  // namespace leglab::feedforward
