// Detects that a learner's errors exceed their normal level, by cumulative sums.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace leglab::monitor {

struct WatchSettings {
  double sample_period = 0.0;  // time between learned samples [s]
  double error_ratio = 4.0;    // factor by which a change to be detected raises the mean square error
  double alarm = 4.0;          // threshold of the cumulative sum, in addition to its usual peaks
  double correlation = 1.0;    // number of correlated samples with the information of one
  int slow_window = 1;         // number of samples over which the normal mean square error is averaged
};

// Cumulative sums (Page 1954, Biometrika 41, 100), one per joint and one for all joints together, of the
// log-likelihood ratio of errors with `error_ratio` times the normal mean square to normal errors.
class ErrorWatch {
 public:
  ErrorWatch(int joints, const WatchSettings& settings)
      : settings_(settings), normal_(std::size_t(joints)), seen_(normal_),
        sum_(std::size_t(joints + 1)), peak_(sum_), top_(sum_), since_(sum_) {}

  // Restarts learning of the normal errors; there is no alarm during the first `wait` samples.
  void start(double wait) {
    wait_ = wait;
    for (auto* values : {&normal_, &seen_, &sum_, &peak_, &top_, &since_}) {
      std::fill(values->begin(), values->end(), 0.0);
    }
  }

  // Normal mean square errors, (joints).
  const double* normal() const { return normal_.data(); }

  // Time at which the first of the sums that cause the alarm began to rise [s].
  double since() const { return alarm_since_; }

  // Takes a block of samples that ends at `time` [s]: each joint's mean square error and number of
  // samples, (joints) each. Returns whether there is an alarm.
  bool take(double time, const double* mean, const double* used) {
    const std::size_t joints = normal_.size();
    const double samples = *std::max_element(used, used + joints);
    const double duration = samples * settings_.sample_period;
    const double peak_time = peak_windows * settings_.slow_window * settings_.sample_period;
    const double decay = std::exp(-duration / peak_time);
    double all = 0.0;
    alarm_since_ = std::numeric_limits<double>::infinity();
    bool alarm = false;
    for (std::size_t j = 0; j <= joints; ++j) {
      const double step = j < joints ? rise(mean[j], used[j], normal_[j]) : all;
      all += step;
      const double seen =
          j < joints ? seen_[j] : *std::min_element(seen_.begin(), seen_.end());
      // In every stride some motion is hard to predict, so the sum's peak there raises the limit.
      const double limit = settings_.alarm + margin * peak_[j];
      const double total =
          seen >= settings_.slow_window ? std::max(sum_[j] + step, 0.0) : 0.0;
      if (sum_[j] == 0.0 && total > 0.0) since_[j] = time - duration;
      sum_[j] = total;
      if (total > limit && seen >= wait_) {
        alarm = true;
        alarm_since_ = std::min(alarm_since_, since_[j]);
      }
      top_[j] = std::max(top_[j], total);
      peak_[j] *= decay;
      if (total == 0.0) {  // a rise has ended without alarm
        peak_[j] = std::max(peak_[j], top_[j]);
        top_[j] = 0.0;
      }
    }
    return alarm;
  }

  // Updates the normal mean square errors with a block; arguments as in `take`.
  void learn(const double* mean, const double* used) {
    for (std::size_t j = 0; j < normal_.size(); ++j) {
      seen_[j] += used[j];
      const double weight =
          std::max(used[j] / settings_.slow_window, used[j] / std::max(seen_[j], 1.0));
      const bool young = seen_[j] < settings_.slow_window;
      const double most = young ? mean[j] : outlier * normal_[j];
      normal_[j] += weight * (std::min(mean[j], most) - normal_[j]);
    }
  }

 private:
  // `margin`: factor on a cumulative sum's earlier peak, which is added to the alarm threshold.
  // `peak_windows`: time constant of the peak's decay, in multiples of the slow window.
  static constexpr double margin = 2.0, peak_windows = 2.5;
  // Multiple of the normal mean squared error to which a block's error is clipped before averaging.
  static constexpr double outlier = 9.0;

  double rise(double mean, double used, double normal) const {
    const double ratio = mean / std::max(normal, 1e-300);
    const double more = settings_.error_ratio;
    return used / (2.0 * settings_.correlation) * (ratio * (1.0 - 1.0 / more) - std::log(more));
  }

  WatchSettings settings_;
  double wait_ = 0.0, alarm_since_ = 0.0;
  std::vector<double> normal_, seen_;               // (joints)
  std::vector<double> sum_, peak_, top_, since_;    // (joints + 1)
};

}  // namespace leglab::monitor
